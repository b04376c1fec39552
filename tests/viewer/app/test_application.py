"""The app without a window: opening, commands, messages."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from console import UserError
from scenepack import save_pack
from tests.scenepack.helpers import edit_json
from tests.viewer.conftest import toy_pack
from tests.viewer.waiting import live, until
from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.core.annotations import Bookmark
from viewer.core.pose import DEPTH, History
from viewer.core.tasks import Cancelled
from viewer.features.display.display import modes_for
from viewer.features.opening import opening as loading_module
from viewer.features.placing import placing
from viewer.interface.top_bar import state_of
from viewer.rendering.canvas import Canvas
from viewer.rendering.settings import MODES


class FakeCanvas(Canvas):
    """Draws grey pictures without OpenGL and remembers what it shows. refuse: a reason to refuse packs."""

    def __init__(self, refuse: str = "") -> None:
        self.shown, self.refuse, self.renderer = [], refuse, None

    def show(self, pack):
        if self.refuse:
            raise UserError(self.refuse)
        self.shown.append(pack)

    def refine(self, pack):
        self.shown[-1] = pack

    def show_other(self, pack):
        pass

    @property
    def refines(self) -> bool:
        return False

    def snapshot(self, camera, settings):
        return np.full((camera.height, camera.width, 3), 40, np.uint8)


@pytest.fixture
def open_app(pack, pack_folder) -> App:
    app = App(canvas=FakeCanvas())
    app.show(pack, pack_folder)
    return app


def test_the_bar_says_that_a_pack_is_uploaded_before_it_says_how_large_it_is(open_app, monkeypatch):
    monkeypatch.setattr(FakeCanvas, "refines", True)
    assert state_of(open_app) == "uploading to the graphics card"
    monkeypatch.undo()
    assert state_of(open_app) == "44 × 44 × 44 voxels"


def test_loading_can_be_cancelled(open_app, pack_folder, monkeypatch):
    go_on = threading.Event()

    def slow(path, *, on_progress, **_):
        go_on.wait(20)
        on_progress(1, 2)
        return toy_pack()

    monkeypatch.setattr(loading_module, "load_pack", slow)
    old = open_app.scene
    open_app.open(pack_folder)
    loading = open_app.loading
    open_app.opening.cancel(open_app)
    go_on.set()
    until(lambda: loading.finished)
    open_app.tick(0.01)
    assert open_app.scene is old and not open_app.messages.dialogs
    with pytest.raises(Cancelled):
        loading.result()


def test_every_command_runs_with_and_without_a_scene(open_app):
    for app in (open_app, App(canvas=FakeCanvas())):
        for name, command in COMMANDS.items():
            possible = app.scene is not None or not command.needs_scene
            app.clipboard.text = "1,2,3,0,0,0"
            assert app.run(name) == possible
            app.file_request = None
        assert not app.messages.dialogs


def test_a_command_that_fails_is_a_dialog_with_its_traceback_in_the_log(open_app, monkeypatch):
    monkeypatch.setattr(open_app.scene.rig, "home", lambda: 1 / 0)
    assert open_app.run("home")
    (dialog,) = open_app.messages.dialogs
    assert "first view" in dialog.title and dialog.text.startswith("This is a bug in snerg")
    assert any("test_application.py" in line.text for line in open_app.messages.lines)  # the traceback


def test_no_key_belongs_to_two_commands():
    keys = [key for command in COMMANDS.values() for key in command.keys]
    assert len(keys) == len(set(keys))


def test_modes_go_round_and_leave_out_what_the_pack_has_not(open_app):
    seen = set()
    for _ in MODES:
        seen.add(open_app.settings.mode)
        open_app.run("next-mode")
    assert seen == set(MODES) and open_app.settings.mode == "normal"
    open_app.set(mode="features")
    open_app.show(toy_pack(view_mlp=False), open_app.scene.path)
    assert open_app.settings.mode == "normal" and "features" not in modes_for(open_app)


def opened(app: App, path: Path) -> str:
    """The toast once the pack is open."""
    app.messages.toast = ""
    app.open(path)
    live(app, lambda: app.loading is None)
    return app.messages.toast


def test_repairs_are_reported_once_and_stay_in_the_log(pack, pack_folder, tmp_path):
    untidy = tmp_path / "untidy"  # its features are missing, and a number is wrong
    save_pack(pack, untidy)
    for file in untidy.glob("feature_*"):
        file.unlink()
    edit_json(untidy, lambda params: params.update(atlas_blocks_x=98))
    app = App(canvas=FakeCanvas())
    assert opened(app, pack_folder) == ""  # a sound pack
    notice = opened(app, untidy)
    assert "atlas_blocks" in notice and "feature_000.png is missing" in notice and app.messages.toast_level == "warning"
    assert str(untidy) not in notice and app.messages.toast_left > 5
    assert opened(app, untidy) == ""
    assert sum("feature_000.png" in line.text for line in app.messages.lines) == 2
    edit_json(untidy, lambda params: params.update(atlas_blocks_x=99))
    again = opened(app, untidy)
    assert "feature_000.png" not in again and again  # only what is new


STEPS: dict[str, Callable[[App, int], object]] = {
    "orbit": lambda app, i: (app.open_scene.rig.remember(), app.open_scene.rig.orbit(0.01 * (i + 1), 0.0)),
    "crop": lambda app, i: app.cut(crop=((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5 + 0.01 * i))),
    "near": lambda app, i: app.cut(near=0.1 * (i + 1)),
    "move": lambda app, i: placing.change(app, app.annotations.current.placement.with_angles(20.0 + i, 10.0, 0.0)),
    "mark": lambda app, i: app.annotations.change(app, replace(app.annotations.current, bookmarks=(mark(i),))),
    "home": lambda app, i: app.run("home"),
    "nothing": lambda app, i: app.open_scene.rig.remember(),
}


def mark(i: int) -> Bookmark:
    return Bookmark(f"{i}", (0.0, 1.0, 4.0), (0.0, 0.0, 0.0))


def state(app: App) -> tuple:
    rig, annotations = app.open_scene.rig, app.annotations.current
    assert rig.table.placed == annotations.placement.rotation
    return rig.goal, rig.table, annotations, app.settings.crop, app.settings.near


@given(st.lists(st.sampled_from(list(STEPS)), min_size=1, max_size=12))
def test_moves_cuts_marks_and_the_near_plane_are_undone_in_turn(pack, steps):
    app = App()
    app.show(pack, Path("toy"))
    states = [state(app)]
    for i, step in enumerate(steps):
        STEPS[step](app, i)
        if state(app) != states[-1]:
            states.append(state(app))
    for expected in reversed(states[:-1]):
        app.run("undo")
        assert state(app) == expected
    assert not app.open_scene.rig.history.undo()
    for expected in states[1:]:
        app.run("redo")
        assert state(app) == expected
    assert not app.open_scene.rig.history.redo()
    app.run("undo")
    app.cut(near=9.0)
    assert not app.open_scene.rig.history.redo(), "what was undone is forgotten after something new"


def test_the_oldest_moments_of_a_long_history_are_forgotten():
    value = [0]
    history = History()
    history.follow(lambda: value[0], lambda old: value.__setitem__(0, old))
    for i in range(2 * DEPTH):
        history.remember()
        value[0] = i + 1
    assert sum(iter(history.undo, False)) == DEPTH and value[0] == DEPTH
