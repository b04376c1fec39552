"""What a pack shows fills the picture, and nothing of it is cut off."""

from dataclasses import replace

import numpy as np
import pytest

from scenepack.blocks import atlas_from_dense
from scenepack.pack import Pack, pack_of_cube
from tests.viewer.conftest import BLENDER
from viewer.rendering.camera import ORBIT_ELEVATION, ViewCamera
from viewer.rendering.framing import MARGIN, counted_blocks, filling_orbit, outline
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

SIDE, BLOCK = 70, 7


def rod_and_speck(speck: bool) -> Pack:
    """A thick rod in the middle of its grid; with a single voxel far away from it, as training leaves some behind."""
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    rgba[20:45, 24:40, 10:66] = 200, 80, 40, 255
    if speck:
        rgba[1, 68, 1] = 255
    return pack_of_cube(SIDE, BLOCK, atlas_from_dense(rgba, None, BLOCK), None, BLENDER)


def seen(renderer: OffscreenRenderer, camera: ViewCamera) -> np.ndarray:
    """Shares of the picture, (x0, y0, x1, y1), between which something is seen."""
    alpha = renderer.render_float(camera, RenderSettings(mode="alpha"))[..., 0] > 0.2
    ys, xs = np.nonzero(alpha)
    return np.array([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1]) / (2 * [alpha.shape[1], alpha.shape[0]])


@pytest.mark.parametrize("size", [(160, 120), (90, 150)])
def test_an_orbit_fills_its_pictures_and_cuts_nothing_off(offscreen, size) -> None:
    renderer = offscreen(rod_and_speck(False))
    boxes = np.array([seen(renderer, camera) for camera in filling_orbit(renderer.pack, 8, 40.0, size)])
    assert boxes[:, :2].min() > 0 and boxes[:, 2:].max() < 1
    widest = max(np.ptp(boxes[:, 0::2], axis=1).max(), np.ptp(boxes[:, 1::2], axis=1).max())
    assert widest > 0.85
    old = ViewCamera.orbit(renderer.pack, 0.0, fov_degrees=40.0, size=size)
    x0, y0, x1, y1 = seen(renderer, old)
    assert max(x1 - x0, y1 - y0) < widest - 0.08  # what a ball around all content left of the picture


def test_stray_pieces_do_not_count(offscreen) -> None:
    rod, strayed = rod_and_speck(False), rod_and_speck(True)
    assert strayed.occupied.sum() > rod.occupied.sum() == counted_blocks(strayed).sum()
    np.testing.assert_allclose(outline(strayed), outline(rod))


def test_the_outline_is_that_of_voxels_and_an_empty_pack_has_its_grid() -> None:
    pack = rod_and_speck(False)
    low, high = np.array([10, 24, 20]), np.array([66, 40, 45])
    points = (outline(pack) - pack.min_xyz) / pack.voxel_size
    np.testing.assert_allclose(points.min(0), low), np.testing.assert_allclose(points.max(0), high)
    faint = replace(pack, atlas_rgba=(pack.atlas_rgba // 16).astype(np.uint8))  # nothing to be seen: its macroblocks
    assert np.ptp((outline(faint) - faint.min_xyz) / faint.voxel_size, axis=0).max() == pytest.approx(63)
    empty = replace(pack, atlas_indices=np.full_like(pack.atlas_indices, 255))
    points = (outline(empty) - empty.min_xyz) / empty.voxel_size
    np.testing.assert_allclose([points.min(0), points.max(0)], [[0] * 3, [SIDE] * 3])


def test_a_single_view_is_as_close_as_it_can_be() -> None:
    pack = rod_and_speck(False)
    (camera,) = filling_orbit(pack, 1, 40.0, (160, 120), 30.0)
    expected = ViewCamera.orbit(pack, 30.0, ORBIT_ELEVATION, 1.0).grid_T_camera[:3, :3]
    np.testing.assert_allclose(camera.grid_T_camera[:3, :3], expected, atol=1e-12)
    local = (outline(pack) - camera.position) @ camera.grid_T_camera[:3, :3]
    reach = np.abs(local[:, :2] / -local[:, 2:]) * camera.fx / [camera.cx, camera.cy]
    assert reach.max() == pytest.approx(1 / MARGIN, rel=0.02)
