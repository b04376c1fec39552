"""A photograph's lens in the window: the picture, its PSNR and what is drawn over it are bent as the photograph is."""

from dataclasses import replace

import numpy as np
import pytest

from tests.viewer.waiting import at_once
from viewer.app.application import App
from viewer.core.pose import fitted, frustum_points, project
from viewer.rendering.camera import ViewCamera, rays_through
from viewer.rendering.offscreen import OffscreenRenderer

LENS = (-0.3, 0.05, 0.01, -0.008)


@pytest.fixture(scope="module")
def distorted(known_pack):
    """The toy, and what a lens shows of it."""
    cameras = []
    for entry in known_pack.metadata["cameras"]:
        matrix = np.array(entry["world_T_camera"])
        matrix[:3, 3] *= 0.55  # near enough for the toy to reach the edges, where lenses bend most
        lens = {"distortion": list(LENS), "fx": 70.0, "fy": 72.0, "cx": 35.0, "cy": 30.0}
        cameras.append({**entry, **lens, "world_T_camera": matrix.tolist()})
    return known_pack.with_metadata(cameras=cameras)


@pytest.fixture
def ui(offscreen, app, distorted, pack_folder):
    app.interface.axes_shown = False
    return offscreen(app, distorted, pack_folder, size=(900, 700))


def expected(app: App, ctx, pack, index: int, side: int) -> np.ndarray:
    """What snerg-eval draws of a photograph, at another size."""
    camera = ViewCamera.from_scene_camera(pack, app.gallery.photographs.shots[index].camera)
    with OffscreenRenderer(pack, ctx=ctx) as renderer:
        return renderer.render(camera.resized(side, side)).astype(int)


def test_the_window_shows_a_photograph_through_its_lens_as_snerg_eval_does(ui, app, ctx, distorted):
    app.resolution.rest_scale = 1.0
    app.gallery.stand_in(app, 4)
    app.comparison.stop()  # the picture alone
    ui.settle()
    app.resolution.pixels_per_ms = 10.0  # so that it is drawn in tiles
    app.settings = replace(app.settings, background=(1.0, 1.0, 0.999))
    ui.settle()
    box = app.viewport
    side = min(box.pixels)
    x, y = ((pixels - side) // 2 for pixels in box.pixels)
    rows_columns = slice(y, y + side), slice(x, x + side)  # those on which the square photograph lies
    shown = ui.picture()[round(box.y) : round(box.y + box.height), : round(box.width)][rows_columns].astype(int)
    wanted = expected(app, ctx, distorted, 4, side)
    straight = replace(app.scene.rig.held, distortion=(0.0,) * 4)
    without = ui.canvas.snapshot(fitted(straight, app.viewport.pixels), app.settings)[rows_columns].astype(int)
    part = slice(60, None)  # below the labels
    assert (np.abs(shown - wanted)[part] > 2).mean() < 2e-3
    assert (np.abs(without - wanted)[part] > 30).mean() > 0.01  # the lens matters


def test_the_psnr_compares_pictures_of_one_lens_and_moving_on_keeps_what_is_seen(ui, app, ctx, distorted):
    app.gallery.stand_in(app, 0)
    app.comparison.pixels = expected(app, ctx, distorted, 0, 64).astype(np.uint8)  # as its camera would have taken it
    ui.settle()
    assert app.comparison.psnr_db > 60
    rig = app.scene.rig  # moving on keeps what is seen
    held = app.camera()
    at_once(rig.dolly, 0.0)
    free = app.camera()
    assert free.height / free.fy == pytest.approx(held.height / held.fy, rel=1e-6)
    assert np.allclose(free.position, held.position)
    rig.history.undo()
    assert rig.fov == rig.home_fov


def test_points_are_drawn_where_the_lens_shows_them(app, distorted):
    app.gallery.scene_changed(distorted)
    view = app.gallery.photographs.shots[0].view
    pixels = np.array([[3.0, 5.0], [60.0, 2.0], [32.0, 32.0], [1.0, 63.0]])
    points = view.position + 2.5 * rays_through(view, pixels) @ view.grid_T_camera[:3, :3].T
    seen, before = project(view, points)
    assert before.all() and np.abs(seen - pixels).max() < 1e-6
    corners = frustum_points(view, 1.7)[1:]  # of the photograph, not of a picture without its lens
    assert np.abs(project(view, corners)[0] - [[0, 0], [64, 0], [64, 64], [0, 64]]).max() < 1e-6
