"""Waiting for threads, without a guess at how long they take."""

from __future__ import annotations

import time
from collections.abc import Callable

LONGEST_S = 120.0


def until(happened: Callable[[], bool]) -> None:
    """Returns once `happened` is true; fails after LONGEST_S."""
    end = time.monotonic() + LONGEST_S
    while not happened():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)
