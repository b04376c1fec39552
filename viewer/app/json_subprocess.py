"""One of our modules in a process of its own that tells what it finds in lines of JSON; a thread hears them.

The child holds our end of a pipe as its standard input, and ends when we close it or are gone. It is as polite as the commands
that may be begun later (viewer.app.child), so that what it measures is what they will take.
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
    """`python -P -m module words`, from the moment this is made, and `hear` with each object that it prints, in a thread.

    before: called in that thread first; the process is begun when it returns. behind: called when all is over.
    """

    def __init__(
        self, module: str, words: Sequence[str], on_message: Callable[[Mapping[str, Any]], None], *,
        before: Callable[[], object] = lambda: None, behind: Callable[[], object] = lambda: None,
    ) -> None:  # fmt: skip
        self._command, self._on_message = module_command(module, *words), on_message
        self._before, self._behind = before, behind
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=module, daemon=True)
        self._thread.start()

    @property
    def coming(self) -> bool:
        """Whether more is on its way."""
        return self._thread.is_alive()

    def wait(self) -> None:
        """Until there will be no more."""
        self._thread.join()

    def close(self) -> None:
        """Ends the process."""
        self._closed = True
        if self._process is not None:
            self._process.kill()

    def _run(self) -> None:
        try:
            self._before()
            if not self._closed:
                self._listen()
        finally:
            self._behind()

    def _listen(self) -> None:
        self._process = process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            start_new_session=True, creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )  # fmt: skip
        if self._closed:  # while it was begun
            process.kill()
        if sys.platform != "win32":
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, process.pid, POLITENESS)
        assert process.stdout is not None and process.stdin is not None
        try:
            for line in process.stdout:
                self._on_message(json.loads(line))
        except (ValueError, KeyError, TypeError, AttributeError):  # it was ended within a line
            pass
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
            with contextlib.suppress(OSError):
                process.stdin.close()
