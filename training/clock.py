"""How long a run has trained, over all its sittings, and how fast."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Clock:
    """seconds: wall time of the run. training_seconds: the same without what paused() spans (validation, reports)."""

    def __init__(self, seconds_before: float, training_before: float) -> None:
        self._start = time.monotonic() - seconds_before
        self._paused = seconds_before - training_before
        self._mark, self._marked_step = 0.0, None

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._start

    @property
    def training_seconds(self) -> float:
        return self.seconds - self._paused

    def steps_per_second(self, step: int) -> float | None:
        """Since it was asked last; None the first time, since that stretch holds the compilation."""
        now, rate = self.training_seconds, None
        if self._marked_step is not None and step > self._marked_step:
            rate = (step - self._marked_step) / max(now - self._mark, 1e-9)
        self._mark, self._marked_step = now, step
        return rate

    @contextmanager
    def paused(self) -> Iterator[None]:
        started = time.monotonic()
        try:
            yield
        finally:
            self._paused += time.monotonic() - started
