"""Moving and scaling the crop box with ImGuizmo, and taking that back in turn with the camera's moves."""

import numpy as np

from viewer.core.pose import project
from viewer.features.crop import crop


def centre(app) -> np.ndarray:
    return np.mean(app.settings.crop, axis=0)


def size(app) -> np.ndarray:
    return np.subtract(app.settings.crop[1], app.settings.crop[0])


def arrow(app, axis: int, share: float = 0.75) -> np.ndarray:
    """A point on the gizmo's arrow along an axis, in window units: found by what ImGuizmo draws, a constant size on screen."""
    camera = app.camera()
    middle = centre(app)
    tip = middle.copy()
    tip[axis] += 0.05
    pixels, _ = project(camera, np.stack([middle, tip]))
    direction = (pixels[1] - pixels[0]) / np.linalg.norm(pixels[1] - pixels[0])
    return pixels[0] + (0, app.viewport.y) + 60 * share * direction


def test_the_gizmo_moves_the_box_along_one_axis_and_beside_it_the_mouse_is_the_cameras(
    offscreen, app, pack, pack_folder
):
    app.interface.page, app.crop_tool = "crop", "move"
    ui = offscreen(app, pack, pack_folder)
    app.set(crop=crop.placed(pack, np.zeros(3), np.full(3, 0.8)))
    ui.settle()
    before, rig = centre(app), app.scene.rig.goal
    at = arrow(app, 1)
    ui.pull(at, at + np.array([0, -50]), 4)
    moved = centre(app) - before
    assert moved[1] > 0.1 and np.abs(moved[[0, 2]]).max() < 1e-3
    np.testing.assert_allclose(size(app), 0.8, atol=1e-3)
    assert app.scene.rig.goal == rig and ui.ctx.error == "GL_NO_ERROR"
    cut = app.settings.crop
    ui.pull((120.0, 650.0), (180.0, 670.0), 4)
    assert app.settings.crop == cut and app.scene.rig.goal != rig


def test_a_box_stays_where_the_content_is_and_never_vanishes(pack):
    outer = np.asarray(crop.whole(pack))
    for middle in (-1e6, 0.0, 1e6):
        for side in (0.0, 1e-9, 1e9):
            low, high = np.asarray(crop.placed(pack, np.full(3, middle), np.full(3, side)))
            assert (low < high).all() and np.isfinite([low, high]).all()
            mid = 0.5 * (low + high)
            assert (outer[0] - 1e-6 <= mid).all() and (mid <= outer[1] + 1e-6).all()
