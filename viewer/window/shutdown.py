"""Signals and lost displays while the window is open.

They end the program like Quit: preferences are saved, and a running job is asked to save. No question is shown, because nobody
may be there to answer.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALED = 128  # exit status of a program that a signal ended: 128 + its number, as shells say it
HUNG_UP = SIGNALED + 1  # SIGHUP's
ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGINT", "SIGBREAK") if hasattr(signal, name)]
_kept: list[object] = []  # keeps handlers for C code from garbage collection


@contextmanager
def signals_ask(ask: Callable[[], None]) -> Iterator[list[int]]:
    """Within the block, a signal that would end the program calls `ask`; a second one ends it at once. Yields its number, once
    one has come.
    """
    ended: list[int] = []
    before: dict[int, object] = {}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  (as signal.signal gave it)

    def came(number: int, _: FrameType | None) -> None:
        ended.append(number)
        restore()
        ask()

    for number in ENDING:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):  # as under nohup
            before[number] = signal.signal(number, came)
    try:
        yield ended
    finally:
        restore()


def on_lost_display(end: Callable[[], None]) -> None:
    """Calls `end`, which may not talk to the display, when the X connection breaks; Xlib itself would end the program."""
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return

    def lost(_: object) -> int:
        try:
            end()
            print("snerg-view: the connection to the display is lost; settings are saved", file=sys.stderr, flush=True)
        finally:
            os._exit(HUNG_UP)  # Xlib must not go on, and Python's own end would close the window, through Xlib

    handler = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(lost)
    _kept[:] = [handler]
    x11.XSetIOErrorHandler.restype = ctypes.c_void_p
    x11.XSetIOErrorHandler(handler)
