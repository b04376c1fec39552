"""Command process: one of our commands as a child process, started, watched and stopped without waiting for it.

It stops cleanly when its standard input is closed (console.progress_protocol). What it prints goes straight into a log file, so
nothing of ours must read it.
"""

import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from console import UserError, not_written, refusal
from console.child_process import ChildProcess, module_command
from console.progress_protocol import ENDS_WITH_STDIN, PROGRESS, Report, read_report

LOOK_EVERY_S, PARTING_S = 0.1, 5.0


def temporary_folder(prefix: str) -> Path:
    """A new folder of ours. UserError where there can be none."""
    try:
        return Path(tempfile.mkdtemp(prefix=prefix))
    except OSError as error:
        words, remedy = not_written(error)
        known = isinstance(error, FileNotFoundError) and refusal(error)
        what = known or f"no temporary folder can be made: {words}"
        raise UserError(what, remedy=None if known else remedy) from error


class CommandProcess:
    """A running command. command: program and arguments. log: the file that gets what it prints; made anew.

    UserError where the log cannot be written or the program cannot be started.
    """

    def __init__(self, command: Sequence[str], log: Path) -> None:
        self.log = log
        self.stopping = False
        self.killed = False
        self._last: Report | None = None
        self._scratch = temporary_folder("snerg-child-")
        environment = {PROGRESS: str(self._scratch / "progress.json"), ENDS_WITH_STDIN: "1"}
        try:
            log.parent.mkdir(parents=True, exist_ok=True)
            with open(log, "wb") as output:
                self._child = ChildProcess(
                    command, stdout=output, stderr=subprocess.STDOUT, polite=True, environment=environment
                )
        except OSError as error:
            shutil.rmtree(self._scratch, ignore_errors=True)
            raise UserError(f"it cannot be started: {error.strerror or error}", where=error.filename or log) from error

    def poll(self) -> int | None:
        """Its exit status once it has ended (negative: the signal that ended it), None while it runs."""
        status = self._child.poll()
        if status is not None:
            self._child.close()
            if self.stopping:
                self._child.kill()  # whatever it may have started itself
            self._last = self.report()
            shutil.rmtree(self._scratch, ignore_errors=True)
        return status

    def report(self) -> Report | None:
        return read_report(self._scratch / "progress.json") or self._last

    def stop(self) -> None:
        """Asks it to end as with Ctrl-C: it keeps what is done. Poll on until it has."""
        self.stopping = True
        self._child.close_input()

    def kill(self) -> None:
        """Ends it, and all it started, at once."""
        self.stop()
        self.killed = True
        self._child.kill()

    def end(self, seconds: float) -> None:
        """Stops it, waits up to `seconds`, then kills it: no process is left after this."""
        if self.poll() is not None:
            return
        self.stop()
        if self._child.wait(seconds) is None:
            self.kill()
            self._child.wait()
        self.poll()

    def error_line(self) -> str:
        """Why it ended otherwise than well, in one line: its own last word, or what the system did to it."""
        status = self._child.poll()
        if status is not None and status < 0:
            name = signal.Signals(-status).name if -status in list(signal.Signals) else f"signal {-status}"
            hint = "; the system does that when it runs out of memory" if status == -9 else ""
            return f"the process was ended from outside ({name}){hint}"
        report = self.report()
        if report is not None and report.error:
            return f"This is a bug in snerg ({report.error})" if report.bug else report.error
        said: list[str] = []
        with suppress(OSError):
            lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
            said = [line.strip() for line in lines if line.strip()]
        return said[-1] if said else f"it ended with status {status} and said nothing"


@dataclass
class FolderProcess:
    """A command at work, and the temporary folder that holds its log and is removed with it."""

    child: CommandProcess
    folder: Path
    _looked: float = 0.0

    @classmethod
    def start(cls, module: str, words: Callable[[Path], Sequence[str]]) -> Self:
        """words: gives the arguments and may write files into the folder. UserError where the module cannot be started."""
        folder = temporary_folder("snerg-process-")
        try:
            return cls(CommandProcess(module_command(module, *words(folder)), folder / "log.txt"), folder)
        except (OSError, UserError):
            shutil.rmtree(folder, ignore_errors=True)
            raise

    def due(self) -> bool:
        now = time.monotonic()
        if now - self._looked < LOOK_EVERY_S:
            return False
        self._looked = now
        return True

    def end(self) -> None:
        """Ends it if it still runs; nothing of it is left."""
        self.child.end(PARTING_S)
        shutil.rmtree(self.folder, ignore_errors=True)
