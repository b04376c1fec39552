"""What the live scripts share: a window that lives on while something happens."""

import time
from collections.abc import Callable

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
