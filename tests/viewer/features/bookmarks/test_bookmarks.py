"""Bookmarks: views that are come back to, in their order, and flown through as a film; places, in the window and in pictures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from console import UserError
from scenepack import load_pack
from tests.scenepack.helpers import written
from tests.viewer.commands.test_commands import picture, rendered
from tests.viewer.core.test_annotations import opened
from tests.viewer.rendering.test_depth_of_field import FAR_BAR, NEAR_BAR, bars
from tests.viewer.waiting import at_once, live
from viewer.app.application import App
from viewer.commands import render
from viewer.core.annotations import Annotations, Bookmark, worded
from viewer.core.pose import Pose, project
from viewer.core.state import Viewport
from viewer.features.bookmarks import bookmarks
from viewer.features.bookmarks.bookmarks import RIM, pose_of, with_places
from viewer.rendering.camera import ViewCamera
from viewer.rendering.settings import RenderSettings

BALL = (0.0, -0.25, 0.4)  # its front


@pytest.fixture(params=["around", "forward-facing"])
def app(request, pack, ndc_pack) -> App:
    app = App()
    app.show(pack if request.param == "around" else ndc_pack, Path("toy"))
    return app


def place(app: App, azimuth: float) -> np.ndarray:
    """Puts the camera somewhere, at once; where it is then."""
    rig = app.open_scene.rig
    start = 180.0 if rig.bounded else 0.0
    rig.goal = rig._bounded(Pose((0.05, 0.1, 0.0), start + azimuth, 12.0, 0.2 if rig.bounded else 3.0))
    rig.shown = rig.goal
    return rig.matrix.copy()


def arrived(app: App) -> np.ndarray:
    app.open_scene.rig.shown = app.open_scene.rig.goal
    return app.open_scene.rig.matrix


@pytest.fixture
def seen(app) -> list[np.ndarray]:
    """Where the camera was at each of three views that are bookmarked."""
    with pytest.raises(UserError, match="two views"):
        app.bookmarks.film(app)
    cameras = []
    for i, azimuth in enumerate((0.0, 7.0, 14.0)):
        cameras.append(place(app, azimuth))
        app.scene.rig.fov = 30.0 + i
        app.run("bookmark")
    return cameras


def test_keys_step_through_the_views_in_their_order_and_round_and_a_film_flies_through_them(app, seen):
    assert [view.name for view in app.annotations.current.bookmarks] == ["View 1", "View 2", "View 3"]
    place(app, -9.0)
    for command, index in (("next-bookmark", 0), ("next-bookmark", 1), ("last-bookmark", 0), ("last-bookmark", 2)):
        app.run(command)
        assert np.allclose(arrived(app), seen[index], atol=1e-6), (command, index)
        assert app.scene.rig.fov == pytest.approx(30.0 + index)
    app.run("undo")
    assert np.allclose(arrived(app), seen[0], atol=1e-6)
    app.run("film-bookmarks")
    path = app.filming.path
    assert app.interface.page == "film" and len(path.keyframes) == 3
    for i, matrix in enumerate(seen):
        assert np.allclose(path.at(path.start_of(i))[0], matrix, atol=1e-6)


@pytest.mark.parametrize("orthographic", [False, True])
def test_places_are_covered_from_behind_and_keep_what_is_said_of_them(pack, orthographic, monkeypatch):
    monkeypatch.setattr(bookmarks, "PAUSE_S", 0.0)
    app = App()
    app.show(pack, Path("toy"))
    rig = app.open_scene.rig
    for point in (BALL, (0.5, 0.39, 0.0)):
        app.bookmarks.add(app, point)
    rig.set_orthographic(orthographic)
    hidden = []
    for azimuth in (0.0, 180.0):
        place(app, azimuth)
        app.viewport = Viewport(0.0, 0.0, 160.0, 120.0)
        app.viewport.camera = app.camera()
        for _ in range(9):  # a place a frame, where one takes long
            app.bookmarks.covered(app)
        hidden.append(app.bookmarks.covered(app))
    assert hidden == [set(), {BALL}]
    app.bookmarks.edit(app, 0, text=worded("A ball\n\x1b[31mred"))
    app.bookmarks.edit(app, 0, name="Ball")
    app.bookmarks.rearrange(app, "update", 0)
    first = app.annotations.current.bookmarks[0]
    assert (first.name, first.text, first.point) == ("Ball", "A ball\n\ufffd[31mred", BALL)
    assert first.eye != app.annotations.current.bookmarks[1].eye
    for _ in range(3):
        app.run("undo")
    assert app.annotations.current.bookmarks[0].name == "Place 1"


@pytest.mark.usefixtures("seen")
def test_views_are_named_moved_changed_and_removed_and_all_of_it_is_undone(app):
    annotations, bookmarks = app.annotations, app.bookmarks
    bookmarks.edit(app, 0, name="The door")
    bookmarks.rearrange(app, "down", 0)
    assert [view.name for view in annotations.current.bookmarks] == ["View 2", "The door", "View 3"]
    assert bookmarks.selected == 1
    bookmarks.rearrange(app, "remove", 1)
    assert [view.name for view in annotations.current.bookmarks] == ["View 2", "View 3"] and bookmarks.selected == 1
    moved = place(app, -5.0)
    bookmarks.rearrange(app, "update", 0)
    table = app.scene.rig.table
    assert np.allclose(pose_of(annotations.current.bookmarks[0], table).matrix(table), moved, atol=1e-6)
    app.run("undo")
    app.run("undo")
    assert [view.name for view in annotations.current.bookmarks] == ["View 2", "The door", "View 3"]
    place(app, 3.0)
    app.run("bookmark")
    assert annotations.current.bookmarks[1].name == "View 4"  # behind the selected one: 2 and 3 are taken


def test_a_photographs_camera_is_bookmarked_level_from_its_place(app):
    here = place(app, 5.0)
    rig = app.scene.rig
    turned = here.copy()
    turned[:3, 3] += 0.01
    rig.hold(replace(rig.camera((64, 48)), grid_T_camera=turned))
    app.run("bookmark")
    assert np.allclose(app.annotations.current.bookmarks[0].eye, turned[:3, 3], atol=1e-6)


@pytest.fixture
def ui(offscreen, pack, pack_folder):
    app = App()
    app.interface.page = ""
    ui = offscreen(app, pack, pack_folder, size=(900, 640))
    for turn in (0.0, 0.3, 0.3, 0.3):
        at_once(app.open_scene.rig.orbit, turn, 0.0)
        app.run("bookmark")
    app.interface.page = "bookmarks"
    return ui


def test_each_view_has_its_own_picture_and_a_click_on_it_goes_there(ui):
    app, rows = ui.app, [row for row in ui.widgets("##bookmark") if row.label.startswith("##")]
    corners, window = [np.rint(row.rect).astype(int) for row in rows], ui.picture().astype(float)
    pictures = [window[y0 + 6 : y1 - 6, x0 + 10 : x0 + 64] for x0, y0, _, y1 in corners]
    assert len(pictures) == 4
    for each in pictures:
        assert each.std(axis=(0, 1)).max() > 20  # something of the toy
    assert all(np.abs(a - b).max() > 60 for i, a in enumerate(pictures) for b in pictures[:i])
    ui.click(*rows[1].at)
    ui.settle()
    assert app.bookmarks.selected == 1
    assert np.allclose(app.scene.rig.matrix[:3, 3], app.annotations.current.bookmarks[1].eye, atol=1e-3)


def test_a_click_annotates_a_place_and_one_on_its_number_goes_there_unless_it_is_covered(ui):
    app, rig = ui.app, ui.app.scene.rig

    def look_along(azimuth: float, elevation: float) -> None:
        at_once(rig.look_along, azimuth, elevation)
        ui.settle()

    look_along(0, 10)
    app.run("annotate")
    ui.click(*ui.place_of(BALL))
    place, seen = app.annotations.current.bookmarks[4], rig.goal
    for field, words in (("##text", "A ball <b>"), ("##name", "Ball")):
        ui.press(field)
        ui.key(imgui.Key.mod_ctrl, imgui.Key.a)
        ui.io.add_input_characters_utf8(words)
        ui.frame()
    ui.key(imgui.Key.enter)
    named = app.annotations.current.bookmarks[4]
    assert (named.name, named.text) == ("Ball", "A ball <b>") and rig.goal == seen
    assert place.name == "Place 5" and np.allclose(place.point, BALL, atol=0.05) and not app.measure_tool.tool
    look_along(180, 10)
    ui.click(*ui.place_of(place.point))
    assert rig.goal.azimuth == 180 and app.bookmarks.covered(app) == {place.point}
    look_along(40, 25)
    ui.click(*ui.place_of(place.point))
    assert np.allclose(rig.goal.matrix(rig.table), seen.matrix(rig.table), atol=1e-6)
    app.run("annotate")
    ui.key(imgui.Key.escape)
    assert not app.measure_tool.tool


NEAR = Bookmark("Near bar", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), point=(-0.3, 0.0, NEAR_BAR + 0.05))
FAR = Bookmark("Ferne Stange, 遠い棒", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), point=(0.4, 0.2, FAR_BAR + 0.05))
BEHIND = Bookmark("Hidden", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), point=(0.4, -0.3, -0.98))
VIEW = Bookmark("No place", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0))
ANNOTATIONS = Annotations(bookmarks=(VIEW, NEAR, FAR, BEHIND))
WORDS = ["--eye", "0,0,3", "--target", "0,0,0", "--fov", "40", "--size", "240x160"]
CAMERA = ViewCamera.look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), fov_degrees=40.0, size=(240, 160))


def discs(picture: np.ndarray) -> list[bool]:
    """Whether the rim of a disc is around each of the three places."""
    rim = np.abs(picture.astype(int) - RIM[:3]).max(axis=2) < 60
    pixels, _ = project(CAMERA, np.array([NEAR.point, FAR.point, BEHIND.point]))
    return [bool(rim[int(y) - 10 : int(y) + 10, int(x) - 10 : int(x) + 10].sum() > 8) for x, y in pixels]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = written(tmp_path / "bars", bars())
    app = opened(folder, tmp_path)
    app.annotations.current = ANNOTATIONS
    app.annotations.save_now()
    return folder


def test_places_that_are_seen_are_numbered_and_titled_and_the_rest_is_as_it_was(folder, tmp_path, refused) -> None:
    plain, places = (picture(rendered(folder, tmp_path / "a.png", *WORDS, *more)) for more in ((), ("--places",)))
    assert discs(places) == [True, True, False] and discs(plain) == [False] * 3
    changed = (plain != places).any(axis=2)
    assert 200 < changed.sum() < 0.25 * changed.size
    layers = rendered(folder, tmp_path / "layers", *WORDS, "--places", "--mode", "rgb,depth")
    rgb, depth = (picture(layers / f"view_{mode}.png") for mode in ("rgb", "depth"))
    assert discs(rgb) == [True, True, False] and discs(depth) == [False] * 3
    transparent = ["--out", tmp_path / "b.png", *WORDS, "--places", "--background", "transparent"]
    assert "--places" in refused(render.main, folder, *transparent)


def test_a_film_and_a_saved_view_of_the_window_have_them_where_that_is_wanted(offscreen, folder, tmp_path):
    app = App()
    offscreen(app, load_pack(folder), folder)
    app.filming.size = (240, 160)
    for wanted in (False, True):
        app.filming.annotated = wanted
        app.filming.still(app, tmp_path / "a.png", CAMERA)
        live(app, lambda: app.filming.export is None)
        assert discs(picture(tmp_path / "a.png")) == [wanted, wanted, False]


def test_titles_stay_within_the_picture_and_are_cut_where_they_are_long() -> None:
    long = Annotations(bookmarks=(Bookmark("W" * 100, (0, 0, 3), (0, 0, 0), point=(0.4, 0.2, FAR_BAR + 0.05)),))
    white = np.full((160, 240, 3), 255, np.uint8)
    changed = np.argwhere((with_places(white, CAMERA, bars(), RenderSettings(), long) != 255).any(axis=2))
    assert 40 < np.ptp(changed[:, 1]) < 0.55 * 240
