"""Progress of long work: a live bar on a terminal, plain lines elsewhere, both with the time left once it is known."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as RichProgress

from console.progress_protocol import Report, in_words, write_report

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

    def left(self, now: float) -> float | None:
        """Seconds, 1 at least; None while too little is known, and where the work takes longer than was expected."""
        return None if self._end is None or self._end < now + 1.0 else self._end - now


# --- Progress of long work ---

PLAIN_LINE_EVERY_S = 10.0
PLAIN_QUIET_S = 2.0  # work done sooner needs no line
REPORTED_EVERY_S = 0.25
BEAT_S = 1.0  # from one look at the clock to the next, while the work says nothing
_listeners: list[Callable[[Report], None]] = []  # of programs that called us; reports go to the last
_running: list[Progress] = []  # what is shown, each within the one before it


class Progress:
    """One running piece of work of `total` units; `update(done, note)` may be called as often as is handy.

    begun: units that were done before this process took the work up again: it goes on from its place in the whole, and
    the time left is estimated from what is done since.
    """

    def __init__(
        self, title: str, total: float, begun: float, stage: str | None, on_report: Callable[[Report], None] | None
    ) -> None:
        self.title, self.total, self.done, self.note = title, total, begun, ""
        self.metrics: Mapping[str, float] = {}
        self.begun = begun
        self.started = time.monotonic()
        self.paused = 0.0  # seconds of work within it with progress of its own; the estimate leaves them out
        self._estimate = Estimate(total)
        self._lock = threading.RLock()  # updates come from one thread, and as time passes from another
        self._stage, self._on_report, self._reported = stage or title, on_report, -math.inf
        self.report(at_once=True)

    @property
    def seconds_left(self) -> float | None:
        """An estimate; None while too little is known for one."""
        return self._estimate.left(time.monotonic() - self.paused) if self.done < self.total else None

    @property
    def time_left(self) -> str:
        """In words; "" while too little is known."""
        left = self.seconds_left
        return "" if left is None else f"{duration(left)} left"

    def update(self, done: float, note: str = "", metrics: Mapping[str, float] | None = None) -> None:
        """`done` units of `total` are finished. metrics: figures by name (console.progress_protocol.METRICS), shown where there
        is no `note`, a short text of its own.
        """
        with self._lock:
            self.done, self.metrics = done, metrics or {}
            self.note = note or in_words(self.metrics)
            if done > self.begun:
                self._estimate.update(time.monotonic() - self.paused, done)
            self.report(at_once=done >= self.total)
            self._show(updated=True)

    def beat(self) -> None:
        """Time passes, whether or not anything is finished."""
        with self._lock:
            self.report()
            self._show(updated=False)

    def _show(self, updated: bool) -> None:
        """For those that show it. updated: more is done; else time passes."""

    def report(self, *, at_once: bool = False) -> None:
        """Reports, unless that was done a moment ago; what follows a first report at once is reported as well."""
        now, left = time.monotonic(), self.seconds_left
        if self._on_report is None or (now - self._reported < REPORTED_EVERY_S and not at_once):
            return
        self._reported = self._reported if at_once else now
        self._on_report(Report(
            self.title, float(self.done), float(self.total), self.note, round(now - self.started, 2), self._stage, self.metrics,
            begun=float(self.begun), seconds_left=None if left is None else round(left, 2),
        ))  # fmt: skip

    def advance(self, metrics: Mapping[str, float] | None = None) -> None:
        """One more unit is finished."""
        self.update(self.done + 1, metrics=metrics)


class _Live(Progress):
    """A bar on a terminal, among others where it is part of other work."""

    def __init__(self, bars: RichProgress, title: str, total: float, begun: float, *named: Any) -> None:
        super().__init__(title, total, begun, *named)
        self.bars, self._task = bars, bars.add_task(title, total=total, completed=int(begun), work=self)

    def _show(self, updated: bool) -> None:
        self.bars.update(self._task, completed=self.done)


class _Plain(Progress):
    _printed: float | None = None  # when the last line was
    _finished = False

    def _show(self, updated: bool) -> None:
        now, finished = time.monotonic(), self.done >= self.total
        if self._printed is None:
            early = now - self.started < (PLAIN_QUIET_S if updated else PLAIN_LINE_EVERY_S)
        else:
            early = now - self._printed < PLAIN_LINE_EVERY_S and not (finished and updated)
        if self._finished or early:
            return
        self._printed, self._finished = now, finished
        share = 100.0 if finished else 100 * self.done / self.total
        times = ", ".join(filter(None, (duration(now - self.started), self.time_left)))
        print(f"{self.title}: {share:.0f} %  {times}  {self.note}".rstrip(), file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """Time in the two units that matter: "7 s", "3 min 20 s", "1 h 05 min"."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


@contextmanager
def progress(
    title: str, total: float, quiet: bool = False, *, begun: float = 0.0, stage: str | None = None
) -> Iterator[Progress]:
    """Shows `title` with a bar (terminal) or a line every ten seconds (no terminal), on stderr; nothing where quiet.

    begun: how much of `total` was done before; see Progress. A program that started us can read it from a file as well; see
    console.progress_protocol. stage: what the work is part of, for such a program; the title where nothing is said. Work may
    be part of other work: as long as it runs, it is what is shown.
    """
    if quiet or _listeners:
        yield Progress(title, total, begun, stage, None if quiet else _listeners[-1])
        return
    outer = _running[-1] if _running else None
    with ExitStack() as stack:
        if not sys.stderr.isatty():
            work: Progress = _Plain(title, total, begun, stage, write_report)
        else:
            bars = outer.bars if isinstance(outer, _Live) else stack.enter_context(_bars())
            work = _Live(bars, title, total, begun, stage, write_report)
        stack.enter_context(_in_time(work))
        yield work
        work.report(at_once=True)


def _bars() -> RichProgress:
    return RichProgress(
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("{task.fields[work].time_left}", markup=False), TextColumn("{task.fields[work].note}", markup=False),
        console=Console(stderr=True),
    )  # fmt: skip


@contextmanager
def reported_to(on_progress: Callable[[Report], None]) -> Iterator[None]:
    """Within the `with` block, work calls `on_progress`, in its own thread, and shows nothing. What that raises ends the work."""
    _listeners.append(on_progress)
    try:
        yield
    finally:
        _listeners.remove(on_progress)


@contextmanager
def _in_time(work: Progress) -> Iterator[None]:
    """Another thread tells `work` that time passes, unless other work runs within it."""
    over = threading.Event()

    def beat() -> None:
        while not over.wait(BEAT_S):
            if _running and _running[-1] is work:
                work.beat()

    _running.append(work)
    clock = threading.Thread(target=beat, name="snerg-progress", daemon=True)
    clock.start()
    try:
        yield
    finally:
        over.set()
        clock.join()
        _running.remove(work)
        for outer in _running:
            outer.paused += time.monotonic() - work.started
