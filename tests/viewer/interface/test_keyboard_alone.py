"""Every dialog can be opened, gone through and answered without a mouse."""

import random
from pathlib import Path

import pytest
from imgui_bundle import imgui

from tests.viewer.interface.places import PLACES, Scenes
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.waiting import there, until
from tests.viewer.window.widgets_seen import watch
from viewer.app.application import App
from viewer.core import widgets
from viewer.core.widgets import in_front

WIDGETS = ("button", "invisible_button", "selectable", "checkbox", "slider_float", "slider_int", "input_text",
           "input_text_with_hint", "begin_combo")  # fmt: skip
MOST_TABS = 40
DOWN, ENTER = imgui.Key.down_arrow, imgui.Key.enter
CTRL_O = (imgui.Key.mod_ctrl, imgui.Key.o)


def opening(app: App, scenes: Scenes) -> None:
    app.preferences.opened(scenes.photographs)
    app.run("open")


def exporting(app: App, scenes: Scenes) -> None:
    app.exporting.ask(app)
    until(lambda: app.exporting.tick(app) or not there(app.exporting.preview).working)


failure, question, saving = PLACES["failure"], PLACES["question"], PLACES["path to save"]
making, baking = PLACES["make a scene"], PLACES["bake a run"]


@pytest.fixture
def ui(offscreen, app, pack, pack_folder) -> OffscreenUi:
    return offscreen(app, pack, pack_folder, size=(800, 600))


@pytest.mark.parametrize("ask", [failure, question, opening, saving, making, baking, exporting])
def test_tab_comes_to_every_widget_and_escape_declines(ui, app, scenes, ask):
    there: set[str] = set()
    reached: set[str] = set()
    with watch() as seen:
        ask(app, scenes)
        ui.frames(3)
        for _ in range(MOST_TABS):
            ui.key(imgui.Key.tab)
            enabled = [each for each in seen.seen.values() if each.modal and not each.disabled and each.kind in WIDGETS]
            there |= {each.label for each in enabled}
            reached |= {each.label for each in enabled if each.focused}
            if there <= reached:
                break
    assert there and there <= reached, there - reached
    assert app.interface.panels_shown  # Tab was the dialog's
    for _ in range(2):  # the first may end typing
        ui.key(imgui.Key.escape)
    assert not in_front(app) and ui.ctx.error == "GL_NO_ERROR"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_dialogs_that_are_asked_for_at_once_come_one_after_the_other(ui, app, scenes, seed):
    """Two modal windows pushed each other away in every frame: none was seen, and nothing reached either."""
    asks = [failure, opening, saving, making, exporting]
    if seed % 2:
        app.run("help")
    for ask in random.Random(seed).sample(asks, len(asks)):
        ask(app, scenes)
        ui.frame()
    answered = []
    while in_front(app):
        ui.frames(3)
        assert imgui.internal.get_top_most_popup_modal() is not None, "the dialog is there to be seen"
        answered.append(widgets.in_front(app))
        ui.key(imgui.Key.escape)
        assert len(answered) < 20
    assert [each for i, each in enumerate(answered) if answered[:i].count(each) == 0] == [
        "message", "path", "open", "make", "export"
    ]  # fmt: skip


def test_enter_presses_what_tab_came_to_and_else_the_main_button(ui, app, scenes):
    stopped = []
    app.making.stop_and_quit = lambda host: stopped.append(True)
    question(app, scenes)
    ui.frames(3)
    ui.key(imgui.Key.enter)
    assert not app.messages.dialogs and not stopped  # Keep going
    for presses in range(1, 4):
        question(app, scenes)
        ui.frames(3)
        for _ in range(presses):
            ui.key(imgui.Key.tab)
        ui.key(imgui.Key.enter)
        assert not app.messages.dialogs
    assert 1 <= len(stopped) <= 2  # every second widget


def stroke(ui: OffscreenUi, *keys: imgui.Key) -> None:
    """Keys down and up, without a frame."""
    ui.hold(*keys)
    ui.let_go(*reversed(keys))


@pytest.fixture
def two_scenes(app: App, tmp_path: Path, monkeypatch) -> tuple[Path, list[Path]]:
    """The folder of two scenes a and b that were opened lately, and what is opened from now on."""
    opened: list[Path] = []
    for name in "ba":
        (tmp_path / name).mkdir()
        (tmp_path / name / "transforms.json").write_text("{}")
        app.preferences.opened(tmp_path / name)
    monkeypatch.setattr(app, "drop", opened.extend)
    return tmp_path, opened


@pytest.mark.parametrize("frames", [0, 1, 2, 8])
def test_down_and_enter_within_one_slow_frame_open_the_picked_line(offscreen, app, two_scenes, frames: int):
    """frames: between Ctrl+O and the keys."""
    folder, opened = two_scenes
    ui: OffscreenUi = offscreen(app, size=(800, 600))
    ui.frame()
    stroke(ui, *CTRL_O)
    ui.frames(frames)
    for key in (DOWN, DOWN, ENTER):
        stroke(ui, key)
    ui.frame()
    assert opened == [folder / "b"] and app.open_prompt is None
