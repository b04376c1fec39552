"""The window: GLFW, its OpenGL context, its loop, and what ends the program from outside. The only file that imports glfw.

Nothing is drawn while nothing changes: the loop sleeps in `wait_events` until an event, a thread or a running movement
asks for a frame. imgui_bundle brings the GLFW library, which the panels listen to, and must be imported before glfw.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import imgui_bundle  # noqa: F401  (see above; nothing of it is used here)
import moderngl
import numpy as np
from PIL import Image

from console import UserError
from console.errors import handle_notices
from console.streams import printable
from viewer.app.application import App
from viewer.app.frame import is_waiting, unfinished
from viewer.core.input import ControllerState, KeyPress, holds_command
from viewer.core.state import FRAMES_AFTER_EVENT
from viewer.interface.ui import SystemClipboard, Ui
from viewer.rendering.canvas import Canvas
from viewer.rendering.opengl import free_framebuffer, opengl_refusal, read_pixels, version_at
from viewer.rendering.software_rasteriser import finish

import glfw  # isort: skip  (after imgui_bundle)

PROGRAM = "snerg"
SMALLEST = (480, 360)
IDLE_WAIT_S = 1.0
MAKING_WAIT_S = 0.2  # while a scene is being made
BUSY_WAIT_S = 0.05  # while a thread works, or the full picture is about to be begun
LONGEST_STEP_S = 0.1  # after a pause, movements go on from where they were
CONTROLLERS_S = 1 / 60  # from one look at gamepads to the next
PAUSE_MS = 500.0  # what takes longer is no frame of a movement: a pack was opened, shaders were compiled
SETTLE_ROUNDS = 2  # what a first round finishes may ask for more
MODIFIERS = frozenset(
    getattr(glfw, f"KEY_{side}_{name}") for side in ("LEFT", "RIGHT") for name in ("CONTROL", "SHIFT", "ALT", "SUPER")
)
# Events that only wake the loop.
WAKING = "cursor_pos cursor_enter mouse_button scroll window_focus window_refresh framebuffer_size window_content_scale"
# GLFW's keys are places already; see viewer.core.input.
NAMED = "Escape Space Tab Home Delete Backspace Enter Left Right Up Down Page_Up Page_Down"
PUNCTUATION = "SEMICOLON COMMA PERIOD SLASH APOSTROPHE MINUS EQUAL LEFT_BRACKET RIGHT_BRACKET BACKSLASH GRAVE_ACCENT"
PLACES = {
    **{getattr(glfw, f"KEY_{name}"): name for name in "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"},
    **{getattr(glfw, f"KEY_F{i}"): f"F{i}" for i in range(1, 13)},
    **{getattr(glfw, f"KEY_{name.upper()}"): name.replace("_", "") for name in NAMED.split()},
    **{getattr(glfw, f"KEY_{name}"): name for name in PUNCTUATION.split()},
    **{getattr(glfw, f"KEY_KP_{i}"): f"Num{i}" for i in range(10)},
}
SIGNS = {"+": "Plus", "=": "Plus", "-": "Minus"}  # wherever the layout has them; = is + without Shift on many


class NoDisplay(Exception):
    """There is no window to be had here; the message says why, in one line."""


def require_display() -> None:
    """NoDisplay where no window can be opened, as far as is known beforehand.

    UserError on a desktop with Wayland alone, where imgui_bundle's GLFW knows X11 only: somebody waits for a window there.
    """
    if not sys.platform.startswith("linux") or os.environ.get("DISPLAY"):
        return
    if not os.environ.get("WAYLAND_DISPLAY"):
        raise NoDisplay("there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set)")
    if "Wayland" not in str(glfw.get_version_string()):
        raise UserError(
            "no window can be opened: it needs X11, and this desktop offers Wayland only (DISPLAY is not set)",
            remedy="install XWayland (Debian, Ubuntu: apt-get install xwayland), or use snerg-render",
        )


class Window(AbstractContextManager["Window"]):
    """A window on `app`; size: screen units. NoDisplay where there is no display, UserError where it lacks OpenGL."""

    def __init__(self, app: App, size: tuple[int, int] = (1280, 800)) -> None:
        self.app, self._placed = app, (0, 0, *size)
        self._touched = True
        self.handle = _open(size)
        self.ctx = moderngl.create_context(require=330)
        self.canvas = Canvas(self.ctx)
        app.canvas = self.canvas
        self._listen()
        self.ui = Ui(ctypes.cast(self.handle, ctypes.c_void_p).value or 0)
        app.keyboard.local_name, app.clipboard = _local_name, SystemClipboard()
        self._v_sync, self._title = True, PROGRAM
        self._last = time.monotonic()
        self._frame_began = time.perf_counter()  # what was waited for before a frame is none of its time

    def _listen(self) -> None:
        """Any event wakes the loop; imgui's own callbacks, set later, call these first."""

        def touched(*_: object) -> None:
            self._touched = True

        def dropped(_: object, paths: Any) -> None:
            self._touched = True
            self.app.drop([Path(path) for path in paths])

        for event in WAKING.split():
            getattr(glfw, f"set_{event}_callback")(self.handle, touched)
        glfw.set_key_callback(self.handle, self._key)
        glfw.set_char_callback(self.handle, self._character)
        glfw.set_drop_callback(self.handle, dropped)  # type: ignore[arg-type]  (the stub has the C signature)

    def _key(self, _: object, key: int, scancode: int, action: int, modifiers: int) -> None:
        self._touched = True
        if key in MODIFIERS:
            self.ui.modifier_changes()
        place, keyboard = PLACES.get(key, ""), self.app.keyboard
        if action == glfw.RELEASE:
            keyboard.up(place)
            return
        if action == glfw.PRESS:
            keyboard.down(place)
        name = _name(key, scancode) or place
        command = holds_command(name, bool(modifiers & glfw.MOD_CONTROL), bool(modifiers & glfw.MOD_SUPER))
        shift, alt = bool(modifiers & glfw.MOD_SHIFT), bool(modifiers & glfw.MOD_ALT)
        self.ui.pressed(KeyPress(name, command, shift, alt, repeat=action == glfw.REPEAT))

    def _character(self, _: object, code: int) -> None:
        self._touched = True
        self.ui.pressed(KeyPress(character=chr(code)))

    def run(self, each: Callable[[], None] = lambda: None) -> None:
        """Until the window is closed or the app quits. each: called in every turn of the loop, at least once a second."""
        with handle_notices(lambda text: self.app.messages.log(text, "warning"), show_too=True):
            while not self.app.quitting:
                self.step()
                each()
                if glfw.window_should_close(self.handle):
                    glfw.set_window_should_close(self.handle, False)
                    self.app.run("quit")

    def step(self) -> bool:
        """Waits for something to do, and draws a frame if there is; True where it drew."""
        app = self.app
        waits = not (app.wants_frame or self._touched or self.ui.hears or self.canvas.blending)
        if not waits:
            glfw.poll_events()
        elif is_waiting(app) or unfinished(self.app, self.canvas) or self.ui.changes_soon:
            glfw.wait_events_timeout(BUSY_WAIT_S)
        elif app.controllers.present:  # they wake nobody
            glfw.wait_events_timeout(CONTROLLERS_S)
        elif app.making.busy:
            glfw.wait_events_timeout(MAKING_WAIT_S)
        else:
            glfw.wait_events_timeout(0.4 if self.ui.typing else IDLE_WAIT_S)
            self._last = max(self._last, time.monotonic() - 1 / 60)
        if waits:
            self._frame_began = time.perf_counter()
        if self._touched:
            self._touched = False
            app.touch()
        now = time.monotonic()
        seconds = min(now - self._last, LONGEST_STEP_S)
        app.controllers.update(app, controllers_now(), seconds)
        app.tick(seconds)
        self._last = now
        ui = self.ui
        if not (app.wants_frame or unfinished(app, self.canvas) or ui.typing or ui.hears or ui.changes_soon):
            return False
        self._frame()
        return True

    def _frame(self) -> None:
        """The panels, and the picture as they come to it; then the screen."""
        app = self.app
        self._follow_full_screen()
        title = PROGRAM if app.scene is None else f"{app.scene.name} – {PROGRAM}"
        if title != self._title:
            self._title = title
            glfw.set_window_title(self.handle, printable(title))
        if app.interface.v_sync != self._v_sync:
            self._v_sync = app.interface.v_sync
            glfw.swap_interval(int(self._v_sync))
        scale_x, _ = glfw.get_window_content_scale(self.handle)
        pixels, units = glfw.get_framebuffer_size(self.handle), glfw.get_window_size(self.handle)
        if 0 in pixels or 0 in units:  # minimised
            glfw.wait_events_timeout(IDLE_WAIT_S)
            return
        self.canvas.sweep()
        self.ui.frame(app, self.canvas, scale=max(1.0, scale_x / (pixels[0] / units[0])))
        self.ctx.screen.use()
        self.ctx.screen.viewport = (0, 0, *pixels)
        self.ctx.screen.clear(*self.ui.background, 1.0)
        self.ui.draw()
        finish(self.ctx)
        finished = time.perf_counter()
        glfw.swap_buffers(self.handle)
        self._measure(finished, time.perf_counter())
        app.drew()

    def _measure(self, finished: float, shown: float) -> None:
        """Notes how long the frame took: its drawing until `finished`, and with the swap until `shown` (s)."""
        app, drawn = self.app, self.canvas.drawn
        frame_ms, swap_ms = 1000.0 * (shown - self._frame_began), 1000.0 * (shown - finished)
        self._frame_began = shown
        if drawn is None:
            return
        app.resolution.frame_ended(frame_ms, swap_ms)
        if frame_ms < PAUSE_MS:
            app.times.add(frame_ms, *drawn)
        app.touch(2)  # goes on at once; and the figures of the last frame are shown

    def _follow_full_screen(self) -> None:
        full = bool(glfw.get_window_monitor(self.handle))  # a null pointer where the window has a place of its own
        if self.app.interface.full_screen == full:
            return
        if full:
            glfw.set_window_monitor(self.handle, None, *self._placed, glfw.DONT_CARE)  # type: ignore[arg-type]
            return
        monitor = glfw.get_primary_monitor()
        if not monitor:
            self.app.interface.full_screen = False
            return
        self._placed = (*glfw.get_window_pos(self.handle), *glfw.get_window_size(self.handle))
        mode = glfw.get_video_mode(monitor)
        glfw.set_window_monitor(self.handle, monitor, 0, 0, *mode.size, mode.refresh_rate)

    # Pictures of the window

    def draw_frames(self, frames: int) -> None:
        """Draws `frames` frames one after the other, whether or not anything changes, then until all is sharp."""
        for _ in range(frames):
            self.app.touch(1)
            self.step()
        for _ in range(SETTLE_ROUNDS):
            self._wait_while(lambda: is_waiting(self.app) or unfinished(self.app, self.canvas) or self.ui.changes_soon)
            for _ in range(FRAMES_AFTER_EVENT + 1):  # figures are measured while nothing moves, and shown after that
                self.app.touch(1)
                self.step()

    def finish_export(self) -> None:
        """Runs until what is being exported is written, or has failed."""
        self._wait_while(lambda: self.app.filming.export is not None)

    def _wait_while(self, busy: Callable[[], bool]) -> None:
        while busy() and not glfw.window_should_close(self.handle):
            self.step()

    def screenshot(self) -> np.ndarray:
        """Scene and panels, uint8 [height, width, 3]."""
        width, height = glfw.get_framebuffer_size(self.handle)
        target = self.ctx.simple_framebuffer((width, height))
        try:
            target.use()
            target.clear(*self.ui.background, 1.0)
            self.ui.draw()
            return read_pixels(target, width, height)
        finally:
            free_framebuffer(target)

    def save_screenshot(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(self.screenshot()).save(path)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in screen units, as they were before full screen."""
        return self._placed[2:4] if glfw.get_window_monitor(self.handle) else glfw.get_window_size(self.handle)

    @property
    def layout(self) -> str:
        return self.ui.layout if self.ui.scale else self.app.interface.layout

    def __exit__(self, *_: object) -> None:
        for part in (self.app.making, self.app.exporting, self.app.sharing):
            part.end()
        self.app.canvas = None
        self.canvas.close()
        self.ui.release()
        self.ctx.release()
        glfw.destroy_window(self.handle)
        glfw.terminate()


def controllers_now(glfw: Any = glfw) -> list[ControllerState]:
    """What the gamepads and other joysticks of this computer say at this moment."""
    found = []
    for number in range(glfw.JOYSTICK_1, glfw.JOYSTICK_LAST + 1):
        if not glfw.joystick_present(number):
            continue
        state = glfw.get_gamepad_state(number) if glfw.joystick_is_gamepad(number) else None
        if state is not None:
            name, axes, buttons = glfw.get_gamepad_name(number), tuple(state.axes), state.buttons
        else:
            name = glfw.get_joystick_name(number)  # arrays come with how many they hold
            axes, buttons = (
                tuple(float(values[i]) for i in range(count))
                for values, count in (glfw.get_joystick_axes(number), glfw.get_joystick_buttons(number))
            )
        pressed = tuple(bool(button) for button in buttons)
        found.append(ControllerState(_text_of(name), axes, pressed, gamepad=state is not None))
    return found


def _text_of(value: Any) -> str:
    """A string of GLFW's, which its bindings give as bytes at times."""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _version_at_hand() -> str:
    """What OpenGL a window may have here, where it is older than ours; "" where there is none."""
    glfw.default_window_hints()
    glfw.window_hint(glfw.VISIBLE, False)
    handle = glfw.create_window(16, 16, PROGRAM, None, None)
    if not handle:
        return ""
    glfw.make_context_current(handle)
    return version_at(ctypes.cast(glfw.get_proc_address("glGetString"), ctypes.c_void_p).value)


def _name(key: int, scancode: int) -> str:
    """The letter or digit that the user's layout gives a key; "" where it is neither, as on a Russian keyboard."""
    name, place = glfw.get_key_name(key, scancode) or "", PLACES.get(key, "")
    if name in SIGNS:
        return SIGNS[name]
    if key != glfw.KEY_UNKNOWN and (not place or place.startswith("Num")):  # the number block's digits are no others'
        return ""
    return name.upper() if len(name) == 1 and name.isascii() and name.isalnum() else ""


def _local_name(place: str) -> str:
    """What the user's layout prints at a place."""
    name = next((glfw.get_key_name(key, 0) for key, known in PLACES.items() if known == place), None)
    return name.upper() if name else place


def _open(size: tuple[int, int]):
    """An OpenGL 3.3 core window, its context current."""
    complaints: list[str] = []
    glfw.set_error_callback(lambda _code, text: complaints.append(_text_of(text)))
    glfw.ERROR_REPORTING = False
    if not glfw.init():
        raise NoDisplay(f"no window can be opened: {complaints[-1] if complaints else 'GLFW does not start'}")
    hints = {
        glfw.CONTEXT_VERSION_MAJOR: 3, glfw.CONTEXT_VERSION_MINOR: 3, glfw.OPENGL_PROFILE: glfw.OPENGL_CORE_PROFILE,
        glfw.OPENGL_FORWARD_COMPAT: True, glfw.VISIBLE: True, glfw.SCALE_TO_MONITOR: True, glfw.DEPTH_BITS: 0,
    }  # fmt: skip
    for hint, value in hints.items():
        glfw.window_hint(hint, value)
    for hint in (glfw.X11_CLASS_NAME, glfw.X11_INSTANCE_NAME, glfw.WAYLAND_APP_ID):  # what desktops group windows by
        glfw.window_hint_string(hint, PROGRAM)
    handle = glfw.create_window(*size, PROGRAM, None, None)
    if not handle:
        complaint = complaints[-1] if complaints else ""
        version = _version_at_hand()
        glfw.terminate()
        raise opengl_refusal(version, complaint, window=True)
    glfw.set_window_size_limits(handle, *SMALLEST, glfw.DONT_CARE, glfw.DONT_CARE)
    glfw.make_context_current(handle)
    glfw.swap_interval(1)
    return handle


# --- Signals and lost displays ---
#
# They end the program like Quit: preferences are saved, and a running job is asked to save. No question is shown, because nobody
# may be there to answer.

SIGNALED = 128  # exit status of a program that a signal ended: 128 + its number, as shells say it
ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGINT", "SIGBREAK") if hasattr(signal, name)]
_kept: list[object] = []  # keeps handlers for C code from garbage collection


@contextmanager
def signals_ask(ask: Callable[[], None]) -> Iterator[list[int]]:
    """Within the block, a signal that would end the program calls `ask`; a second one ends it. Yields a list for its number."""
    ended: list[int] = []
    with ExitStack() as before:

        def came(number: int, _: FrameType | None) -> None:
            ended.append(number)
            before.close()
            ask()

        for number in ENDING:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):  # as under nohup
                before.callback(signal.signal, number, signal.signal(number, came))
        yield ended


def on_lost_display(end: Callable[[], None]) -> None:
    """Calls `end`, which may not talk to the display, when the X connection breaks; Xlib itself would end the program."""
    if glfw.get_platform() != glfw.PLATFORM_X11:
        return
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return

    def lost(_: object) -> int:
        try:
            end()
            print("snerg-view: the connection to the display is lost; settings are saved", file=sys.stderr, flush=True)
        finally:
            # as if by SIGHUP; Xlib must not go on, and Python's own end would close the window, through Xlib
            os._exit(SIGNALED + 1)

    handler = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(lost)
    _kept[:] = [handler]
    x11.XSetIOErrorHandler.restype = ctypes.c_void_p
    x11.XSetIOErrorHandler(handler)
