"""Work in a child process: COLMAP's functions run for minutes and react to no signal, and a decoder may crash.

ask() starts the child, serve() runs in it. It reads the request, one line of JSON, from standard input, and writes lines of JSON
to standard output: {"title", "done", "total"} as it goes on, and at the end {"result"}, or {"error": the parts of a UserError}.

Ctrl-C does not reach the child: its parent is interrupted, and ends it. The child also ends when its standard input does, so
with its parent, however that ends.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from console import UserError, refusal
from training.lock import one_at_a_time

OnProgress = Callable[[str, float, float], None]  # what goes on, units done, units in all
EXIT_S = 10.0  # for a child that has closed its output to end in
PROGRAM = "from training.posing.child_process import serve; serve()"
LOCK = "worker.lock"
MOST_MEMORY = 8 << 30  # of a film's decoder


def ask(service: str, request: Mapping[str, Any], log: Path, on_progress: OnProgress) -> Any:
    """The answer of a child process to a request.

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
                on_progress(answer["title"], answer["done"], answer["total"])
            elif "error" in answer:
                raise UserError(**answer["error"])
            else:
                return answer["result"]
        process.wait(EXIT_S)
    except (BrokenPipeError, subprocess.TimeoutExpired):
        pass  # reported below
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        with suppress(BrokenPipeError):
            process.stdin.close()
    if process.returncode >= 0:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        raise RuntimeError(f"{service} failed: {lines[-1][:300] if lines else process.returncode}; see {log}")
    raise UserError("its process was ended from outside, or crashed", where=log, found=signal.Signals(-process.returncode).name,
                    remedy="the system ends processes when memory runs out; the same line goes on")  # fmt: skip


# --- in the child -----------------------------------------------------------------------------------------------------


def serve() -> None:
    """Answers one request."""
    line = os.fdopen(0, "rb", buffering=0, closefd=False).readline()  # a buffer would keep what json_answers waits for
    if not line.endswith(b"\n"):
        sys.exit(1)
    request, answer = json.loads(line), json_answers()

    def on_progress(title: str, done: float, total: float) -> None:
        answer(title=title, done=done, total=total)

    try:
        answer(result=SERVICES[request["service"]](request, on_progress))
    except UserError as error:
        parts = {name: getattr(error, name) for name in ("what", "where", "expected", "found", "remedy")}
        answer(error={name: None if part is None else str(part) for name, part in parts.items()})
    except Exception as error:
        what = refusal(error) or ("the disk is full" if "disk is full" in str(error) else None)  # in SQLite's words
        if what is None:
            raise
        answer(error={"what": what})


def json_answers() -> Callable[..., None]:
    """A function that writes its keywords as a line of JSON to standard output. Call once, in a child process.

    From then on, whatever libraries print goes to standard error, and the end of standard input ends the process.
    """
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def end_with_stdin() -> None:
        with suppress(OSError):
            while os.read(0, 4096):
                pass
        os._exit(1)

    def answer(**facts: object) -> None:
        answers.write(json.dumps(facts) + "\n")
        answers.flush()

    threading.Thread(target=end_with_stdin, daemon=True).start()
    return answer


def _reconstruct(request: Mapping[str, Any], on_progress: OnProgress) -> dict[str, Any]:
    from training.posing.mapping import Group, Task, reconstruct

    paths = {name: Path(request[name]) for name in ("images", "work", "masks")}
    groups = [Group(**group) for group in request["groups"]]
    task = Task(**paths, groups=groups, names=request["names"], masked=request["masked"], seed=request["seed"])
    with one_at_a_time(task.work / LOCK):  # a child whose parent was killed may need a moment to notice
        return asdict(reconstruct(task, on_progress))


def _take_frames(request: Mapping[str, Any], on_progress: OnProgress) -> list[dict[str, Any]]:
    from training.posing.film import take_frames

    if sys.platform == "linux":  # a film may ask a decoder for far more memory than its frames need
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    frames = take_frames(Path(request["film"]), Path(request["images"]), request["most"], on_progress)
    return [asdict(frame) for frame in frames]


SERVICES = {"reconstruct": _reconstruct, "take_frames": _take_frames}
