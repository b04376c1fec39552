"""Photographs, comparisons, the crop box, and dropping things on the window."""

from pathlib import Path

import numpy as np
import pytest

from console import UserError
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.conftest import toy_pack
from tests.viewer.offscreen_ui import drawn_widths
from tests.viewer.scenes import SIDE, with_cameras
from tests.viewer.waiting import at_once
from viewer.core.files import kind_of
from viewer.core.pose import project
from viewer.features.crop import crop
from viewer.features.photographs.photographs import shots_of
from viewer.rendering.camera import ViewCamera


@pytest.fixture
def ui(offscreen, app, known_pack, pack_folder):
    return offscreen(app, known_pack, pack_folder)


def test_standing_in_a_photograph_shows_what_it_shows(ui, app):
    app.gallery.stand_in(app, 1)
    ui.settle()
    assert app.comparison.psnr_db > 45 and app.comparison.psnr_size == (SIDE, SIDE)
    app.comparison.how = "difference"
    app.touch()
    ui.settle()
    assert ui.scene_picture()[40:].mean() < 25  # the same, but for the photograph's coarser pixels


def test_the_wipe_shows_the_photograph_on_the_right_of_its_edge_which_can_be_dragged(ui, app):
    app.gallery.stand_in(app, 0)
    assert app.comparison.sides(app) == ("Rendered", "Photograph")  # the golden picture has them
    app.comparison.pixels = np.full((SIDE, SIDE, 3), (250, 0, 250), np.uint8)
    app.touch()
    ui.settle()
    middle = round(app.viewport.y + 0.7 * app.viewport.height)
    row = ui.picture()[middle, : round(app.viewport.width)].astype(int)
    magenta = np.abs(row - (250, 0, 250)).sum(axis=1) < 10
    edge = round(0.5 * app.viewport.width)
    assert not magenta[: edge - 10].any() and magenta[edge + 10 : edge + 150].all()
    ui.drag([(edge, 300), (edge + 60, 300), (edge + 120, 300)])
    assert app.comparison.split == pytest.approx((edge + 120) / app.viewport.width, abs=0.01)
    assert app.comparison.against == "photograph"  # the camera did not move
    app.comparison.how, app.comparison.clock = "flip", 0.0
    assert app.comparison.sides(app)[app.comparison.other_side] == "Rendered"


def test_a_click_on_a_frustum_stands_in_it(ui, app):
    app.interface.page = "photographs"
    app.gallery.frusta = True
    at_once(app.scene.rig.dolly, -12)
    ui.settle()
    camera = app.camera()
    shots = app.gallery.photographs.shots
    places, before = project(camera, np.stack([shot.view.position for shot in shots]))
    inside = [i for i in range(len(shots)) if before[i] and (places[i] > 20).all() and places[i][0] < 780]
    assert inside
    x, y = places[inside[0]] + (0, app.viewport.y)
    ui.click(float(x), float(y))
    assert app.comparison.against == "photograph" and app.scene.rig.held is not None


def test_a_photograph_that_is_not_there_is_told_and_the_camera_stays(app, known_pack, pack_folder, tmp_path):
    app.canvas = FakeCanvas()
    (tmp_path / "gone").mkdir()  # the folder is there, but not what was in it
    app.show(known_pack.with_metadata(provenance={"scene": str(tmp_path / "gone")}), pack_folder)
    with pytest.raises(UserError):
        app.gallery.stand_in(app, 0)
    assert app.scene.rig.held is not None and app.comparison.against == ""


def test_only_at_a_photographs_camera_do_rays_begin_where_they_did_in_training(app, pack, pack_folder):
    app.canvas = FakeCanvas()
    app.show(with_cameras(pack, [ViewCamera.orbit(pack, 0)]).with_metadata(near=1.25), pack_folder)
    app.scene.rig.hold(shots_of(app.scene.pack)[0].view)
    assert app.camera().ray_near == 1.25
    app.scene.rig.orbit(0.2, 0.0)
    assert app.scene.rig.held is None and app.camera().ray_near == 0.0


def test_two_packs_are_compared_under_one_camera(ui, app, pack_folder):
    ui.settle()
    app.interface.axes_shown = False
    alone = ui.picture()
    app.gallery.chosen = 1
    app.comparison.with_pack(app, toy_pack(view_mlp=False), pack_folder)
    assert app.gallery.chosen is None  # it is not what the picture is compared with
    app.comparison.how = "difference"
    ui.settle()
    assert np.abs(ui.picture().astype(int) - alone)[200:500, 200:600].mean() > 20
    app.comparison.drop_other(app)
    ui.settle()
    assert ui.canvas.other is None


def test_names_of_compared_packs_fit_into_the_page_and_have_no_suffix(ui, app, monkeypatch):
    app.comparison.with_pack(app, toy_pack(), Path("other.zip"))
    app.open_scene.name, app.interface.page = "long-name-" * 9, "compare"
    ui.settle()
    drawn = drawn_widths(monkeypatch)
    ui.frame()
    assert "other" in drawn
    shown = [text for text in drawn if text.startswith("long-name") and drawn[text] < 280]
    assert shown and shown[0].endswith("…")


def test_a_crop_box_cuts_and_its_handles_can_be_dragged(ui, app):
    pack = app.scene.pack
    app.interface.page = "crop"
    app.set(crop=crop.whole(pack))
    ui.settle()
    x, y = ui.place_of(crop.face_centre(app.settings.crop, 3))  # the top
    rig = app.scene.rig.goal
    ui.drag([(x, y), (x, y + 20), (x, y + 40)])
    assert app.settings.crop[1][1] < crop.whole(pack)[1][1] - 0.05 and app.scene.rig.goal == rig
    assert ui.place_of(crop.face_centre(app.settings.crop, 3))[1] == pytest.approx(y + 40, abs=6)


def test_things_dropped_are_told_apart(tmp_path, pack_folder):
    for name in ("transforms_train.json", "reconstruction.json"):  # Blender's, OpenSfM's
        (tmp_path / name).mkdir()
        (tmp_path / name / name).write_text("{}")
        assert kind_of(tmp_path / name) == "scene"
    assert kind_of(pack_folder) == "pack"
    assert kind_of(pack_folder.parent) == "pack"  # the folder around it, as snerg-make leaves it
    assert kind_of(tmp_path / "nothing") == "unknown"


def test_the_gizmo_moves_the_box_along_one_axis_and_beside_it_the_mouse_is_the_cameras(ui, app, pack):
    app.interface.page, app.crop_tool = "crop", "move"
    app.set(crop=crop.placed(pack, np.zeros(3), np.full(3, 0.8)))
    ui.settle()
    before, rig = np.mean(app.settings.crop, axis=0), app.scene.rig.goal
    start, end = (np.array(ui.place_of(point)) for point in (before, before + np.array([0.0, 0.05, 0.0])))
    at = start + 45 * (end - start) / np.linalg.norm(end - start)  # on the arrow, of a constant size on the screen
    ui.pull(at, at + np.array([0, -50]), 4)
    moved = np.mean(app.settings.crop, axis=0) - before
    assert moved[1] > 0.1 and np.abs(moved[[0, 2]]).max() < 1e-3
    np.testing.assert_allclose(np.ptp(app.settings.crop, axis=0), 0.8, atol=1e-3)
    assert app.scene.rig.goal == rig
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
