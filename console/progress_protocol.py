"""Progress file and stop-on-stdin-EOF, for programs that start our commands, as the viewer does.

Two variables of the environment, for every command:
  SNERG_PROGRESS=FILE        the work of the moment is kept there as one JSON object, written aside and renamed:
                             {"title": "training", "done": 1200, "total": 6000, "note": "PSNR 27.10 dB", "seconds": 81.3,
                             "begun": 0, "seconds_left": 325.2, "stage": "training", "metrics": {"psnr": 27.1}, "error": "",
                             "bug": false}
                             A command that fails leaves its one line there as "error"; "bug" says that the fault is ours.
  SNERG_ENDS_WITH_STDIN=1    the end of standard input is Ctrl-C: whoever holds the other end of the pipe stops the
                             command by closing it, and so does that program's own end, however it comes about
"""

import contextlib
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from console.atomic import replacing
from console.child_process import call_when_input_ends
from console.json_text import read_json_file

PROGRESS, ENDS_WITH_STDIN = "SNERG_PROGRESS", "SNERG_ENDS_WITH_STDIN"


@dataclass(frozen=True)
class Report:
    """How far a piece of work is: `done` units of `total`. begun: units that were done before it was taken up again; the
    others took `seconds`.

    title, note: for people ("supersampling", "PSNR 27.10 dB"). stage, metrics: the same for programs: what the work is part
    of ("training", "baking", or the title), and figures by name, of which METRICS are some. error: why the command failed,
    "" where it has not; bug: and the fault is ours. seconds_left: an estimate, None while too little is known for one.
    """

    title: str
    done: float
    total: float
    note: str = ""
    seconds: float = 0.0
    stage: str = ""
    metrics: Mapping[str, float] = field(default_factory=dict)
    error: str = ""
    bug: bool = False
    begun: float = 0.0
    seconds_left: float | None = None

    @property
    def share(self) -> float:
        """0 … 1 of it is done."""
        return min(max(self.done / self.total, 0.0), 1.0) if self.total > 0 else 1.0


METRICS: Mapping[str, Callable[[float], str]] = {
    "psnr": lambda value: f"PSNR {value:.2f} dB",
    "rays_per_second": lambda value: f"{value / 1000:.1f}k rays/s",
}


def in_words(metrics: Mapping[str, float]) -> str:
    """Those of METRICS that are there, as a note: "PSNR 27.10 dB  3.0k rays/s"."""
    return "  ".join(words(metrics[name]) for name, words in METRICS.items() if name in metrics)


def read_report(file: Path) -> Report | None:
    """The report in `file`; None where there is none yet, or none that can be read."""
    try:
        return Report(**read_json_file(file))
    except (OSError, ValueError, TypeError):
        return None


def write_report(report: Report) -> None:
    """Puts `report` into the file that SNERG_PROGRESS names, if it is set. A disk that refuses is no reason to stop the work."""
    if named := os.environ.get(PROGRESS):
        with contextlib.suppress(OSError), replacing(Path(named), durable=False) as new:
            new.write_text(json.dumps(asdict(report)), encoding="utf-8")


def write_failure(prog: str, error: str, *, bug: bool = False) -> None:
    """The command ends without having done its work: adds why to the last report."""
    if named := os.environ.get(PROGRESS):
        last = read_report(Path(named)) or Report(prog, 0.0, 1.0)
        write_report(replace(last, error=error, bug=bug))


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
    call_when_input_ends(lambda: _interrupt() if working.is_set() else None)
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
