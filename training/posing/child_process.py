"""Work in a child process: COLMAP's functions run for minutes and react to no signal, and a decoder may crash.

ask() starts the child, serve() runs in it. The request is one line of JSON. The answers are lines of JSON: {"title", "done",
"total"} for progress, {"notice"} for each notice, and at the end {"result"}, or {"error"} with the parts of a UserError.
"""

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from console import Notice, UserError, notify, refusal
from console.atomic import try_lock
from console.child_process import ChildProcess, json_answers, module_command
from console.errors import handle_notices

OnProgress = Callable[[str, float, float], None]  # what goes on, units done, units in all
EXIT_S = 10.0  # for a child that has closed its output to end in
COMMAND = module_command("training.posing.child_process")
LOCK = "worker.lock"
MOST_MEMORY = 8 << 30  # of a film's decoder


def ask(service: str, request: Mapping[str, Any], log: Path, on_progress: OnProgress) -> Any:
    """The answer of a child process to a request.

    log: gets what libraries print. UserError as the service raises it, and where the child dies.
    """
    with log.open("ab") as printed:
        # COLMAP has threads of its own
        child = ChildProcess(COMMAND, stderr=printed, environment={"OMP_NUM_THREADS": "1"})
    try:
        with contextlib.suppress(BrokenPipeError):
            child.send({**request, "service": service})
            for answer in child.messages():
                if "title" in answer:
                    on_progress(answer["title"], answer["done"], answer["total"])
                elif "notice" in answer:
                    notify(Notice(answer["notice"]))
                elif "error" in answer:
                    raise UserError(**answer["error"])
                else:
                    return answer["result"]
        child.wait(EXIT_S)
    finally:
        child.close()
    status = child.poll() or 0
    if status >= 0:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        raise RuntimeError(f"{service} failed: {lines[-1][:300] if lines else status}; see {log}")
    found = signal.Signals(-status).name
    raise UserError("its process was ended from outside, or crashed", where=log, found=found,
                    remedy="the system ends processes when memory runs out; the same line goes on")  # fmt: skip


# --- in the child -----------------------------------------------------------------------------------------------------


def serve() -> None:
    """Answers one request."""
    line = os.fdopen(0, "rb", buffering=0, closefd=False).readline()  # a buffer would keep what json_answers reads
    if not line.endswith(b"\n"):
        sys.exit(1)
    request, answer = json.loads(line), json_answers()

    def on_progress(title: str, done: float, total: float) -> None:
        answer(title=title, done=done, total=total)

    try:
        with handle_notices(lambda text: answer(notice=text)):
            result = SERVICES[request.pop("service")](request, on_progress)
        answer(result=result)
    except UserError as error:
        answer(error={name: None if part is None else str(part) for name, part in vars(error).items()})
    except Exception as error:
        what = refusal(error) or ("the disk is full" if "disk is full" in str(error) else None)  # in SQLite's words
        if what is None:
            raise
        answer(error={"what": what})


def _map(service: str, request: Mapping[str, Any], on_progress: OnProgress) -> dict[str, Any]:
    """What a function of training.posing.mapping finds, with the request's values as its Task."""
    from training.posing import mapping

    paths = {name: Path(request[name]) for name in ("images", "work", "masks") if name in request}
    task = mapping.Task(**{**request, **paths})
    with (task.work / LOCK).open("w") as lock:
        while try_lock(lock.fileno()) is False:  # a child whose parent was killed may need a moment to notice
            time.sleep(0.1)
        return getattr(mapping, service)(task, on_progress)


def _take_frames(request: Mapping[str, Any], on_progress: OnProgress) -> list[dict[str, Any]]:
    from training.posing.film import take_frames

    if sys.platform == "linux":  # a film may ask a decoder for far more memory than its frames need
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    frames = take_frames(Path(request["film"]), Path(request["images"]), request["most"], on_progress)
    return [asdict(frame) for frame in frames]


SERVICES = {name: partial(_map, name) for name in ("reconstruct", "matching_pairs")} | {"take_frames": _take_frames}

if __name__ == "__main__":
    serve()
