"""A lock (flock) on a folder. It counts on all hosts that share the folder, and ends with its process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from console import UserError
from console.atomic import try_lock


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
        if handle >= 0 and try_lock(handle) is False:
            raise UserError(f"another process is {doing}", where=run, remedy="wait for it, or choose another --out")
        yield
    finally:
        if handle >= 0:
            os.close(handle)
        for folder in missing:
            with suppress(OSError):  # not empty: the run is in it
                folder.rmdir()
