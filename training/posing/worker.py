"""The child process that COLMAP and the decoders of films work in; training.posing.child is the other side.

It reads one line of JSON, the request, from standard input, and writes lines of JSON to standard output: {"title", "done",
"total"} as it goes on, and at the end {"result"}, or {"error": the parts of a UserError}. It ends with the input.
"""

from __future__ import annotations

import json
import os
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

LOCK = "worker.lock"
MOST_MEMORY = 8 << 30  # of a film's decoder


def main() -> None:
    """Serves one request."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # libraries print what they like
    request = json.loads(_line())
    threading.Thread(target=end_with_stdin, daemon=True).start()

    def say(answer: dict[str, Any]) -> None:
        answers.write(json.dumps(answer) + "\n")
        answers.flush()

    def tell(title: str, done: float, total: float) -> None:
        say({"title": title, "done": done, "total": total})

    try:
        say({"result": SERVICES[request["service"]](request, tell)})
    except UserError as error:
        parts = {name: getattr(error, name) for name in ("what", "where", "expected", "found", "remedy")}
        say({"error": {name: None if part is None else str(part) for name, part in parts.items()}})
    except Exception as error:
        line = refusal(error) or ("the disk is full" if "disk is full" in str(error) else None)  # in SQLite's words
        if line is None:
            raise
        say({"error": {"what": line}})


def _reconstruct(request: Mapping[str, Any], tell: Callable[[str, float, float], None]) -> dict[str, Any]:
    from training.posing.mapping import Group, Task, reconstruct

    groups = tuple(Group(tuple(group["names"]), group["focal"]) for group in request["groups"])
    names, masked = tuple(request["names"]), frozenset(request["masked"])
    masks = Path(request["masks"])
    task = Task(Path(request["images"]), Path(request["work"]), names, groups, request["seed"], masks, masked)
    with _alone(task.work / LOCK):
        return asdict(reconstruct(task, tell))


def _take_frames(request: Mapping[str, Any], tell: Callable[[str, float, float], None]) -> list[dict[str, Any]]:
    from training.posing.film import take_frames

    _limit_memory(MOST_MEMORY)
    frames = take_frames(Path(request["film"]), Path(request["images"]), request["most"], tell)
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


def _limit_memory(most: int) -> None:
    """Address space in bytes: a film may ask a decoder for far more than its frames need. On Linux alone."""
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))


def _line() -> bytes:
    """The first line of standard input, byte by byte: a buffer would keep what the thread waits for."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(0, 1)
        if not byte:
            sys.exit(1)
        line += byte
    return line


def end_with_stdin() -> None:
    """Whoever asked is gone, or wants nothing more."""
    with suppress(OSError):
        while os.read(0, 4096):
            pass
    os._exit(1)


if __name__ == "__main__":
    main()
