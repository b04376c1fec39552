"""For programs that start our commands, as the viewer does: progress they can read, and an end that comes with theirs.

Two variables of the environment, for every command:
  SNERG_PROGRESS=FILE        the work of the moment is kept there as one JSON object, written aside and renamed:
                             {"title": "training", "done": 1200, "total": 6000, "note": "PSNR 27.10 dB", "seconds": 81.3}
  SNERG_ENDS_WITH_STDIN=1    the end of standard input is Ctrl-C: whoever holds the other end of the pipe stops the
                             command by closing it, and so does that program's own end, however it comes about
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from console.atomic import replacing

PROGRESS, ENDS_WITH_STDIN = "SNERG_PROGRESS", "SNERG_ENDS_WITH_STDIN"
WRITTEN_EVERY_S = 0.25


@dataclass(frozen=True)
class Report:
    """How far a piece of work is: `done` units of `total`, after `seconds`. note: a short figure, "PSNR 27.10 dB"."""

    title: str
    done: float
    total: float
    note: str = ""
    seconds: float = 0.0

    @property
    def share(self) -> float:
        """0 … 1 of it is done."""
        return min(max(self.done / self.total, 0.0), 1.0) if self.total > 0 else 1.0

    @property
    def seconds_left(self) -> float | None:
        """An estimate; None while it is too early for one."""
        return self.seconds * (1 / self.share - 1) if self.share > 0 and self.seconds > 1.0 else None


def read_report(file: Path) -> Report | None:
    """The report in `file`; None where there is none yet, or none that can be read."""
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
        title, note = str(values["title"]), str(values["note"])
        return Report(title, float(values["done"]), float(values["total"]), note, float(values["seconds"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


class Reporter:
    """Keeps the file that SNERG_PROGRESS names up to date; does nothing where it is not set."""

    def __init__(self) -> None:
        named = os.environ.get(PROGRESS)
        self._file = Path(named) if named else None
        self._written = -WRITTEN_EVERY_S

    def tell(self, report: Report, *, at_once: bool = False) -> None:
        """Writes `report`, unless another was written a moment ago. A disk that refuses is no reason to stop the work."""
        now = time.monotonic()
        if self._file is None or (not at_once and now - self._written < WRITTEN_EVERY_S):
            return
        if not at_once:  # what comes soon after a beginning is told as well
            self._written = now
        with contextlib.suppress(OSError), replacing(self._file, durable=False) as new:
            new.write_text(json.dumps(asdict(report)), encoding="utf-8")


@contextlib.contextmanager
def ending_with_stdin() -> Iterator[None]:
    """Where SNERG_ENDS_WITH_STDIN is set, the end of standard input interrupts the `with` block like Ctrl-C."""
    main = threading.current_thread() is threading.main_thread()
    if not os.environ.get(ENDS_WITH_STDIN) or not main:
        yield
        return
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # a shell's background jobs begin so
        signal.signal(signal.SIGINT, signal.default_int_handler)
    working = threading.Event()
    working.set()

    def wait() -> None:
        with contextlib.suppress(OSError):
            while os.read(0, 4096):  # not sys.stdin: its lock would outlive this thread
                pass
        if working.is_set():
            _interrupt()

    threading.Thread(target=wait, name="snerg-stdin", daemon=True).start()
    try:
        yield
    finally:
        working.clear()


def _interrupt() -> None:
    if sys.platform == "win32":
        import _thread

        _thread.interrupt_main()
    else:
        os.kill(os.getpid(), signal.SIGINT)
