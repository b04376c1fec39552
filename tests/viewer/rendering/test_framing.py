"""What a pack shows fills the picture, and nothing of it is cut off."""

import numpy as np
import pytest

from scenepack.blocks import atlas_from_dense
from scenepack.pack import Pack, pack_of_cube
from tests.viewer.conftest import BLENDER
from viewer.rendering.camera import ViewCamera
from viewer.rendering.framing import filling_orbit
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
