"""Work in a child process: COLMAP's functions run for minutes and listen to no signal, and a decoder may crash.

The child takes no part in Ctrl-C: who waits for it is interrupted, ends it, and says how to go on. It also ends when this
process ends, however that comes about, since it waits for the end of its standard input.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from console import UserError

PARTING_S = 10.0  # for a child that has closed its output to end in
PROGRAM = "from training.posing.worker import main; main()"


def ask(service: str, request: Mapping[str, Any], log: Path, tell: Callable[[str, float, float], None]) -> Any:
    """What training.posing.worker answers to a request. tell(title, done, total) is called as it goes on.

    log: gets what libraries print. UserError as the service raises it, and where the child dies.
    """
    with log.open("ab") as printed:
        process = subprocess.Popen(
            # The same modules from the same places, whatever lies in the current folder.
            [sys.executable, "-P", "-c", f"import sys; sys.path[:] = {sys.path!r}; {PROGRAM}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=printed,
            env={**os.environ, "OMP_NUM_THREADS": "1"},  # COLMAP has threads of its own
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )
    assert process.stdin is not None and process.stdout is not None
    try:
        process.stdin.write(json.dumps({**request, "service": service}).encode() + b"\n")
        process.stdin.flush()
        for line in process.stdout:
            answer = json.loads(line)
            if "title" in answer:
                tell(answer["title"], answer["done"], answer["total"])
            elif "error" in answer:
                raise UserError(**answer["error"])
            else:
                return answer["result"]
        process.wait(PARTING_S)
    except (BrokenPipeError, subprocess.TimeoutExpired):
        pass  # told below
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        with suppress(BrokenPipeError):
            process.stdin.close()
    raise _death(process.returncode, service, log)


def _death(status: int, service: str, log: Path) -> Exception:
    """What to tell of a child that ended without an answer."""
    if status >= 0:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        return RuntimeError(f"{service} failed: {lines[-1][:300] if lines else status}; see {log}")
    names = {number.value: number.name for number in signal.Signals}
    return UserError("its process was ended from outside, or crashed", where=log, found=names.get(-status, -status),
                     remedy="the system ends processes when memory runs out; the same line goes on")  # fmt: skip
