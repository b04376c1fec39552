"""Locks (flock) on files and folders. They count on all hosts that share these, and end with their process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from console import UserError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


@contextmanager
def only_one_trains(run: Path, doing: str = "training into this run") -> Iterator[None]:
    """Holds the folder `run`, which is made where it is missing, and removed again where it is left empty.

    UserError where another process holds it; doing: what that process does.
    """
    missing = [folder for folder in (run, *run.absolute().parents) if not folder.exists()]
    handle = -1
    try:
        with suppress(OSError):  # whoever writes there will say why nothing can be written
            run.mkdir(parents=True, exist_ok=True)
            handle = os.open(run, os.O_RDONLY)
        if handle >= 0 and not take_lock(handle):
            remedy = "wait for it, or choose another --out"
            raise UserError(f"another process is {doing}", where=run, remedy=remedy)
        yield
    finally:
        if handle >= 0:
            os.close(handle)
        for folder in missing:
            with suppress(OSError):  # not empty: the run is in it
                folder.rmdir()


@contextmanager
def one_at_a_time(file: Path) -> Iterator[None]:
    """Waits until no other process is in such a block with the same file, which is made."""
    with file.open("w") as opened:
        take_lock(opened.fileno(), wait=True)
        yield


def take_lock(handle: int, *, wait: bool = False) -> bool:
    """Takes the lock; False where another process has it. True as well where the file system has no locks."""
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True
