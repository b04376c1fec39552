"""Progress of long work: a live bar on a terminal, plain lines elsewhere, both with the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

PLAIN_LINE_EVERY_S = 10.0


class Progress:
    """One running piece of work of `total` units; `update(done, note)` may be called as often as is handy."""

    def __init__(self, title: str, total: float) -> None:
        self.title, self.total, self.done, self.note = title, total, 0.0, ""
        self.started = time.monotonic()

    def update(self, done: float, note: str = "") -> None:
        """`done` units of `total` are finished; `note` is a short figure to show beside ("PSNR 27.1")."""
        self.done, self.note = done, note

    def advance(self, units: float = 1.0, note: str | None = None) -> None:
        self.update(self.done + units, self.note if note is None else note)


class _Live(Progress):
    def __init__(self, title: str, total: float, bars: RichProgress) -> None:
        super().__init__(title, total)
        self._bars, self._task = bars, bars.add_task(title, total=total, note="")

    def update(self, done: float, note: str = "") -> None:
        super().update(done, note)
        self._bars.update(self._task, completed=done, note=note)


class _Plain(Progress):
    def __init__(self, title: str, total: float) -> None:
        super().__init__(title, total)
        self._printed = 0.0

    def update(self, done: float, note: str = "") -> None:
        super().update(done, note)
        now = time.monotonic()
        if now - self._printed < PLAIN_LINE_EVERY_S and done < self.total:
            return
        self._printed = now
        elapsed = now - self.started
        left = f"{elapsed * (self.total - done) / done:.0f} s left" if done > 0 else "time left unknown"
        share = 100 * done / max(self.total, 1e-9)
        print(f"{self.title}: {share:.0f} %  {elapsed:.0f} s, {left}  {note}".rstrip(), file=sys.stderr, flush=True)


@contextmanager
def progress(title: str, total: float) -> Iterator[Progress]:
    """Shows `title` with a bar (terminal) or a line every ten seconds (no terminal), on stderr."""
    if not sys.stderr.isatty():
        yield _Plain(title, total)
        return
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(), TextColumn("{task.fields[note]}"),
    )  # fmt: skip
    with RichProgress(*columns, console=Console(stderr=True)) as bars:
        yield _Live(title, total, bars)
