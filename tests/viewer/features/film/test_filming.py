"""Camera paths, films and stills: the spline, nerfstudio's file, playback, what is exported and saved."""

import json
import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import copykitten
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imgui_bundle import imgui
from PIL import Image

from console import UserError
from scenepack import load_pack
from tests.stand_ins import raising
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.commands.test_commands import exr
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.rendering.test_depth_of_field import CAMERA, FAR_BAR, bars, edge_widths
from tests.viewer.waiting import at_once, live, not_none, until
from viewer.app.application import App
from viewer.commands.view import View
from viewer.core.pose import Pose, Turntable
from viewer.features.film import filming as filming_module
from viewer.features.film.camera_path import CameraPath, Keyframe, load_path, save_path
from viewer.features.film.filming import Filming, Kiosk, copy_picture
from viewer.features.film.picture_export import Export, films_possible, passes_for, write_film
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.settings import RenderSettings

needs_video = pytest.mark.skipif(not films_possible(), reason="PyAV is not installed: pip install 'snerg[video]'")
poses = st.builds(Pose, st.tuples(*[st.floats(-2, 2)] * 3), st.floats(-180, 180), st.floats(-80, 80), st.floats(0.5, 5))


def keyframes(some: list[Pose], mirrored: bool = False) -> list[Keyframe]:
    table = Turntable(mirrored=mirrored)
    return [Keyframe(pose.matrix(table), 40.0 + i, 1.0 + 0.5 * i) for i, pose in enumerate(some)]


@settings(max_examples=25)
@given(st.lists(poses, min_size=2, max_size=6), st.booleans(), st.booleans())
def test_a_path_passes_through_its_keyframes_and_stays_rigid(some, closed, mirrored):
    path = CameraPath(keyframes(some, mirrored), closed)
    for i, key in enumerate(path.keyframes):
        matrix, fov = path.at(path.start_of(i))
        np.testing.assert_allclose(matrix, key.grid_T_camera, atol=1e-6)
        assert fov == pytest.approx(key.fov)
    if closed:
        np.testing.assert_allclose(path.at(path.duration)[0], path.at(0.0)[0], atol=1e-9)
    for share in np.linspace(0, 1, 9):
        R = path.at(share * path.duration)[0][:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-9)
        assert np.sign(np.linalg.det(R)) == (-1 if mirrored else 1)


@settings(max_examples=30)
@given(st.lists(poses, min_size=1, max_size=5), st.booleans())
def test_a_path_survives_nerfstudios_file(tmp_path_factory, some, closed):
    file = tmp_path_factory.mktemp("path") / "camera_path.json"
    frame = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    path = CameraPath(keyframes(some), closed)
    save_path(path, file, frame, (640, 360), 24)
    again = load_path(file, frame)
    assert again.closed == closed and len(again.keyframes) == len(some)
    for a, b in zip(path.keyframes, again.keyframes, strict=True):
        np.testing.assert_allclose(a.grid_T_camera, b.grid_T_camera, atol=1e-6)
        assert (a.fov, a.seconds) == pytest.approx((b.fov, b.seconds))
    document = json.loads(file.read_text())
    assert {"camera_type", "render_height", "render_width", "camera_path", "fps", "seconds"} <= set(document)
    first = np.array(document["camera_path"][0]["camera_to_world"]).reshape(4, 4)
    np.testing.assert_allclose(first, frame @ path.keyframes[0].grid_T_camera, atol=1e-6)


@pytest.fixture
def filming_app(pack, tmp_path):
    app = App(canvas=FakeCanvas())
    app.show(pack, tmp_path)
    app.filming.size = (96, 64)
    app.filming.fps = 4.0
    return app


def test_keyframes_are_added_moved_changed_and_removed(filming_app):
    app, filming = filming_app, filming_app.filming
    for azimuth in (0, 60, 120):
        at_once(app.scene.rig.look_along, azimuth, 0)
        app.run("keyframe")
    assert filming.selected == 2 and len(filming.path.keyframes) == 3
    last = filming.path.keyframes[2]
    filming.rearrange(app, "up", 2)
    assert filming.path.keyframes[1] is last and filming.selected == 1
    at_once(app.scene.rig.look_along, 200, 0)
    filming.rearrange(app, "update", 0)
    np.testing.assert_allclose(filming.path.keyframes[0].grid_T_camera, app.scene.rig.matrix)
    filming.rearrange(app, "remove", 1)
    assert len(filming.path.keyframes) == 2 and filming.selected == 1


def test_playing_moves_the_camera_and_stops_at_the_end_or_when_somebody_moves_it(filming_app):
    app = filming_app
    app.run("turntable")
    app.filming.path.closed = False
    app.run("play")
    before = app.camera().grid_T_camera
    app.tick(1.5)
    assert not np.allclose(app.camera().grid_T_camera, before)
    app.tick(100)
    assert not app.filming.playing and app.filming.time == app.filming.path.duration
    app.run("play")
    app.tick(0.5)
    app.scene.rig.orbit(0.1, 0.0)
    seen = app.scene.rig.goal
    app.tick(0.5)
    assert not app.filming.playing and app.scene.rig.goal == seen


@pytest.mark.parametrize("shown", ["turn", "bookmarks", "path", "forward-facing"])
def test_a_kiosk_plays_what_there_is_without_an_end(pack, ndc_pack, tmp_path, shown):
    app = App(canvas=FakeCanvas(), kiosk=Kiosk())
    app.show(ndc_pack if shown == "forward-facing" else pack, tmp_path)
    if shown == "bookmarks":
        for azimuth in (0, 90):
            app.open_scene.rig.look_along(azimuth, 0)
            app.bookmarks.add(app)
    elif shown == "path":
        app.filming.path = CameraPath(keyframes([Pose(azimuth=a) for a in (0, 20, 40)]))
    app.tick(0.1)
    path = app.filming.path
    expected = {"turn": (8, 40.0), "bookmarks": (2, 16.0), "path": (3, 4.5), "forward-facing": (8, 40.0)}[shown]
    assert app.filming.playing and path.closed and (len(path.keyframes), path.duration) == expected
    app.tick(2.5 * path.duration)
    assert app.filming.playing and app.open_scene.rig.held is not None


@needs_video
@pytest.mark.parametrize(("suffix", "worst"), [(".webp", 12), (".gif", 30)])
def test_an_animation_shows_the_pictures_for_their_time_and_repeats(tmp_path, suffix, worst):
    y, x = np.mgrid[:45, :63] / 64.0
    waves = [np.stack([x, y, 0.5 + 0.5 * np.sin(9 * x + i)], axis=-1) for i in range(12)]
    pictures = [np.rint(255 * wave).astype(np.uint8) for wave in waves]
    write_film(tmp_path / f"film{suffix}", pictures, 20)
    with Image.open(tmp_path / f"film{suffix}") as film:
        assert film.size == (63, 45) and getattr(film, "n_frames", 1) == 12 and film.info["loop"] == 0
        for i, picture in enumerate(pictures):
            film.seek(i)
            off = np.abs(np.asarray(film.convert("RGB")).astype(int) - picture)
            assert film.info["duration"] == 50 and off.mean() < worst / 4 and np.percentile(off, 99) < worst


def test_a_cancelled_export_leaves_nothing(filming_app, tmp_path):
    app = filming_app
    for name in ("frames", *(["film.mp4"] if films_possible() else [])):
        app.run("turntable")
        app.filming.film(app, tmp_path / "out" / name)
        not_none(app.filming.export).step(0.0)
        app.filming.cancel(app)
        assert app.filming.export is None and not list((tmp_path / "out").iterdir())


SIZE = (64, 64)  # x264 writes the same pictures of 48 × 32 in two ways, now and then


@pytest.mark.parametrize("name", [pytest.param("film.mp4", marks=needs_video), "still.png"])
def test_what_the_command_line_exports_depends_on_no_window(offscreen, pack_folder, tmp_path, name):
    written = []
    for i, (window, page, frames) in enumerate([((900, 300), "", 3), ((480, 600), "film", 0)]):
        app = App()
        ui = offscreen(app, size=window)
        app.filming.fps = 2.0
        ui.frames(frames)
        target = tmp_path / str(i) / name
        View(pack_folder, export=target, export_size=f"{SIZE[0]}x{SIZE[1]}", page=page).begin(app)
        until(lambda app=app, ui=ui: ui.frame() or (app.loading is None and app.filming.export is None))
        assert not app.messages.dialogs
        written.append(pictures_in(target))
    assert len(written[0]) == len(written[1]) == (16 if name == "film.mp4" else 1)  # every frame
    assert all(np.array_equal(a, b) for a, b in zip(*written, strict=True))


def pictures_in(path: Path) -> list[np.ndarray]:
    """Of a film or a still. The encoder rarely writes the same film in other bytes."""
    if path.suffix != ".mp4":
        return [np.asarray(Image.open(path))]
    import av

    with av.open(str(path), format="mp4") as film:
        return [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]


def test_tiles_of_any_size_make_the_same_pixels_also_where_the_lens_is_off_the_middle(ctx, demo, tmp_path):
    pack = load_pack(demo)
    with closing(Canvas(ctx)) as canvas:
        canvas.show(pack)
        camera = ViewCamera.orbit(pack, 0.0, size=(151, 112))
        camera = replace(camera, cx=camera.cx + 0.3333, cy=camera.cy - 0.1717)
        passes, pictures = passes_for(["normal"], RenderSettings()), []
        for side in (16, 47, 200):
            export = Export([camera], passes, tmp_path / f"{side}.png", canvas, pack, tile_side=side)
            until(lambda export=export: export.step(1.0) or export.finished)
            pictures.append(np.asarray(Image.open(export.target)))
        assert np.ptp(pictures[0]) > 100
        assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])


@needs_video
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system does not let us choose its cores")
def test_a_film_shows_the_same_on_any_number_of_cores(tmp_path: Path) -> None:
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        pytest.skip("there is one core only")
    noise = np.random.default_rng(0).normal(0.0, 1.0, (400, 500, 3)).cumsum(0).cumsum(1)
    noise = (255 * (noise - noise.min()) / np.ptp(noise)).astype(np.uint8)
    pictures = [noise[2 * i : 2 * i + 240, 3 * i : 3 * i + 320] for i in range(40)]
    write_film(tmp_path / "all.mp4", pictures, 30)
    os.sched_setaffinity(0, {min(cores)})
    try:
        write_film(tmp_path / "one.mp4", pictures, 30)
    finally:
        os.sched_setaffinity(0, cores)
    every, one = (np.array(pictures_in(tmp_path / name), float) for name in ("all.mp4", "one.mp4"))
    # Runs of x264 differ by up to 0.31 grey levels, one or two threads instead of its usual number by 0.8.
    assert np.abs(every - one).mean() < 0.5


def test_a_picture_that_cannot_be_put_on_the_clipboard_is_told_with_reason_and_remedy(monkeypatch) -> None:
    """One that can is pasted in tests/viewer/window/live_features.py."""
    monkeypatch.setattr(copykitten, "copy_image", raising(copykitten.CopykittenError("there is no display")))
    with pytest.raises(UserError, match=r"cannot be reached.*there is no display.*Ctrl\+S"):
        copy_picture(np.zeros((4, 6, 3), np.uint8))
    monkeypatch.setattr(filming_module, "LARGEST_BYTES", 15 << 10)
    noise = np.random.default_rng(0).integers(0, 256, (80, 80, 3), np.uint8)
    with pytest.raises(UserError, match="too large"):  # before it is handed over
        copy_picture(noise)


def saved(ui: OffscreenUi, path: Path) -> Path:
    """The path of a still, once Ctrl+S and the path that is typed have made it."""
    ui.key(imgui.Key.mod_ctrl, imgui.Key.s)
    ui.settle()
    ui.key(imgui.Key.mod_ctrl, imgui.Key.a)
    ui.io.add_input_characters_utf8(str(path))
    ui.frame()
    ui.key(imgui.Key.enter)
    assert ui.app.file_request is None
    live(ui.app, lambda: ui.app.filming.export is None)
    assert not ui.app.messages.dialogs, ui.app.messages.dialogs
    return path


def test_a_still_is_blurred_and_a_click_chooses_the_focus(offscreen, app: App, tmp_path: Path) -> None:
    ui = offscreen(app, bars(), Path("bars"), size=(1000, 700))
    rig, filming = app.open_scene.rig, app.filming
    rig.goal = rig.shown = Pose((-0.3, 0.0, 0.0), 0.0, 0.0, 3.0)
    rig.fov = 40.0
    app.interface.page = "film"
    ui.settle()
    filming.size, filming.aperture, filming.lens_rays = (240, 120), 0.3, 32

    def widths(name: str) -> tuple[float, float]:
        return edge_widths(np.asarray(Image.open(saved(ui, tmp_path / name)))[60, :, 0] / 255.0)

    middle = widths("middle.png")
    app.measure_tool.choose(app, "focus")
    x, y = app.viewport.x + app.viewport.width / 2, app.viewport.y + app.viewport.height / 2
    ui.click(x + 0.7 * CAMERA.fx * app.viewport.height / 120 / (3.0 - FAR_BAR), y)  # the far bar
    assert not app.measure_tool.tool and filming.focus is not None and abs(filming.focus[2] - FAR_BAR) < 0.1
    far = widths("far.png")
    assert middle[0] < far[0] - 3 and far[1] < middle[1] - 3
    rig.set_orthographic(True)
    with pytest.raises(Exception, match="perspective"):
        filming.still(app, tmp_path / "flat.png")
    assert not Filming(focus=(0.0, 0.0, 0.0)).of_another_scene().focus


@pytest.fixture
def ui(offscreen: Callable[..., OffscreenUi], app: App, pack, pack_folder: Path) -> OffscreenUi:
    app.filming.size = (96, 64)
    return offscreen(app, pack, pack_folder, size=(1000, 800))


def test_a_view_is_saved_in_several_modes_without_background_and_as_exr(ui: OffscreenUi, app: App, tmp_path: Path):
    app.filming.transparent, app.filming.besides = True, ("depth", "normals")
    saved(ui, tmp_path / "view.png")
    assert {path.name for path in tmp_path.iterdir()} == {"view_rgb.png", "view_depth.png", "view_normals.png"}
    picture = Image.open(tmp_path / "view_rgb.png")
    assert picture.mode == "RGBA" and picture.size == (96, 64)
    assert picture.getpixel((0, 0)) == (0, 0, 0, 0) and np.asarray(picture)[..., 3].max() == 255
    _, channels = exr(saved(ui, tmp_path / "view.exr"))
    assert set(channels) == {"R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z"}
    depth = channels["Z"]
    assert 0.3 < np.median(depth[depth > 0]) / app.open_scene.rig.goal.distance < 1.5


def test_a_view_is_saved_as_a_360_picture(ui: OffscreenUi, app: App, tmp_path: Path) -> None:
    app.interface.page = "film"
    ui.settle()
    ui.press("##panorama")
    assert app.filming.size == (4096, 2048)
    app.filming.set_size(128, 2048)
    around = app.open_scene.rig.camera((128, 64)).as_panorama((128, 64))
    picture = np.asarray(Image.open(saved(ui, tmp_path / "around.png")))
    assert np.array_equal(picture, ui.canvas.snapshot(around, app.settings))
    ui.press("##panorama")
    assert app.filming.size == (1920, 1080)


def test_a_near_plane_cuts_an_orthographic_view_where_it_is_seen_to(ui: OffscreenUi, app: App, tmp_path: Path) -> None:
    at_once(app.open_scene.rig.dolly, 12)
    app.open_scene.rig.set_orthographic(True)
    app.set(near=app.open_scene.rig.goal.distance)
    ui.settle()
    app.filming.size = app.viewport.pixels
    seen = ui.canvas.snapshot(not_none(app.camera()), app.settings)
    assert np.array_equal(np.asarray(Image.open(saved(ui, tmp_path / "cut.png"))), seen)


def test_colours_are_changed_in_one_step_and_saved_pictures_have_them(ui: OffscreenUi, app: App, tmp_path: Path):
    before = np.asarray(Image.open(saved(ui, tmp_path / "before.png"))).astype(int)
    (slider,) = ui.widgets("##exposure")
    (x, y), right = slider.at, slider.rect[2]
    ui.drag([(x, y), (0.5 * (x + right), y), (right - 9, y)])
    look = not_none(app.annotations.current.look)
    assert look.exposure > 0.5 and app.settings.look is None
    assert np.asarray(Image.open(saved(ui, tmp_path / "bright.png"))).mean() > before.mean() + 1
    app.run("undo")
    assert app.annotations.current.look is None
    app.run("redo")
    assert app.annotations.current.look == look
    ui.press("Colours as they are")
    assert app.annotations.current.look is None
