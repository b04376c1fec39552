"""Cameras: axes, pixels, mirrored packs, and paths that keep the content in the picture."""

import numpy as np
import pytest

from scenepack.pack import Pack
from tests.scenepack.volumes import cube_pack
from viewer.rendering.camera import ViewCamera, filling_orbit, forward_facing_path, orbit_path
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings


def test_a_forward_facing_path_stays_in_one_plane_and_looks_ahead(ndc_shapes: Pack) -> None:
    cameras = forward_facing_path(ndc_shapes, 6)
    assert orbit_path(ndc_shapes, 6)[2].grid_T_camera == pytest.approx(cameras[2].grid_T_camera)
    assert all(abs(camera.position[2]) < 1e-12 for camera in cameras)
    for camera in cameras:
        world_R_camera = (ndc_shapes.worldspace_T_opengl @ camera.grid_T_camera)[:3, :3]
        assert np.linalg.det(world_R_camera) > 0 and world_R_camera[2, 2] > 0.9


def seen(renderer: OffscreenRenderer, camera: ViewCamera) -> np.ndarray:
    """Shares of the picture, (x0, y0, x1, y1), between which something is seen."""
    alpha = renderer.render_float(camera, RenderSettings(mode="alpha"))[..., 0] > 0.2
    ys, xs = np.nonzero(alpha)
    return np.array([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1]) / (2 * [alpha.shape[1], alpha.shape[0]])


@pytest.mark.parametrize("size", [(160, 120), (90, 150)])
def test_an_orbit_fills_its_pictures_and_cuts_nothing_off(offscreen, size) -> None:
    rgba = np.zeros((70, 70, 70, 4), np.uint8)
    rgba[20:45, 24:40, 10:66] = 200, 80, 40, 255  # a thick rod in the middle
    renderer = offscreen(cube_pack(rgba, 7))
    for orbit in (filling_orbit, orbit_path):
        boxes = np.array([seen(renderer, camera) for camera in orbit(renderer.pack, 8, 40.0, size)])
        assert boxes[:, :2].min() > 0 and boxes[:, 2:].max() < 1
        widest = max(np.ptp(boxes[:, 0::2], axis=1).max(), np.ptp(boxes[:, 1::2], axis=1).max())
        assert orbit is orbit_path or widest > 0.85
