"""Background work: functions in threads, and child processes that report lines of JSON to them."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from math import inf
from typing import Any, Generic, TypeVar

from console.child_process import ChildProcess, module_command

T = TypeVar("T")


class Cancelled(Exception):
    """Raised within a task whose result is no longer wanted."""


class Task(Generic[T]):
    """A function in a thread: poll `finished`, then take `result()`; or poll `news()`. kept: the program waits for its end."""

    def __init__(self, function: Callable[[], T], *, kept: bool = False) -> None:
        self.cancelled = False
        self._future: Future[T] = Future()
        self._seen: object = None
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
        except BaseException as error:
            self._future.set_exception(error)
            raise  # reported like any exception of a thread, whoever takes the result


class JsonTask(Task[None]):
    """A module as a child process of jobs' priority; a thread calls `on_message` with each object that it prints."""

    def __init__(self, module: str, words: Sequence[str], on_message: Callable[[Mapping[str, Any]], None]) -> None:
        self._command, self._on_message = module_command(module, *words), on_message
        self._child: ChildProcess | None = None
        super().__init__(self._listen)

    def close(self) -> None:
        self.cancel()
        if self._child is not None:
            self._child.close()

    def _listen(self) -> None:
        if self.cancelled:
            return
        self._child = ChildProcess(self._command, polite=True)
        try:
            if not self.cancelled:  # while the child was being started
                for message in self._child.messages():
                    self._on_message(message)
        finally:
            self._child.close()


class Autosave(Generic[T]):
    """Writes a value in a thread once it has not changed for `settle_s`, or has been changing for `longest_s`.

    write: raises nothing; the program's end waits for it. saved: what need not be written.
    """

    def __init__(self, write: Callable[[T], None], saved: T, settle_s: float, longest_s: float = inf) -> None:
        self.saved = self._seen = saved
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

    def _begin(self, value: T) -> None:
        self.saved = value  # tried once
        self._task = Task(lambda: self._write(value), kept=True)

    def _wait(self) -> None:
        if self._task is not None:
            self._task.result()
