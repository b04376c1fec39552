"""Waiting for threads, without a guess at how long they take."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

LONGEST_S = 120.0


def until(happened: Callable[[], Any]) -> Any:
    """What `happened` gives once that is true; fails after LONGEST_S."""
    end = time.monotonic() + LONGEST_S
    while not (found := happened()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)
    return found
