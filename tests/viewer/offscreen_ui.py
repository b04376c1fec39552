"""The interface in a framebuffer, without a window: for pictures of it and for tests that press its buttons."""

import time
from collections.abc import Iterable, Sequence

import moderngl
import numpy as np
import pytest
from imgui_bundle import ImVec2, imgui

from tests.viewer.waiting import not_none
from tests.viewer.window.widgets_seen import Seen, watch
from viewer.app.application import App
from viewer.app.frame import is_waiting, unfinished
from viewer.core.input import KeyPress
from viewer.core.pose import project
from viewer.interface.ui import Ui
from viewer.rendering.canvas import Canvas
from viewer.rendering.opengl import free_framebuffer, read_pixels, unbind_framebuffers

FRAME_S = 1.0 / 60.0
NAMED = ("Escape", "Space", "Tab", "Home", "Delete", "Backspace", "Enter")
PLACES = {
    **{getattr(imgui.Key, name.lower()): name for name in NAMED},
    imgui.Key.page_up: "PageUp",
    imgui.Key.page_down: "PageDown",
    **{getattr(imgui.Key, f"{name.lower()}_arrow"): name for name in ("Left", "Right", "Up", "Down")},
    **{getattr(imgui.Key, f"f{i}"): f"F{i}" for i in range(1, 13)},
    **{getattr(imgui.Key, letter): letter.upper() for letter in "abcdefghijklmnopqrstuvwxyz"},
    **{getattr(imgui.Key, f"_{i}"): str(i) for i in range(10)},
}


def drawn_widths(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Widths of the texts that imgui draws from now on, by text."""
    widths: dict[str, float] = {}
    draw = imgui.text_unformatted

    def note(text: str) -> None:
        widths[text] = imgui.calc_text_size(text).x
        draw(text)

    monkeypatch.setattr(imgui, "text_unformatted", note)
    return widths


class OffscreenUi:
    """An App with its panels in a framebuffer of `size` (width, height in units) × `density` pixels per unit.

    scale: how many times larger than usual all that has a size in units is, as on a dense display under X11.
    """

    def __init__(
        self,
        ctx: moderngl.Context,
        app: App,
        size: tuple[int, int] = (1180, 760),
        density: float = 1.0,
        scale: float = 1.0,
    ) -> None:
        self.ctx, self.app, self.canvas = ctx, app, Canvas(ctx)
        self.canvas.rest_s = self.canvas.blend_s = 0.0  # nobody waits here
        app.canvas = self.canvas
        self.ui = Ui()
        self.density, self.scale = density, scale
        self.framebuffer: moderngl.Framebuffer | None = None
        self.resize(*size)

    def resize(self, width: int, height: int) -> None:
        """Another size of the pretended window, in units."""
        self.size = (width, height)
        old = self.framebuffer
        pixels = (round(width * self.density), round(height * self.density))
        self.framebuffer = self.ctx.simple_framebuffer(pixels)
        self.framebuffer.use()
        if old is not None:
            free_framebuffer(old)

    @property
    def io(self) -> imgui.IO:
        """Feed events here: add_mouse_pos_event and its like."""
        imgui.set_current_context(self.ui.context)
        return imgui.get_io()

    def frame(self, seconds: float = FRAME_S) -> None:
        """One frame: time passes, panels see the events, the picture is drawn. seconds: between frames.

        The panels' pixels are filled once somebody looks: see picture.
        """
        assert self.framebuffer is not None
        io = self.io
        io.display_size = ImVec2(float(self.size[0]), float(self.size[1]))
        io.display_framebuffer_scale = ImVec2(self.density, self.density)
        io.delta_time = seconds
        self.app.tick(seconds)
        self.canvas.sweep()
        self.ui.frame(self.app, self.canvas, self.scale)
        drawn = self.canvas.drawn
        self.framebuffer.use()
        # Into one pixel: in software, filling pixels is most of a frame. Textures of letters arrive with it; picture() draws the
        # same data whole.
        data = imgui.get_draw_data()
        whole = ImVec2(data.display_size.x, data.display_size.y)
        data.display_size = ImVec2(1.0, 1.0)
        imgui.backends.opengl3_render_draw_data(data)
        data.display_size = whole
        if drawn is not None:
            frame_ms = max(drawn[0], 1000.0 * seconds)
            self.app.times.add(frame_ms, *drawn)
            self.app.resolution.frame_ended(frame_ms)
        self.app.drew()

    def frames(self, count: int) -> None:
        for _ in range(count):
            self.frame()

    def settle(self, most: int = 400) -> None:
        """Frames until the picture is whole and nothing moves."""
        self.frames(3)
        for _ in range(most):
            self.frame()
            if not unfinished(self.app, self.canvas) and not self.app.frames_owed and not self.ui.hears:
                if not is_waiting(self.app):
                    break
                time.sleep(0.01)
        self.frames(2)  # figures that were measured at rest reach the screen with the frame after

    def picture(self) -> np.ndarray:
        """What the window would show, uint8 [height, width, 3]: the last frame, whose panels are drawn now."""
        assert self.framebuffer is not None
        imgui.set_current_context(self.ui.context)
        self.framebuffer.use()
        self.framebuffer.viewport = (0, 0, *self.framebuffer.size)
        self.framebuffer.clear(*self.ui.background, 1.0)
        self.ui.draw()
        return read_pixels(self.framebuffer, *self.framebuffer.size)

    def scene_picture(self) -> np.ndarray:
        """The part of picture() that shows the scene."""
        box, d = self.app.viewport, self.density
        rows = slice(round(box.y * d), round((box.y + box.height) * d))
        return self.picture()[rows, round(box.x * d) : round((box.x + box.width) * d)]

    def place_of(self, point: Sequence[float]) -> tuple[float, float]:
        """Where a point of the scene (grid frame) is in the window, units."""
        pixels, ahead = project(not_none(self.app.camera()), np.array([point]))
        assert ahead[0]
        x, y = (pixels[0] / self.density).tolist()
        return self.app.viewport.x + x, self.app.viewport.y + y

    def widgets(self, label: str) -> list[Seen]:
        """The widgets that can be pressed with that in their labels, in the order of their labels."""
        with watch() as seen:
            self.settle()
        return sorted((e for e in seen.seen.values() if label in e.label and not e.disabled), key=lambda e: e.label)

    def press(self, label: str) -> None:
        """Clicks the one widget whose label ends so."""
        (widget,) = [each for each in self.widgets(label) if each.label.endswith(label)]
        self.click(*widget.at)

    def click(self, x: float, y: float, button: int = 0) -> None:
        """Presses and lets go of a mouse button at a point (units), with the frames that imgui needs."""
        for down in (None, True, False):
            self.io.add_mouse_pos_event(x, y)
            if down is not None:
                self.io.add_mouse_button_event(button, down)
            self.frame()
        self.frame()

    def drag(self, points: Iterable[tuple[float, float]], button: int = 0) -> None:
        """Drags through points (units) with a button held."""
        points = list(points)
        self.io.add_mouse_pos_event(*points[0])
        self.frame()
        self.io.add_mouse_button_event(button, True)
        self.frame()
        for point in points[1:]:
            self.io.add_mouse_pos_event(*point)
            self.frame()
        self.io.add_mouse_button_event(button, False)
        self.frame()

    def pull(self, start: Sequence[float], end: Sequence[float], steps: int) -> None:
        """Drags slowly, as docking and gizmos want it: hovers for a moment first, and stays at the end before letting go."""
        self.io.add_mouse_pos_event(*start)
        self.frames(3)
        way = np.linspace(start, end, steps + 1).tolist()
        self.drag([*way, *[way[-1]] * 3])
        self.settle()

    def wheel(self, notches: float, x: float, y: float) -> None:
        """Turns the wheel over a point (units)."""
        self.io.add_mouse_pos_event(x, y)
        self.frame()
        self.io.add_mouse_wheel_event(0.0, notches)
        self.frame()

    def key(self, *keys: imgui.Key) -> None:
        """Presses keys together and lets go of them: modifiers first."""
        self.hold(*keys)
        self.frame()
        self.let_go(*keys)
        self.frames(2)

    def hold(self, *keys: imgui.Key) -> None:
        """Presses keys of a US keyboard, modifiers first, and draws nothing."""
        ctrl, shift = imgui.Key.mod_ctrl in keys, imgui.Key.mod_shift in keys
        for key in keys:
            place = PLACES.get(key, "")
            self.app.keyboard.down(place)
            self.ui.pressed(KeyPress(place, ctrl, shift))
            self.io.add_key_event(key, True)
        if keys[-1] == imgui.Key.slash and shift and not ctrl:
            self.ui.pressed(KeyPress(character="?"))

    def let_go(self, *keys: imgui.Key) -> None:
        """Lets go of keys, and draws nothing."""
        for key in keys:
            self.app.keyboard.up(PLACES.get(key, ""))
            self.io.add_key_event(key, False)

    def release(self) -> None:
        self.canvas.close()
        self.ui.release()
        if self.framebuffer is not None:
            unbind_framebuffers(self.ctx)
            free_framebuffer(self.framebuffer)
