"""Work in a child process: COLMAP's functions run for minutes and listen to no signal, and a decoder may crash.

ask() starts the child, serve() runs in it. It reads one line of JSON, the request, from standard input, and writes lines of JSON
to standard output: {"title", "done", "total"} as it goes on, and at the end {"result"}, or {"error": the parts of a UserError}.

The child takes no part in Ctrl-C: who waits for it is interrupted, ends it, and says how to go on. It also ends when this process
ends, however that comes about, since it waits for the end of its standard input.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from console import UserError, refusal

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

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
        pass  # told below
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        with suppress(BrokenPipeError):
            process.stdin.close()
    if process.returncode >= 0:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        raise RuntimeError(f"{service} failed: {lines[-1][:300] if lines else process.returncode}; see {log}")
    names = {number.value: number.name for number in signal.Signals}
    raise UserError("its process was ended from outside, or crashed", where=log,
                    found=names.get(-process.returncode, -process.returncode),
                    remedy="the system ends processes when memory runs out; the same line goes on")  # fmt: skip


# --- in the child -----------------------------------------------------------------------------------------------------


def serve() -> None:
    """Answers one request."""
    line = b""
    while not line.endswith(b"\n"):  # byte by byte: a buffer would keep what json_answers waits for
        byte = os.read(0, 1)
        if not byte:
            sys.exit(1)
        line += byte
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

    Standard error takes the place of standard output: libraries print what they like. The end of standard input ends the
    process: whoever asked is gone, or wants nothing more.
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

    groups = tuple(Group(tuple(group["names"]), group["focal"]) for group in request["groups"])
    task = Task(
        Path(request["images"]), Path(request["work"]), tuple(request["names"]), groups, request["seed"],
        Path(request["masks"]), frozenset(request["masked"]),
    )  # fmt: skip
    with _alone(task.work / LOCK):
        return asdict(reconstruct(task, on_progress))


def _take_frames(request: Mapping[str, Any], on_progress: OnProgress) -> list[dict[str, Any]]:
    from training.posing.film import take_frames

    if sys.platform == "linux":  # a film may ask a decoder for far more memory than its frames need
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    frames = take_frames(Path(request["film"]), Path(request["images"]), request["most"], on_progress)
    return [asdict(frame) for frame in frames]


SERVICES = {"reconstruct": _reconstruct, "take_frames": _take_frames}


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Waits until no other child works there: one whose parent was killed may need a moment to notice."""
    with lock.open("w") as file:
        if fcntl is not None:
            with suppress(OSError):  # some network file systems have no locks
                fcntl.flock(file, fcntl.LOCK_EX)
        yield
