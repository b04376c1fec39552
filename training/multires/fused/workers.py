"""A few threads that share the parts of a step. Compiled loops run without Python's lock, so these are real cores.

Python's own threads sleep between parts; OpenMP's spin, which on two cores costs more than the work that they wait for.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Workers:
    """count: threads, this one included."""

    def __init__(self, count: int | None = None) -> None:
        self.count = max(1, count or cores())
        self._pool = ThreadPoolExecutor(self.count - 1) if self.count > 1 else None

    def share(self, parts: int, work: Callable[[int, int], None]) -> None:
        """Calls work(worker, part) for each part once, in order of parts as workers come free; returns when all are done."""
        claimed = itertools.count()  # next() is atomic

        def run(worker: int) -> None:
            while (part := next(claimed)) < parts:
                work(worker, part)

        others = [self._pool.submit(run, worker) for worker in range(1, min(self.count, parts))] if self._pool else []
        run(0)
        for other in others:
            other.result()
