"""What the live scripts share: a window that lives on while something happens, and another program on its display."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import glfw
import numpy as np
import pytest
from imgui_bundle import imgui

from tests.viewer.unseen import draw_unseen
from viewer.window.window import Window

SIZE = (900, 600)
PATIENCE_S = 90.0
CLIENT = Path(__file__).with_name("x11_client.py")


def draw_only_what_is_looked_at(patch: pytest.MonkeyPatch) -> None:
    """From now on windows draw their panels where a screenshot is taken, and unseen otherwise."""
    whole, screenshot = imgui.backends.opengl3_render_draw_data, Window.screenshot

    def looked_at(window: Window) -> np.ndarray:
        with pytest.MonkeyPatch.context() as meanwhile:
            meanwhile.setattr(imgui.backends, "opengl3_render_draw_data", whole)
            return screenshot(window)

    patch.setattr(imgui.backends, "opengl3_render_draw_data", draw_unseen)
    patch.setattr(Window, "screenshot", looked_at)


def pump(window: Window, seconds: float = 0.25) -> None:
    """Lets the window live for a moment."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        window.app.touch(1)
        window.step()


def other_program(display: str, window: Window, what: str, *words: object) -> None:
    """Another program on our display does `what` (see x11_client) to the window, which lives on meanwhile."""
    number = str(glfw.get_x11_window(window.handle))
    command = [sys.executable, str(CLIENT), what, number, *(str(word) for word in words)]
    client = subprocess.Popen(command, env={**os.environ, "DISPLAY": display}, stderr=subprocess.PIPE, text=True)
    while client.poll() is None:
        pump(window, 0.05)
    assert client.returncode == 0, client.stderr and client.stderr.read()
    pump(window, 0.1)


def wait(window: Window, condition: Callable[[], object]) -> None:
    """Lets the window live until something is so."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, [dialog.text for dialog in window.app.messages.dialogs]
        pump(window, 0.05)
