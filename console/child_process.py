"""Child process: runs a module of ours, exchanges lines of JSON with it, and ends it.

The child's standard input is a pipe of ours. The child ends when the pipe closes, and so with this program, however that ends.
Ctrl-C does not reach it: it has a session of its own. The user's current folder is not on its module path (module_command).
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

# On the module path: a checkout, or a folder of installed packages.
ROOT = Path(__file__).resolve().parents[__name__.count(".")]
INSTALLED = ("site-packages", "dist-packages")
POLITENESS = 10  # priority of a child whose parent must stay responsive
LONGEST_LINE = 1 << 24  # bytes
_FLAGS = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0) | getattr(subprocess, "CREATE_NO_WINDOW", 0)


def module_command(module: str, *words: str) -> list[str]:
    """`python -m module words`, without the modules that lie in the current folder, which is the user's (-P)."""
    return [sys.executable, "-P", "-m", module, *words]


class ChildProcess:
    """A running child. OSError where it cannot be started.

    stdout, stderr: files, or as subprocess.Popen has them. polite: with a lower priority. environment: added to ours.
    """

    def __init__(
        self, command: Sequence[str], *, stdout: Any = subprocess.PIPE, stderr: Any = subprocess.DEVNULL,
        polite: bool = False, environment: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        environment = {**os.environ, **(environment or {})}
        if ROOT.name not in INSTALLED:  # a checkout, whose modules are those of its children, too
            environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=stdout, stderr=stderr, env=environment,
            start_new_session=True, creationflags=_FLAGS,
        )  # fmt: skip
        self.pid = self._process.pid
        self.poll = self._process.poll  # exit status (negative: the signal that ended it); None while it runs
        self.input: Any = self._process.stdin
        self.output: Any = self._process.stdout  # what it prints, where stdout is a pipe; else None
        if polite and sys.platform != "win32":
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, self.pid, POLITENESS)

    def wait(self, seconds: float | None = None) -> int | None:
        """Exit status; None where it still runs after `seconds`."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self._process.wait(seconds)
        return None

    def send(self, message: Mapping[str, Any], *parts: bytes) -> None:
        """Writes a line of JSON, and bytes after it. OSError where the child is gone."""
        self.input.write(json.dumps(message).encode() + b"\n")
        for part in parts:
            self.input.write(part)
        self.input.flush()

    def receive(self) -> dict[str, Any]:
        """The next line of JSON. EOFError at the end, ValueError for anything else."""
        line = self.output.readline(LONGEST_LINE)
        if not line:
            raise EOFError
        return dict(json.loads(line))

    def messages(self) -> Iterator[dict[str, Any]]:
        """Lines of JSON until the end, which a killed child may leave amid a line."""
        with contextlib.suppress(EOFError, ValueError):
            while True:
                yield self.receive()

    def close_input(self) -> None:
        """Asks it to end."""
        with contextlib.suppress(OSError):
            self.input.close()

    def kill(self) -> None:
        """Ends it, and all that it started, at once."""
        with contextlib.suppress(OSError):  # nothing of it is left
            if sys.platform == "win32":
                self._process.kill()
            else:
                os.killpg(self.pid, signal.SIGKILL)

    def close(self) -> None:
        """Kills it and closes its pipes. Safe from any thread, any number of times."""
        if self.poll() is None:
            self.kill()
        self._process.wait()
        for pipe in (self.input, self.output):  # who reads from it in another thread has met its end, or does now
            with contextlib.suppress(OSError, ValueError):
                if pipe is not None:
                    pipe.close()

    @contextlib.contextmanager
    def killed_after(self, seconds: float) -> Iterator[threading.Event]:
        """Kills the child if the `with` block takes longer; the event says whether it did."""
        late = threading.Event()

        def kill() -> None:
            late.set()
            self.kill()

        timer = threading.Timer(seconds, kill)
        timer.daemon = True
        timer.start()
        try:
            yield late
        finally:
            timer.cancel()


# --- in the child -----------------------------------------------------------------------------------------------------


def call_when_input_ends(on_end: Callable[[], object]) -> None:
    """Starts a thread that calls `on_end` once standard input has ended."""

    def wait() -> None:
        with contextlib.suppress(OSError):
            while os.read(0, 4096):  # not sys.stdin: its lock would outlive this thread
                pass
        on_end()

    threading.Thread(target=wait, name="snerg-stdin", daemon=True).start()


def json_answers() -> Callable[..., None]:
    """A function that writes its keywords as a line of JSON to standard output. Call once.

    From then on, whatever libraries print goes to standard error, and the end of standard input ends the process.
    """
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def answer(**facts: object) -> None:
        answers.write(json.dumps(facts) + "\n")
        answers.flush()

    call_when_input_ends(lambda: os._exit(1))
    return answer
