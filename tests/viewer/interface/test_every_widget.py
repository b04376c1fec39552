"""Every button of every page, dialog and overlay takes a click, in a small and a middling window.

The buttons are found, not listed: tests.viewer.window.widgets_seen sees each widget as it is drawn. What is scrolled out is
scrolled to with the wheel.
"""

import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from imgui_bundle import imgui

from tests.viewer.interface.places import PLACES, WITHOUT_SCENE, Scenes
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.waiting import not_none, until
from tests.viewer.window.widgets_seen import Seen, Watch, inside, watch
from viewer.app.application import App
from viewer.core import widgets
from viewer.core.widgets import in_front
from viewer.interface.layout import NARROW
from viewer.rendering.offscreen import create_context

SIZES = ((480, 360), (800, 600))
Name = tuple[str, str]  # window, label


class Hand:
    """The mouse over the interface."""

    def __init__(self, ui: OffscreenUi, seen: Watch, scenes: Scenes) -> None:
        self.ui, self.watch, self.scenes = ui, seen, scenes
        self.asked = False

    def arrange(self, size: tuple[int, int], place: str) -> None:
        """A new app in the window, with that on the screen."""
        ui, old = self.ui, self.ui.app
        old.making.job = None
        old.making.end_check()
        old.sharing.end()
        old.opening.cancel(old)
        if old.filming.export is not None:
            old.filming.cancel(old)
        imgui.set_current_context(ui.ui.context)
        if self.popup:
            imgui.internal.close_popup_to_level(0, False)
        imgui.internal.clear_active_id()
        app = ui.app = App(canvas=ui.canvas)
        app.resolution.rest_scale = 0.1  # what the picture looks like is tested elsewhere
        app.interface.layout_reset = True
        ui.resize(*size)
        if place in WITHOUT_SCENE:
            ui.canvas.show(None)
        else:
            app.show(self.scenes.pack, self.scenes.path)
        self.ui.frames(2)  # the usual layout is there before a page is moved out of it
        PLACES[place](app, self.scenes)
        self.settle()
        self.asked = self.popup

    def settle(self) -> None:
        """Frames until every widget stays where it is."""
        self.ui.frames(3)
        places = None
        for _ in range(60):
            before, places = places, {name: each.rect for name, each in self.watch.seen.items()}
            if before == places:
                return
            self.ui.frames(1)
        pytest.fail("the widgets do not come to rest")

    def finds(self, size: tuple[int, int], name: Name) -> bool:
        """Whether a widget can be pressed as things are after the last click, without arranging them anew."""
        self.settle()
        app, each = self.ui.app, self.offered().get(name)
        usual = app.loading is None and not app.interface.help_shown and self.popup == self.asked
        return each is not None and not each.disabled and self.ui.size == size and usual

    def offered(self) -> dict[Name, Seen]:
        """What a person could press, scrolling included: where a question is asked, only what belongs to it."""
        asked = any(each.modal for each in self.watch.seen.values())
        return {name: each for name, each in self.watch.seen.items() if each.modal or not asked}

    @property
    def popup(self) -> bool:
        """Whether a dialog or a list is open."""
        return imgui.is_popup_open("", imgui.PopupFlags_.any_popup)

    def scroll_to(self, name: Name) -> Seen:
        """Brings a widget into view with the wheel."""
        for _ in range(60):
            each = self.watch.seen.get(name)
            assert each is not None, f"{name} is gone"
            hiding = [rect for rect in each.scrolling if not inside(each.at, rect, 2.0)]
            if not hiding:
                assert each.in_view, f"{name} at {each.at} is cut off by its window, which shows {each.clip}"
                assert inside(each.at, (0, 0, *self.ui.size)), f"{name} is outside of the window, at {each.at}"
                return each
            x0, y0, _, y1 = hiding[0]
            far = each.at[1] - 0.5 * (y0 + y1)
            notches = max(1, int(abs(far) / (5 * imgui.get_font_size())))
            self.ui.wheel(-notches if far > 0 else notches, x0 + 1, 0.5 * (y0 + y1))
            self.settle()
        pytest.fail(f"{name} cannot be scrolled to")

    def press(self, name: Name) -> None:
        """Clicks a widget, which must say that it was pressed; once more where the click closed a list that was open, or the
        widget moved from under the mouse."""
        each = self.scroll_to(name)
        for _ in range(3):
            self.ui.io.add_mouse_pos_event(*each.at)
            self.settle()  # what appears under the mouse may move it
            each, open_before = self.scroll_to(name), self.popup
            self.watch.pressed.clear()
            self.ui.click(*each.at)
            if name in self.watch.pressed:
                return
            now = self.watch.seen.get(name)
            if now is not None and now.rect == each.rect and self.popup == open_before:
                break
        under = imgui.get_current_context().hovered_window
        pytest.fail(f"{name} at {each.at} takes no click; under the mouse is {under.name if under else 'nothing'}")


@pytest.fixture(scope="module")
def hand(scenes) -> Iterator[Hand]:
    ctx = create_context()
    ui = OffscreenUi(ctx, App(), size=SIZES[0])
    ui.ui.file_dialogs.native = False
    with watch() as seen:
        yield Hand(ui, seen, scenes)
    ui.release()
    ctx.release()


# By place: what may lie under something else, and is clicked in other places
COVERED = {"review": {("##viewport", "##canvas")}}
clicked: dict[tuple[int, int], set[Name]] = {size: set() for size in SIZES}
greyed: dict[tuple[int, int], set[Name]] = {size: set() for size in SIZES}


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_every_widget_takes_a_click(hand, size, place):
    hand.arrange(size, place)
    offered = hand.offered()
    assert offered, "nothing to press was found"
    greyed[size] |= {name for name, each in offered.items() if each.disabled}
    done = clicked[size] | COVERED.get(place, set())
    wanted = [name for name, each in offered.items() if not each.disabled and name not in done]
    for name in wanted:
        if not hand.finds(size, name):
            hand.arrange(size, place)
        try:
            hand.press(name)
        except pytest.fail.Exception:  # a dialog may have opened, of work that an earlier click began
            hand.arrange(size, place)
            hand.press(name)
        clicked[size].add(name)
        if offered[name].kind == "begin_combo":
            hand.settle()
            for choice in [other for other in hand.watch.seen if other not in offered]:
                hand.arrange(size, place)
                hand.press(name)
                hand.settle()
                hand.press(choice)
                clicked[size].add(choice)
    assert hand.ui.ctx.error == "GL_NO_ERROR"


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_all_that_was_grey_somewhere_was_clicked_elsewhere(size):
    """And the tests before did see the whole interface."""
    if len(clicked[size]) < 20:
        pytest.skip("the clicks of this size were not run")
    missed = greyed[size] - clicked[size]
    assert not missed
    assert len(clicked[size]) > (120 if size[0] >= NARROW else 40)


# Every dialog can be opened, gone through and answered without a mouse


WIDGETS = ("button", "invisible_button", "selectable", "checkbox", "slider_float", "slider_int", "input_text",
           "input_text_with_hint", "begin_combo")  # fmt: skip
MOST_TABS = 40


def opening(app: App, scenes: Scenes) -> None:
    app.preferences.opened(scenes.photographs)
    app.run("open")


def exporting(app: App, scenes: Scenes) -> None:
    app.exporting.ask(app)
    until(lambda: app.exporting.tick(app) or not not_none(app.exporting.preview).working)


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
    assert not in_front(app)


def test_upright_photographs_are_as_large_as_their_longer_side(ui, app, scenes, monkeypatch):
    monkeypatch.setattr(scenes.plan.survey, "sizes", {1: (48, 64), 2: (24, 32)})
    making(app, scenes)
    assert [each.label for each in ui.widgets(" px##")] == ["32 px##Photographs", "64 px##Photographs"]


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


@pytest.mark.parametrize("frames", [0, 1, 2, 8])
def test_down_and_enter_within_one_slow_frame_open_the_picked_line(offscreen, app, tmp_path, monkeypatch, frames: int):
    """Of two scenes that were opened lately. frames: between Ctrl+O and the keys."""
    opened: list[Path] = []
    for name in "ba":
        (tmp_path / name).mkdir()
        (tmp_path / name / "transforms.json").write_text("{}")
        app.preferences.opened(tmp_path / name)
    monkeypatch.setattr(app, "drop", opened.extend)
    ui: OffscreenUi = offscreen(app, size=(800, 600))
    ui.frame()
    stroke(ui, imgui.Key.mod_ctrl, imgui.Key.o)
    ui.frames(frames)
    for key in (imgui.Key.down_arrow, imgui.Key.down_arrow, imgui.Key.enter):
        stroke(ui, key)
    ui.frame()
    assert opened == [tmp_path / "b"] and app.open_prompt is None
