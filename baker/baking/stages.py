"""The stages of a bake: how far each is, and how long it takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from console import Progress, progress

STAGE = "baking"  # in what programs that started us read of our progress


class Stages:
    """Seconds spent in each stage of a bake, by name, in order."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str, total: float = 1.0) -> Iterator[Progress]:
        """A stage of so much work."""
        started = time.monotonic()
        with progress(name, total, stage=STAGE) as bar:
            yield bar
            bar.update(total)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - started
