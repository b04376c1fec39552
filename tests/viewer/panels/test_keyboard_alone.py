"""Every dialog can be opened, gone through and answered without a mouse."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from imgui_bundle import imgui

from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.waiting import until
from training.scenes.procedural import write_procedural_scene
from viewer.app.application import App
from viewer.app.commands import run
from viewer.app.files import FileRequest
from viewer.app.make_plan import Plan, Survey
from viewer.panels import keys

WIDGETS = ("button", "invisible_button", "selectable", "checkbox", "slider_float", "slider_int", "input_text",
           "input_text_with_hint", "begin_combo")  # fmt: skip
MOST_TABS = 40
QUESTION = (("Keep going", ""), ("Stop and quit", "stop-and-quit"))


@contextmanager
def focus(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[set[str], list[str]]]:
    """Enabled widgets of the dialog on top, by label, and those that the keyboard came to, in their order."""
    there: set[str] = set()
    reached: list[str] = []

    def wrap(name: str) -> None:
        original: Callable = getattr(imgui, name)

        def call(label: str, *words, **named):
            result = original(label, *words, **named)
            window = imgui.internal.get_current_window_read()
            if window.root_window.flags & imgui.WindowFlags_.modal and not (
                imgui.get_item_flags() & imgui.ItemFlags_.disabled
            ):
                there.add(label)
                typed_into = imgui.is_item_active()  # a field
                if (typed_into or (imgui.is_item_focused() and imgui.get_io().nav_visible)) and reached[-1:] != [label]:
                    reached.append(label)
            return result

        monkeypatch.setattr(imgui, name, call)

    for name in WIDGETS:
        wrap(name)
    yield there, reached


@pytest.fixture(scope="module")
def photographs(tmp_path_factory) -> Path:
    return write_procedural_scene(tmp_path_factory.mktemp("photographs") / "still", size=32, views=4, subpixels=1)


def failure(app: App, scene: Path) -> None:
    app.messages.fail("It cannot be opened", "the file is no pack")


def question(app: App, scene: Path) -> None:
    app.messages.fail("Still being made", "Quitting stops it.", buttons=QUESTION)


def opening(app: App, scene: Path) -> None:
    app.preferences.opened(scene)
    run(app, "open")


def saving(app: App, scene: Path) -> None:
    app.file_request = FileRequest("Save", "save", lambda path: None, (".png",), "a.png")


def making(app: App, scene: Path) -> None:
    app.making.plan = Plan("scene", scene, scene.parent / "out", survey=Survey(scene))
    until(lambda: app.making.plan.survey.finished)


def baking(app: App, scene: Path) -> None:
    app.making.plan = Plan("run", scene.parent / "run", scene.parent / "baked")


@pytest.mark.parametrize("ask", [failure, question, opening, saving, making, baking])
def test_tab_comes_to_every_widget_and_escape_declines(
    offscreen, app, pack, pack_folder, photographs, ask, monkeypatch
):
    ui: OffscreenUi = offscreen(app, size=(800, 600))
    app.resolution.rest_scale = 0.25
    app.show(pack, pack_folder)
    ui.settle()
    with focus(monkeypatch) as (there, reached):
        ask(app, photographs)
        for _ in range(3):
            ui.frame()
        for _ in range(MOST_TABS):
            ui.key(imgui.Key.tab)
            if there <= set(reached):
                break
        assert there and there <= set(reached), there - set(reached)
    assert app.interface.panels_shown  # Tab was the dialog's
    for _ in range(2):  # the first may end typing
        ui.key(imgui.Key.escape)
    assert not keys.busy(app) and ui.ctx.error == "GL_NO_ERROR"


def test_enter_presses_what_tab_came_to_and_else_the_main_button(offscreen, app, pack, pack_folder):
    ui: OffscreenUi = offscreen(app, size=(800, 600))
    app.show(pack, pack_folder)
    stopped = []
    app.making.stop_and_quit = lambda host: stopped.append(True)
    question(app, pack_folder)
    for _ in range(3):
        ui.frame()
    ui.key(imgui.Key.enter)
    assert not app.messages.dialogs and not stopped  # Keep going
    for presses in range(1, 4):
        question(app, pack_folder)
        for _ in range(3):
            ui.frame()
        for _ in range(presses):
            ui.key(imgui.Key.tab)
        ui.key(imgui.Key.enter)
        assert not app.messages.dialogs
    assert 1 <= len(stopped) <= 2  # every second widget
