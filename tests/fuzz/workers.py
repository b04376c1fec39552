"""Children that open spoilt files (tests.fuzz.child), and the watch over their time.

A child opens many files, one after another; one that dies or hangs is replaced. Forking would share what a child learnt
(or broke) with no other, but JAX and threads do not survive it.
"""

import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Self

from tests.fuzz.child import FINDING, ROOT, Outcome

SECONDS = 20.0  # of the processor, or without doing anything
PATIENCE = 120.0  # at most, however busy the machine
LOOK_EVERY = 0.5
START_SECONDS = 600.0
_TICKS = os.sysconf("SC_CLK_TCK")


class Worker:
    """One child of a subject, started when it is first asked; a context manager."""

    def __init__(self, subject: str, bases: Path) -> None:
        self.subject, self.bases = subject, bases
        self.place = Path(tempfile.mkdtemp(prefix="snerg-fuzz-"))
        self._child: subprocess.Popen[str] | None = None
        self._complaints: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        shutil.rmtree(self.place, ignore_errors=True)

    def outcome(self, recipe: dict[str, Any]) -> Outcome:
        """What comes of a recipe; a finding, too, where the child hangs or dies of it."""
        child = self._child or self._start()
        assert child.stdin is not None
        try:
            child.stdin.write(json.dumps(recipe) + "\n")
            child.stdin.flush()
            answer = self._answer(SECONDS, PATIENCE)
        except BrokenPipeError:
            answer = ""
        if answer:
            return Outcome(**json.loads(answer))
        outcome = Outcome(FINDING, "hang", f"{SECONDS:.0f} s") if answer is None else self._death()
        self._end()
        return outcome

    def _start(self) -> subprocess.Popen[str]:
        self._complaints = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        words = [sys.executable, "-m", "tests.fuzz.child", self.subject, str(self.bases), str(self.place)]
        environment = {**os.environ, "MALLOC_ARENA_MAX": "2", "JAX_PLATFORMS": "cpu"}
        self._child = subprocess.Popen(
            words, cwd=ROOT, env=environment, text=True, encoding="utf-8", start_new_session=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._complaints,
        )  # fmt: skip
        if not self._answer(START_SECONDS, START_SECONDS):
            self._complaints.seek(0)
            raise RuntimeError(f"the fuzzer's child does not start: {self._complaints.read()[-2000:]}")
        return self._child

    def _answer(self, seconds: float, patience: float) -> str | None:
        """The child's next line; "" where it died, None where it took too long: on the processor, or doing nothing."""
        child = self._child
        assert child is not None and child.stdout is not None
        first = last = _processor_seconds(child.pid)
        waited = idle = 0.0
        while True:
            if select.select([child.stdout], [], [], LOOK_EVERY)[0]:
                return child.stdout.readline()
            used = _processor_seconds(child.pid)
            waited += LOOK_EVERY  # counted, not measured: we may have been stopped ourselves
            idle = 0.0 if used > last else idle + LOOK_EVERY
            last = used
            if used - first > seconds or idle > seconds or waited > patience:
                return None

    def _death(self) -> Outcome:
        child = self._child
        assert child is not None
        code = child.wait(timeout=60)
        self._complaints.seek(0)
        complaint = self._complaints.read()
        name = signal.Signals(-code).name if code < 0 else f"status {code}"
        return Outcome(FINDING, f"death {name}", complaint.strip()[-400:])

    def _end(self) -> None:
        if self._child is not None:
            with self._child as child, contextlib.suppress(ProcessLookupError):  # waits for it, and closes its pipes
                os.killpg(child.pid, signal.SIGKILL)
            self._complaints.close()
        self._child = None


def _processor_seconds(process: int) -> float:
    """What a process has used of the processor so far, those of its children that ended included."""
    try:
        words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(int(n) for n in words[11:15]) / _TICKS
