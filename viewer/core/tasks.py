"""Background work: functions in threads, child processes that print lines of JSON, and our commands as child processes."""

import atexit
import re
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

from console import UserError, not_written, refusal
from console.child_process import ChildProcess, module_command
from console.progress_protocol import ENDS_WITH_STDIN, PROGRESS, Report, read_report

T = TypeVar("T")
PARTING_S = 5.0


_running: "set[Task[Any]]" = set()


class Cancelled(Exception):
    """Raised within a task whose result is no longer wanted."""


class Task(Generic[T]):
    """A function in a thread: poll `finished`, then take `result()`; or poll `news()`. kept: the program waits for its end."""

    def __init__(self, function: Callable[[], T], *, kept: bool = False) -> None:
        self.cancelled = False
        self._future: Future[T] = Future()
        self._seen: object = None
        _running.add(self)
        threading.Thread(target=self._run, args=(function,), daemon=not kept).start()

    @property
    def finished(self) -> bool:
        return self._future.done()

    def cancel(self) -> None:
        """Asks the function to give up, where it looks at `cancelled`."""
        self.cancelled = True

    def result(self) -> T:
        """What the function returned; waits for it, and raises what it raised."""
        return self._future.result()

    def news(self) -> bool:
        """Whether state() or `finished` has changed since this was asked last."""
        before, self._seen = self._seen, (self.state(), self.finished)
        return before != self._seen

    def state(self) -> object:
        """A summary of what has been collected so far."""
        return None

    def _run(self, function: Callable[[], T]) -> None:
        try:
            self._future.set_result(function())
        except (UserError, Cancelled) as error:
            self._future.set_exception(error)
        except BaseException as error:
            self._future.set_exception(error)
            raise  # a bug, reported like any exception of a thread, whoever takes the result
        finally:
            _running.discard(self)


@atexit.register
def _end_running() -> None:
    """Cancels running tasks before Python stops its threads: one that is stopped inside a C++ library aborts the process."""
    running = list(_running)
    for task in running:
        task.cancel()
    wait([task._future for task in running], PARTING_S)


class JsonTask(Task[None]):
    """A module as a child process of jobs' priority; a thread calls `on_message` with each object that it prints."""

    def __init__(self, module: str, words: Sequence[str], on_message: Callable[[Mapping[str, Any]], None]) -> None:
        self._command, self._on_message = module_command(module, *words), on_message
        self._child: ChildProcess | None = None
        self._heard = 0  # messages
        super().__init__(self._listen)

    def state(self) -> object:
        return self._heard

    def cancel(self) -> None:
        super().cancel()
        if self._child is not None:
            self._child.close()

    def _listen(self) -> None:
        self._child = ChildProcess(self._command, polite=True)
        try:
            if not self.cancelled:  # while the child was being started
                for message in self._child.messages():
                    self._on_message(message)
                    self._heard += 1
        finally:
            self._child.close()


class Autosave(Generic[T]):
    """Writes a value in a thread once it has not changed for `settle_s`, or has been changing for `longest_s`.

    write: returns what went wrong, or None; raises nothing. The program's end waits for it. saved: what is written already.
    """

    def __init__(self, write: Callable[[T], str | None], saved: T, settle_s: float, longest_s: float = inf) -> None:
        self.saved = self._seen = saved
        self.problem: str | None = None  # of the last time that it was written
        self._was_reported = False
        self._write, self._settle_s, self._longest_s = write, settle_s, longest_s
        self._since = self._unsaved_since = time.monotonic()
        self._task: Task[None] | None = None

    @property
    def writing(self) -> bool:
        return self._task is not None and not self._task.finished

    def follow(self, value: T) -> None:
        """The value now. Call it often."""
        now = time.monotonic()
        changed, self._seen = value != self._seen, value
        self._since = now if changed else self._since
        if value == self.saved:
            self._unsaved_since = now
        settled = not changed and now - self._since >= self._settle_s
        if value != self.saved and not self.writing and (settled or now - self._unsaved_since > self._longest_s):
            self._begin(value)

    def finish(self, value: T) -> None:
        """Writes the value now if it has changed, and waits for that."""
        self._wait()
        if value != self.saved:
            self._begin(value)
            self._wait()

    def new_problem(self) -> str | None:
        """What went wrong, once: of the first problem alone."""
        if self.problem is None or self._was_reported:
            return None
        self._was_reported = True
        return self.problem

    def _begin(self, value: T) -> None:
        self.saved = value  # tried once
        self._task = Task(lambda: setattr(self, "problem", self._write(value)), kept=True)

    def _wait(self) -> None:
        if self._task is not None:
            self._task.result()


# --- Our commands ---


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

    It stops cleanly when its standard input is closed (console.progress_protocol). UserError where the log cannot be written or
    the program cannot be started.
    """

    def __init__(self, command: Sequence[str], log: Path) -> None:
        self.log = log
        self.stopping = False
        self.killed = False
        self.report: Report | None = None  # the last, as of poll()
        self._scratch = temporary_folder("snerg-child-")
        environment = {PROGRESS: str(self._scratch / "progress.json"), ENDS_WITH_STDIN: "1"}
        try:
            log.parent.mkdir(parents=True, exist_ok=True)
            with open(log, "wb") as output:
                self._child = ChildProcess(command, stdout=output, stderr=output, polite=True, environment=environment)
        except OSError as error:
            shutil.rmtree(self._scratch, ignore_errors=True)
            raise UserError(f"it cannot be started: {error.strerror or error}", where=error.filename or log) from error

    def poll(self) -> int | None:
        """Its exit status once it has ended (negative: the signal that ended it), None while it runs. Reads its report."""
        status = self._child.poll()
        self.report = read_report(self._scratch / "progress.json") or self.report
        if status is not None:
            self._child.close()
            if self.stopping:
                self._child.kill()  # whatever it may have started itself
            shutil.rmtree(self._scratch, ignore_errors=True)
        return status

    def warnings(self) -> list[str]:
        """What it warned of so far, a line each."""
        return re.findall(r"^snerg-\w+: warning: (.*)$", self._printed(), re.M)

    def _printed(self) -> str:
        with suppress(OSError):
            return self.log.read_text(encoding="utf-8", errors="replace").strip()
        return ""

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
        """Why it ended otherwise than well, in one line: what it said last, or what the system did to it."""
        status = self._child.poll()
        if status is not None and status < 0:
            name = signal.Signals(-status).name if -status in list(signal.Signals) else f"signal {-status}"
            hint = "; the system does that when it runs out of memory" if status == -9 else ""
            return f"the process was ended from outside ({name}){hint}"
        if self.report is not None and self.report.error:
            return f"This is a bug in snerg ({self.report.error})" if self.report.bug else self.report.error
        printed = self._printed().splitlines()
        if not printed:
            return f"it ended with status {status} and said nothing"
        return re.sub(r"^snerg-\w+: ", "", printed[-1].strip())


@dataclass
class FolderProcess:
    """A command at work, and the temporary folder that holds its log and is removed with it."""

    child: CommandProcess
    folder: Path

    @classmethod
    def start(cls, command: str, words: Callable[[Path], Sequence[str]], **fields: Any) -> Self:
        """words(folder): the arguments, which may name files in it. fields: of a subclass. UserError as CommandProcess."""
        folder = temporary_folder("snerg-process-")
        try:
            child = CommandProcess(module_command("snerg", command, *words(folder)), folder / "log.txt")
            return cls(child, folder, **fields)
        except (OSError, UserError):
            shutil.rmtree(folder, ignore_errors=True)
            raise

    def end(self) -> None:
        """Ends it if it still runs; nothing of it is left."""
        self.child.end(PARTING_S)
        shutil.rmtree(self.folder, ignore_errors=True)
