"""One training at a time in a run's folder: two would write every step twice."""

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
    """Holds the folder `run`, which is made where it is not there, and taken away again where it is left empty.

    UserError where another process holds it, in which it is `doing` the same. The lock (flock) is on the folder itself,
    counts on all hosts that share it, and ends with its process, however that ends.
    """
    if fcntl is None or (run.exists() and not run.is_dir()):
        yield
        return
    missing = [folder for folder in (run, *run.absolute().parents) if not folder.exists()]
    handle = -1
    try:
        with suppress(OSError):  # where nothing can be written, writing tells why
            run.mkdir(parents=True, exist_ok=True)
            handle = os.open(run, os.O_RDONLY)
        if handle >= 0:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                remedy = "wait for it, or choose another --out"
                raise UserError(f"another process is {doing}", where=run, remedy=remedy) from error
            except OSError:
                pass  # some network file systems have no locks
        yield
    finally:
        if handle >= 0:
            os.close(handle)
        for folder in missing:
            with suppress(OSError):  # not empty: the run is in it
                folder.rmdir()
