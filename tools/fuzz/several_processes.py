"""Programs with several processes, for kills and full disks: the window that exports a film or makes a scene, and two processes
that bake one pack. Either both bakes are killed, or one of them.

`python -m tools.fuzz.several_processes RUN ... --out PACK` starts the two bakes. It ends with the exit status of process 0, which
writes the pack.
"""

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
        return [sys.executable, "-m", "snerg", "view", *self.words, "--frames", "1", "--export", str(out)]


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


class SharingBake(Writer):
    """snerg-bake twice with one work folder. Kills strike both, then process 0 alone, then process 1 alone, and so on."""

    voices = 2
    kills = 0

    def line(self, out: str | os.PathLike[str]) -> list[str]:
        return [sys.executable, "-m", "tools.fuzz.several_processes", *self.words, "--out", str(out)]

    def end(self, child: subprocess.Popen[str]) -> None:
        struck = (("0", "1"), ("0",), ("1",))[self.kills % 3]
        self.kills += 1
        out = str(child.args[-1])  # type: ignore[index]
        for number in working_on(out):
            with contextlib.suppress(OSError), open(f"/proc/{number}/cmdline", "rb") as line:
                words = line.read().decode().split("\0")
                if "--process-id" in words and words[words.index("--process-id") + 1] in struck:
                    os.kill(number, signal.SIGKILL)


def working_on(path: str) -> list[int]:
    """Numbers of the processes in whose lines a path stands, without those that have ended."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if path.encode() in (process / "cmdline").read_bytes().split(b"\0"):
                found.append(int(process.name))
    return found


def main(words: list[str]) -> int:
    line = [sys.executable, "-m", "snerg", "bake", *words, "--processes", "2", "--process-id"]
    writing, helping = (subprocess.Popen([*line, number]) for number in ("0", "1"))
    helped, wrote = helping.wait(), writing.wait()
    return wrote if helped in (0, 2, -signal.SIGKILL) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
