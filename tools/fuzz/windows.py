"""The window among the programs that are interrupted: while it exports a film, and while it makes a scene."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from tools.fuzz.writer import PATIENCE_S, STEPS, Writer


class ExportingWindow(Writer):
    """A turntable, written by the window."""

    def line(self, out: Path) -> list[str]:
        return [sys.executable, "-m", "viewer.commands.view", *self.words, "--frames", "1", "--export", str(out)]


class MakingWindow(Writer):
    """snerg-make, started by the window. The window alone is killed: what it makes must notice, and keep what is done."""

    patience_s = PATIENCE_S

    def line(self, out: Path) -> list[str]:
        return [sys.executable, "-m", "tools.fuzz.making_window", *self.words[:1], str(out), STEPS, "40"]

    def end(self, child: subprocess.Popen[str]) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child.pid, signal.SIGKILL)
        out, until = str(child.args[4]), time.monotonic() + self.patience_s  # type: ignore[index]
        while working_on(out) and time.monotonic() < until:
            time.sleep(0.05)
        for maker in working_on(out):
            self.problems.append(f"{self.name}: what it makes outlives it")
            with contextlib.suppress(ProcessLookupError):
                os.kill(maker, signal.SIGKILL)


def working_on(path: str) -> list[int]:
    """Numbers of the processes in whose lines a path stands, without those that have ended."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if path.encode() in (process / "cmdline").read_bytes().split(b"\0"):
                found.append(int(process.name))
    return found
