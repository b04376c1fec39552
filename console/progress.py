"""Progress of long work: a live bar on a terminal, plain lines elsewhere, both with the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

from console.driven import Report, Reporter, in_words, seconds_left

PLAIN_LINE_EVERY_S = 10.0
PLAIN_QUIET_S = 2.0  # work done sooner needs no line


class Progress:
    """One running piece of work of `total` units; `update(done, note)` may be called as often as is handy.

    begun: units that were done before this process took the work up again: it goes on from its place in the whole, and
    the time left is estimated from what is done since.
    """

    def __init__(self, title: str, total: float, begun: float = 0.0) -> None:
        self.title, self.total, self.done, self.note = title, total, begun, ""
        self.metrics: Mapping[str, float] = {}
        self.begun = begun
        self.started = time.monotonic()
        self._reporter: Reporter | None = None
        self._stage = title

    def update(self, done: float, note: str = "", metrics: Mapping[str, float] | None = None) -> None:
        """`done` units of `total` are finished. metrics: figures by name (console.driven.METRICS), shown beside where there
        is no `note`, a short text of its own.
        """
        self.done, self.metrics = done, metrics or {}
        self.note = note or in_words(self.metrics)
        self.report(at_once=done >= self.total)
        self._show()

    def resume_at(self, begun: float) -> None:
        """It turns out that so many units were done before."""
        self.begun = begun
        self.update(begun, self.note, self.metrics)

    def _show(self) -> None:
        """For those that show it."""

    def report_to(self, reporter: Reporter, stage: str) -> None:
        """Tells `reporter` of every update from now on."""
        self._reporter, self._stage = reporter, stage
        self.report(at_once=True)

    def report(self, *, at_once: bool = False) -> None:
        """Tells where the work is."""
        if self._reporter is not None:
            passed = time.monotonic() - self.started
            report = Report(
                self.title, float(self.done), float(self.total), self.note, round(passed, 2), self._stage, self.metrics,
                begun=float(self.begun),
            )  # fmt: skip
            self._reporter.tell(report, at_once=at_once)

    def advance(self, units: float = 1.0, metrics: Mapping[str, float] | None = None) -> None:
        """`units` more are finished."""
        self.update(self.done + units, metrics=metrics)


class _Live(Progress):
    def __init__(self, title: str, total: float, begun: float, bars: RichProgress) -> None:
        super().__init__(title, total, begun)
        self._bars, self._task = bars, bars.add_task(title, total=total, completed=int(begun), note="")

    def resume_at(self, begun: float) -> None:
        self._bars.reset(self._task, completed=int(begun))  # what was done before tells nothing of the speed
        super().resume_at(begun)

    def _show(self) -> None:
        self._bars.update(self._task, completed=self.done, note=self.note)


class _Plain(Progress):
    def __init__(self, title: str, total: float, begun: float) -> None:
        super().__init__(title, total, begun)
        self._printed: float | None = None  # when the last line was
        self._finished = False

    def _show(self) -> None:
        now, done = time.monotonic(), self.done
        finished = done >= self.total
        if self._printed is None:
            early = now - self.started < PLAIN_QUIET_S
        else:
            early = now - self._printed < PLAIN_LINE_EVERY_S and not finished
        if self._finished or early:
            return
        self._printed, self._finished = now, finished
        elapsed = now - self.started
        share = 100.0 if finished else 100 * done / self.total
        times = duration(elapsed)
        if not finished:
            remaining = seconds_left(done, self.total, self.begun, elapsed)
            times += ", time left unknown" if remaining is None else f", {duration(remaining)} left"
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

    begun: how much of `total` was done before; see Progress. A program that started us can read it from a file as well;
    see console.driven. stage: what the work is part of, for such a program; the title where nothing is said.
    """
    with _shown(title, total, begun, quiet) as work:
        if not quiet:
            work.report_to(Reporter(), stage or title)
        yield work
        work.report(at_once=True)


@contextmanager
def _shown(title: str, total: float, begun: float, quiet: bool) -> Iterator[Progress]:
    if quiet:
        yield Progress(title, total, begun)
        return
    if not sys.stderr.isatty():
        yield _Plain(title, total, begun)
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with RichProgress(*columns, console=Console(stderr=True)) as bars:
        yield _Live(title, total, begun, bars)
