"""What the live scripts share: a window that lives on while something happens, and another program on its display."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import glfw

from viewer.window.window import Window

CLIENT = Path(__file__).with_name("x11_client.py")


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
