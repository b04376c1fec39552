"""The window that all live tests share, on a display of our own, with its mouse and keyboard."""

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import glfw
import pytest
from imgui_bundle import imgui

from scenepack import Pack
from tests.viewer.conftest import installed
from viewer.app.application import App
from viewer.window.window import Window

SIZE = (900, 600)
PATIENCE_S = 90.0


def pump(window: Window, seconds: float = 0.25) -> None:
    """Lets the window live for a moment."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        window.app.touch(1)
        window.step()


def wait(window: Window, condition: Callable[[], object]) -> None:
    """Lets the window live until something is so."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, [dialog.text for dialog in window.app.messages.dialogs]
        pump(window, 0.05)


@pytest.fixture
def xdotool(display: str) -> Callable[..., None]:
    """Moves the mouse and presses keys on our display."""
    program = installed("xdotool")

    def call(*words: object) -> None:
        command = [program, *(str(word) for word in words)]
        subprocess.run(command, check=True, env={**os.environ, "DISPLAY": display}, stdout=subprocess.DEVNULL)

    return call


@pytest.fixture(scope="session")
def opened(display: str) -> Iterator[Window]:
    """The window. Opening one takes longer than most tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DISPLAY", display)
        patch.delenv("WAYLAND_DISPLAY", raising=False)
        with Window(App(), SIZE) as window:
            window.ui.file_dialogs.native = False
            yield window


@pytest.fixture
def start_page(opened: Window) -> Iterator[Window]:
    """The window with a new app, at its start page; what is being made ends with it."""
    imgui.set_current_context(opened.ui.context)
    opened.canvas.show(None)
    app = App(canvas=opened.canvas)
    app.clipboard, app.keyboard, opened.app = opened.app.clipboard, opened.app.keyboard, app
    glfw.set_window_size(opened.handle, *SIZE)
    opened.draw_frames(3)
    yield opened
    app.making.end()


@pytest.fixture
def act(start_page: Window, xdotool: Callable[..., None]) -> Callable[..., object]:
    """As xdotool; then the window lives for a moment."""
    return lambda *words: (xdotool(*words), pump(start_page))


@pytest.fixture
def window(start_page: Window, pack: Pack, pack_folder: Path) -> Window:
    """The window with the toy open."""
    start_page.app.show(pack, pack_folder)
    start_page.draw_frames(3)
    return start_page
