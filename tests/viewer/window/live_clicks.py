"""Every button of every page, dialog and overlay is clicked by the X server's own mouse, at three sizes of the window.

The buttons are found, not listed: tests.viewer.window.widgets_seen sees each widget as it is drawn. What is scrolled out is
scrolled to with the wheel. Not collected by itself; see live_window.py.
"""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import glfw
import numpy as np
import pytest
from imgui_bundle import imgui

from scenepack import save_pack
from tests.viewer.conftest import toy_pack
from tests.viewer.scenes import photographed
from tests.viewer.unseen import draw_unseen
from tests.viewer.waiting import until
from tests.viewer.window.places import PLACES, WITHOUT_SCENE, Scenes, child
from tests.viewer.window.widgets_seen import Seen, Watch, inside
from viewer.app.application import App
from viewer.core import command_process
from viewer.features.making import make_plan, making, survey
from viewer.features.making.make_plan import Plan
from viewer.features.making.survey import Survey
from viewer.features.opening import opening
from viewer.interface.layout import NARROW
from viewer.rendering.settings import RenderSettings
from viewer.window.window import Window

SIZES = ((480, 360), (800, 600))
PATIENCE_S = 10.0
CLICK = ("click", "--delay", 1, 1)  # by itself, xdotool waits for a tenth of a second after each


@pytest.fixture(scope="module")
def scenes(watched, tmp_path_factory) -> Iterator[Scenes]:
    window, _ = watched
    folder, plain = tmp_path_factory.mktemp("clicks"), toy_pack()

    def render(view) -> np.ndarray:
        return window.canvas.snapshot(view, RenderSettings())

    window.canvas.show(plain)
    pack = photographed(plain, folder / "scene", 4, render)
    (folder / "scene" / "masks").mkdir()  # there is one more thing to choose
    save_pack(pack, folder / "toy")
    window.canvas.show(pack)
    plan = Plan("scene", folder / "scene", folder / "scene-snerg", survey=Survey(folder / "scene"))
    assert plan.survey is not None
    until(lambda: plan.survey.finished)
    plan.survey.forward = True
    release = threading.Event()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            imgui.backends, "opengl3_render_draw_data", draw_unseen
        )  # clicks are looked at here, not pictures
        patch.setattr(making, "CommandProcess", lambda *_: child())
        patch.setattr(command_process, "CommandProcess", lambda *_: child())
        patch.setattr(survey.webbrowser, "open", lambda address: True)
        patch.setattr(make_plan, "trainer_missing", lambda: False)  # nothing is trained here
        read = opening.load_pack

        def slow(path: Path, **options):
            release.wait(60)
            return read(path, **options)

        patch.setattr(opening, "load_pack", slow)
        yield Scenes(pack, toy_pack(seed=1), folder / "toy", folder / "scene", plan, release)
        release.set()


class Hand:
    """The real mouse over the window."""

    def __init__(self, window: Window, seen: Watch, xdotool: Callable[..., None], scenes: Scenes) -> None:
        self.window, self.watch, self.xdotool, self.scenes = window, seen, xdotool, scenes
        self.asked = False

    def frames(self, count: int = 1) -> None:
        for _ in range(count):
            self.window.app.touch(1)
            self.window.step()

    def until(self, condition: Callable[[], bool], least: int = 40) -> bool:
        """Frames until `condition` holds; False if it does not within the patience, and within so many frames."""
        end, drawn = time.monotonic() + PATIENCE_S, 0
        while not condition():
            if time.monotonic() > end and drawn >= least:
                return False
            self.frames()
            drawn += 1
        return True

    def arrange(self, size: tuple[int, int], place: str) -> None:
        """A new app in the window, with that on the screen."""
        window, canvas = self.window, self.window.canvas
        window.app.making.job = None
        window.app.making.end_check()
        window.app.sharing.end()
        window.app.opening.cancel(window.app)
        if window.app.filming.export is not None:
            window.app.filming.cancel(window.app)
        imgui.set_current_context(window.ui.context)
        if self.popup:
            imgui.internal.close_popup_to_level(0, False)
        imgui.internal.clear_active_id()
        app = App()
        app.clipboard, window.app = window.app.clipboard, app
        app.resolution.rest_scale = 0.1  # what the picture looks like is tested elsewhere
        app.interface.layout_reset = True
        glfw.set_window_size(window.handle, *size)
        assert self.until(lambda: glfw.get_window_size(window.handle) == size)
        if place in WITHOUT_SCENE:
            canvas.show(None)
        else:
            if canvas.renderer is None or canvas.renderer.pack is not self.scenes.pack:
                canvas.show(self.scenes.pack)
            app.show(self.scenes.pack, self.scenes.path)  # without a canvas, for the card has it
        app.canvas = canvas
        self.frames(2)  # the usual layout is there before a page is moved out of it
        PLACES[place](app, self.scenes)
        self.settle()
        self.asked = self.popup

    def settle(self) -> None:
        """Frames until every widget stays where it is."""
        self.frames(3)
        places = None
        for _ in range(60):
            before, places = places, {name: each.rect for name, each in self.watch.seen.items()}
            if before == places:
                return
            self.frames()
        pytest.fail("the widgets do not come to rest")

    def finds(self, size: tuple[int, int], name: tuple[str, str]) -> bool:
        """Whether a widget can be pressed as things are after the last click, without arranging them anew."""
        self.settle()
        app, each = self.window.app, self.offered().get(name)
        return (
            each is not None
            and not each.disabled
            and glfw.get_window_size(self.window.handle) == size
            and app.loading is None
            and not app.interface.help_shown
            and self.popup == self.asked
        )

    def offered(self) -> dict[tuple[str, str], Seen]:
        """What a person could press, scrolling included: where a question is asked, only what belongs to it."""
        asked = any(each.modal for each in self.watch.seen.values())
        return {name: each for name, each in self.watch.seen.items() if each.modal or not asked}

    def scroll_to(self, name: tuple[str, str]) -> Seen:
        """Brings a widget into view with the wheel."""
        for _ in range(60):
            each = self.watch.seen.get(name)
            assert each is not None, f"{name} is gone"
            hiding = [rect for rect in each.scrolling if not inside(each.at, rect, 2.0)]
            if not hiding:
                assert each.in_view, f"{name} at {each.at} is cut off by its window, which shows {each.clip}"
                return each
            x0, y0, _, y1 = hiding[0]
            far = each.at[1] - 0.5 * (y0 + y1)
            notches = max(1, int(abs(far) / (5 * imgui.get_font_size())))
            self.point_at(x0 + 1, 0.5 * (y0 + y1))
            self.xdotool("click", "--repeat", notches, "--delay", 1, 5 if far > 0 else 4)
            self.settle()
        pytest.fail(f"{name} cannot be scrolled to")

    def point_at(self, x: float, y: float, *more: object) -> None:
        left, top = glfw.get_window_pos(self.window.handle)
        self.xdotool("mousemove", left + round(x), top + round(y), *more)

    def press(self, name: tuple[str, str]) -> None:
        """Clicks a widget, and waits until it says that it was pressed; once more where it moved from under the mouse meanwhile,
        or where the click closed a list that was open."""
        for _ in range(3):
            each, open_before = self.hover(name), self.popup
            self.watch.forget()
            self.xdotool(*CLICK)
            if self.until(lambda: name in self.watch.pressed):
                return
            now = self.watch.seen.get(name)
            if now is not None and now.rect == each.rect and self.popup == open_before:
                break
        under = imgui.get_current_context().hovered_window
        pytest.fail(f"{name} at {each.at} takes no click; under the mouse is {under.name if under else 'nothing'}")

    @property
    def popup(self) -> bool:
        """Whether a dialog or a list is open."""
        return imgui.is_popup_open("", imgui.PopupFlags_.any_popup)

    def hover(self, name: tuple[str, str]) -> Seen:
        """Moves the mouse onto a widget, and after it where it moves meanwhile."""
        width, height = glfw.get_window_size(self.window.handle)
        for _ in range(10):
            each = self.scroll_to(name)
            assert inside(each.at, (0, 0, width, height)), f"{name} is outside of the window, at {each.at}"
            x, y = (round(at) for at in each.at)
            self.point_at(x, y)
            mouse = imgui.get_io().mouse_pos
            there = self.until(lambda x=x, y=y, mouse=mouse: abs(mouse.x - x) < 1 and abs(mouse.y - y) < 1)
            assert there, f"the mouse is at {mouse}"
            self.frames()
            now = self.watch.seen.get(name)
            if now is not None and now.rect == each.rect:
                return now
        pytest.fail(f"{name} does not come to rest")


clicked: dict[tuple[int, int], set[tuple[str, str]]] = {size: set() for size in SIZES}
greyed: dict[tuple[int, int], set[tuple[str, str]]] = {size: set() for size in SIZES}


@pytest.fixture
def hand(watched, scenes, xdotool) -> Hand:
    return Hand(*watched, xdotool, scenes)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_every_widget_takes_a_click(hand, size, place):
    hand.arrange(size, place)
    offered = hand.offered()
    assert offered, "nothing to press was found"
    greyed[size] |= {name for name, each in offered.items() if each.disabled}
    wanted = [name for name, each in offered.items() if not each.disabled and name not in clicked[size]]
    for name in wanted:
        if not hand.finds(size, name):
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
    assert hand.window.ctx.error == "GL_NO_ERROR"


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_all_that_was_grey_somewhere_was_clicked_elsewhere(size):
    """And the tests before did see the whole interface."""
    if len(clicked[size]) < 20:
        pytest.skip("the clicks of this size were not run")
    missed = greyed[size] - clicked[size]
    assert not missed
    assert len(clicked[size]) > (120 if size[0] >= NARROW else 40)
