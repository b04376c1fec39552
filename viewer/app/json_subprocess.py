"""JSON subprocess: runs a module as a subprocess and calls back for each JSON line that it prints.

The subprocess has a pipe of ours as its standard input, and ends when the pipe is closed. Its priority is that of jobs
(viewer.app.child), so that times it measures hold for them.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from console.python_command import module_command
from viewer.app.child import POLITENESS


class JsonSubprocess:
    """Starts `python -P -m module words` at once. A thread calls `on_message` with each object that is printed.

    before: called in that thread before the process is started.
    on_end: called in that thread at the end, whatever happened.
    """

    def __init__(
        self, module: str, words: Sequence[str], on_message: Callable[[Mapping[str, Any]], None], *,
        before: Callable[[], object] = lambda: None, on_end: Callable[[], object] = lambda: None,
    ) -> None:  # fmt: skip
        self._command, self._on_message = module_command(module, *words), on_message
        self._before, self._on_end = before, on_end
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=module, daemon=True)
        self._thread.start()

    @property
    def coming(self) -> bool:
        """Whether the process still runs, so that more messages may come."""
        return self._thread.is_alive()

    def wait(self) -> None:
        """Waits for the end of the process."""
        self._thread.join()

    def close(self) -> None:
        """Kills the process."""
        self._closed = True
        if self._process is not None:
            self._process.kill()

    def _run(self) -> None:
        try:
            self._before()
            if not self._closed:
                self._listen()
        finally:
            self._on_end()

    def _listen(self) -> None:
        self._process = process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            start_new_session=True, creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )  # fmt: skip
        if self._closed:  # closed while the process was being started
            process.kill()
        if sys.platform != "win32":
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, process.pid, POLITENESS)
        assert process.stdout is not None and process.stdin is not None
        try:
            for line in process.stdout:
                self._on_message(json.loads(line))
        except (ValueError, KeyError, TypeError, AttributeError):  # the process was killed amid a line
            pass
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
            with contextlib.suppress(OSError):
                process.stdin.close()
