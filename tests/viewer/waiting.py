"""Waiting for threads, without a guess at how long they take, and not waiting for a camera."""

import time
from collections.abc import Callable
from pathlib import Path
from types import MethodType
from typing import Any, TypeVar

from viewer.app.application import App
from viewer.features.camera.orbit_camera import OrbitCamera

LONGEST_S = 120.0
T = TypeVar("T")


def not_none(thing: T | None) -> T:
    """`thing`, which must not be None; type checkers then know that it is not."""
    assert thing is not None
    return thing


def until(happened: Callable[[], Any], longest_s: float = LONGEST_S) -> Any:
    """What `happened` gives once that is true; fails after so long."""
    end = time.monotonic() + longest_s
    while not (found := happened()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)
    return found


def live(app: App, happened: Callable[[], Any], longest_s: float = LONGEST_S) -> None:
    """Lets time pass for the app until something is so."""
    until(lambda: app.tick(0.02) or happened(), longest_s)


def is_gone(process: int) -> bool:
    """Whether a process has ended, waited for or not."""
    try:
        status = Path(f"/proc/{process}/stat").read_text()
    except OSError:  # it may end while it is read
        return True
    return status.rpartition(")")[2].split()[0] == "Z"


def at_once(move: MethodType, *words: object) -> None:
    """Calls a method of an OrbitCamera that moves it, and has it arrive."""
    move(*words)
    rig = move.__self__
    assert isinstance(rig, OrbitCamera)
    rig.shown = rig.goal
