"""How long work still takes, told from how fast its latest units were finished."""

from __future__ import annotations

import math
from collections import deque

LEAST_UPDATES, LEAST_S = 3, 5.0  # known of the work, before an estimate means something
LATEST_S, LATEST_SHARE = 30.0, 0.5  # the latest part of the work, whose speed counts: the longer of the two
SMOOTHED_S = 10.0  # over which the expected end follows what is measured


class Estimate:
    """When work of `total` units ends, in seconds of the caller's clock.

    The time until the first update does not count: programs are compiled in it, and what was done before comes with it.
    Between updates the time left falls as time passes.
    """

    def __init__(self, total: float) -> None:
        self._total = total
        self._updates: deque[tuple[float, float]] = deque()  # (time, units done), the latest part of the work
        self._began: float | None = None
        self._end: float | None = None

    def update(self, now: float, done: float) -> None:
        """So many units are done."""
        if self._began is None:
            self._began = now
        elif done <= self._updates[-1][1]:
            return
        before = self._updates[-1][0] if self._updates else now
        self._updates.append((now, done))
        oldest = now - max(LATEST_S, LATEST_SHARE * (now - self._began))
        while len(self._updates) > LEAST_UPDATES and self._updates[1][0] <= oldest:
            self._updates.popleft()
        started, done_then = self._updates[0]
        if len(self._updates) < LEAST_UPDATES or now - started < LEAST_S:
            return
        end = now + (self._total - done) * (now - started) / (done - done_then)
        if self._end is None:
            self._end = end
        else:
            self._end += (1.0 - math.exp((before - now) / SMOOTHED_S)) * (end - self._end)

    def pause(self, seconds: float) -> None:
        """Other work took so long; what is left of this one takes as long as before."""
        self._updates = deque((time + seconds, done) for time, done in self._updates)
        self._began = None if self._began is None else self._began + seconds
        self._end = None if self._end is None else self._end + seconds

    def left(self, now: float) -> float | None:
        """Seconds, 1 at least; None while too little is known, and where the work takes longer than was expected."""
        return None if self._end is None or self._end < now + 1.0 else self._end - now
