"""How long the stages of a bake take."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

STAGE = "baking"  # in what programs that started us read of our progress


class Stages:
    """Seconds spent in each stage of a bake, by name, in order."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        started = time.monotonic()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - started
