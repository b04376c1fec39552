"""The Erase page in a framebuffer: its tools and rules, undo, what the GPU shows, and the pack that is saved."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from console import UserError
from scenepack import load_pack, save_pack
from scenepack.blocks import dense_from_pack
from scenepack.editing import Voxels, without
from tests.scenepack.volumes import atlas_from_dense
from tests.viewer.conftest import toy_pack
from tests.viewer.waiting import not_none, until
from viewer.core.pose import project
from viewer.features.comparison.comparison import FLIP_S
from viewer.features.editing.erasing import TOOLS
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

BALL = (0.0, -0.25, 0.0)  # its middle
SPECK = (slice(4, 6), slice(40, 42), slice(20, 22))  # voxels z, y, x, far from everything else


@cache
def specked():
    """The toy with a speck beside it."""
    pack = toy_pack()
    rgba, features = dense_from_pack(pack)
    rgba[SPECK], not_none(features)[SPECK] = (90, 90, 20, 120), 60
    indices, atlas, atlas_features = atlas_from_dense(rgba, features, pack.block_size)
    return replace(pack, atlas_indices=indices, atlas_rgba=atlas, atlas_features=atlas_features)


@pytest.fixture
def ui(offscreen, app, tmp_path):
    save_pack(specked(), tmp_path / "toy")
    return offscreen(app, load_pack(tmp_path / "toy"), tmp_path / "toy")


def live(ui) -> None:
    """Frames until all is selected and shown."""
    until(lambda: ui.frame() or not ui.app.erasing.busy(ui.app))


def run(ui, *commands: str) -> None:
    """Runs commands one after the other, each until all is selected and shown."""
    for command in commands:
        ui.app.run(command)
        live(ui)


def around(ui, point, radius: float) -> list[tuple[float, float]]:
    x, y = ui.place_of(point)
    turn = np.linspace(0, 2 * np.pi, 24)
    return list(zip(x + radius * np.cos(turn), y + radius * np.sin(turn), strict=True))


def selected(ui) -> np.ndarray:
    """Positions (x, y, z) in the grid frame of all that is selected."""
    scene = ui.app.scene
    voxels = Voxels(scene.pack)
    found = []
    for number in scene.edits.selected.bits:
        z, y, x = np.nonzero(voxels.mask(scene.edits.selected, number))
        found.append(np.stack([x, y, z], 1) + 0.5 + voxels.places[number][::-1] * scene.pack.block_size)
    return scene.pack.min_xyz + scene.pack.voxel_size * np.concatenate([*found, np.zeros((0, 3))])


def test_the_brush_paints_on_the_surface_and_ctrl_takes_away(ui, app):
    ui.key(imgui.Key.x)
    assert app.interface.page == "erase" and app.erasing.tool == "brush"
    goal, (x, y) = app.scene.rig.goal, ui.place_of(BALL)
    ui.drag([(x - 30, y), (x, y), (x + 30, y)])
    live(ui)
    painted = selected(ui)
    assert len(painted) and app.scene.rig.goal == goal
    away = np.linalg.norm(painted - BALL, axis=1)
    assert (away < 0.45).all()  # on the ball, not in the air
    ahead = app.camera().position - BALL
    assert ((painted - BALL) @ ahead > -0.2).mean() > 0.9  # and on this side of it
    ui.io.add_key_event(imgui.Key.mod_ctrl, True)
    ui.drag([(x - 30, y), (x, y)])
    ui.io.add_key_event(imgui.Key.mod_ctrl, False)
    live(ui)
    fewer = len(selected(ui))
    assert 0 < fewer < len(painted)
    run(ui, "undo")
    assert len(selected(ui)) == len(painted)
    run(ui, "undo")
    assert not len(selected(ui))
    run(ui, "redo")
    assert len(selected(ui)) == len(painted)
    ui.drag([(x, y), (x + 40, y + 10)], button=1)
    assert app.scene.rig.goal != goal and len(selected(ui)) == len(painted)
    ui.key(imgui.Key.escape)
    assert not app.erasing.tool


def test_the_lasso_takes_what_shows_or_all_behind_it(ui, app):
    app.run("erase-lasso")
    ui.drag(around(ui, BALL, 40))
    live(ui)
    shown = selected(ui)
    back = app.camera().position - np.array(BALL)
    back /= np.linalg.norm(back)
    assert len(shown) and ((shown - BALL) @ back).min() > 0.0  # the half of the ball that is seen
    app.run("undo")
    app.erasing.through = True
    ui.drag(around(ui, BALL, 40))
    live(ui)
    through = selected(ui)
    assert ((through - BALL) @ back).min() < -0.3 and len(through) > 2 * len(shown)
    pixels, _ = project(app.camera(), through)
    middle = project(app.camera(), np.array([BALL]))[0][0]
    assert np.linalg.norm(pixels - middle, axis=1).max() < 42  # a pixel more by rounding


def test_a_sphere_is_drawn_from_its_middle_and_reaches_as_far_as_the_drag(ui, app):
    app.run("erase-sphere")
    x, y = ui.place_of(BALL)
    ui.drag([(x, y), (x + 10, y), (x + 40, y)])
    live(ui)
    found, hit = selected(ui), app.erasing.cursor
    reach = np.linalg.norm(found - hit.point, axis=1).max()
    edge = project(app.camera(), np.array([hit.point + reach * app.camera().grid_T_camera[:3, 0]]))[0][0]
    assert abs(np.linalg.norm(edge - project(app.camera(), hit.point[None])[0][0]) - 40) < 8


@pytest.mark.parametrize("how", ["wipe", "flip"])
def test_a_press_on_the_other_pack_of_a_comparison_selects_nothing_and_says_why(ui, app, how):
    app.comparison.with_pack(app, toy_pack(), Path("other.zip"))
    app.comparison.how, app.comparison.clock = how, FLIP_S  # its other side
    app.comparison.split = (ui.place_of(BALL)[0] - 20 - app.viewport.x) / app.viewport.width
    for tool in TOOLS:
        app.run(f"erase-{tool}")
        app.comparison.clock = FLIP_S
        ui.drag(around(ui, BALL, 10))
        live(ui)
        assert not len(selected(ui)) and app.messages.toast == "toy is edited, not other", tool
        app.messages.toast = ""
    app.run("erase-lasso")
    app.comparison.split, app.comparison.clock = 0.98, 0.0
    ui.drag(around(ui, BALL, 10))
    live(ui)
    assert len(selected(ui))


def test_rules_select_changes_apply_and_subtracting_is_a_mode(ui, app):
    app.interface.page = "erase"
    run(ui, "select-parts")
    assert app.scene.edits.selected.count == 8  # the speck
    run(ui, "selection-invert")
    everything = Voxels(app.scene.pack).everything().count
    assert app.scene.edits.selected.count == everything - 8
    app.erasing.adds = False
    app.set(crop=((-1.0, -1.0, -1.0), (0.0, 1.0, 1.0)))
    run(ui, "select-inside")
    assert (selected(ui)[:, 0] > 0).all() and len(selected(ui))
    app.erasing.adds = True
    for how, grows in (("shrink", False), ("grow", True), ("clear", False)):
        before = app.scene.edits.selected.count
        run(ui, f"selection-{how}")
        assert (app.scene.edits.selected.count > before) == grows
    run(ui, "select-outside")
    assert (selected(ui)[:, 0] > 0).all()
    assert not app.messages.dialogs


def test_a_rule_follows_its_slider_in_one_step_that_can_be_undone(ui, app):
    app.erasing.hold(app)
    counts = []
    for limit in (4, 9, 4, 9):
        app.erasing.smaller_than = limit
        app.erasing.select(app, "small")
        live(ui)
        counts.append(app.scene.edits.selected.count)
    app.erasing.let_go()
    assert counts == [0, 8, 0, 8]
    run(ui, "undo")
    assert app.scene.edits.selected.count == 0
    app.erasing.fainter_than = 0.5
    run(ui, "select-faint")
    assert app.scene.edits.selected.count == 8


@pytest.mark.parametrize("marcher", ["exact", "paper", "brute"])
def test_the_picture_after_erasing_is_that_of_the_saved_pack(ui, app, marcher):
    app.set(marcher=marcher)
    ui.settle()
    whole = ui.canvas.snapshot(app.camera(), app.settings)
    app.run("erase-sphere")
    x, y = ui.place_of(BALL)
    ui.drag([(x, y), (x + 10, y), (x + 50, y)])
    live(ui)
    marked = ui.canvas.snapshot(app.camera(), app.settings)
    assert np.abs(marked.astype(int) - whole).max() > 30  # the ball is red itself
    ui.key(imgui.Key.delete)
    live(ui)
    assert app.scene.edits.removed.bits and not app.scene.edits.selected.bits
    erased = ui.canvas.snapshot(app.camera(), app.settings)
    left = without(load_pack(app.scene.path), app.scene.edits.removed, [])
    with OffscreenRenderer(left) as renderer:
        expected = renderer.render(app.camera(), RenderSettings(marcher=marcher, background=app.settings.background))
    assert np.array_equal(erased, expected) and not np.array_equal(erased, whole)
    run(ui, "undo", "undo")
    assert np.array_equal(ui.canvas.snapshot(app.camera(), app.settings), whole)


def test_what_was_erased_stays_when_another_pack_is_shown_meanwhile(ui, app, pack, pack_folder):
    run(ui, "select-parts", "erase-selected")
    first = app.scene
    app.show(pack, pack_folder)
    ui.settle()
    assert app.scene.edits.removed.count == 0
    app.open_packs.switch(app, 1)
    ui.settle()
    assert app.scene is first and first.edits.removed.count == 8
    assert not dense_from_pack(first.pack)[0][SPECK].any()


def test_unsaved_edits_are_asked_about_and_neither_exported_nor_shared(ui, app):
    run(ui, "select-parts", "erase-selected")
    for command in ("export-scene", "share"):
        app.run(command)
        assert (
            "what you erased is not saved; save it on the Erase page first" in app.messages.dialogs.pop().text
            and app.exporting.preview is None
        )
    for command, answer in (("close", "close-unsaved"), ("quit", "quit-unsaved")):
        app.run(command)
        dialog = app.messages.dialogs.pop()
        assert "What you erased from toy is not saved" in dialog.title and answer in [id for _, id in dialog.buttons]
        assert app.scene is not None and not app.quitting
    app.run("undo")
    app.run("quit")
    assert app.quitting and not app.messages.dialogs


def test_save_as_writes_a_pack_of_what_is_left_and_opens_it_from_where_one_was(ui, app, tmp_path):
    run(ui, "select-parts", "erase-selected")
    app.scene.rig.orbit(0.2, 0.1)
    ui.settle()
    seen = app.scene.rig.matrix.copy()
    app.run("save-edited")
    assert app.file_request.suggestion == "toy-edited" and app.file_request.start == tmp_path
    request, app.file_request = app.file_request, None
    request.then(tmp_path / "new.zip")
    until(lambda: ui.frame() or (app.scene.path == tmp_path / "new.zip" and app.loading is None))
    assert not app.messages.dialogs
    assert np.allclose(app.scene.rig.matrix, seen) and app.scene.edits.removed.count == 0
    before, after = dense_from_pack(specked()), dense_from_pack(app.scene.pack)
    for old, new in zip(map(not_none, before), map(not_none, after), strict=True):
        old[SPECK] = 0
        assert np.array_equal(new, old)
    assert app.scene.pack.occupied.sum() < specked().occupied.sum()
    edits = app.scene.pack.metadata["provenance"]["edits"]
    assert edits == [{"how": ["by hand"], "voxels_removed": 8, "macroblocks_removed": 1}]
    app.run("quit")
    assert app.quitting  # all is saved


def test_what_cannot_be_edited_says_why(ui, app, pack):
    app.canvas.refine(specked())  # the finer pack is on its way to the GPU
    app.run("erase")
    assert "is not complete yet" in app.messages.dialogs.pop().text and not app.erasing.tool
    ui.settle()
    app.run("save-edited")
    assert "nothing was erased" in app.messages.dialogs.pop().text
    app.run("select-inside")
    assert "there is no crop box" in app.messages.dialogs.pop().text
    app.show(pack, Path("nowhere"), "toy")
    app.run("erase")
    assert "is not a pack on disk" in app.messages.dialogs.pop().text and not app.erasing.tool
    with pytest.raises(UserError):
        app.erasing.change(app, "grow")
