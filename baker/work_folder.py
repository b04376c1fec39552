"""What a bake has done so far, kept on disk: a bake that was killed goes on there, and ends with the same pack.

A work folder holds `key.json`, which says of which bake it is, and one .npz for each piece of work done, written aside
and renamed. A piece that cannot be read (a power cut) is made again. Every piece depends on the key alone, never on
when it was made, so an unbroken bake and a resumed one give the same bytes.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import warnings
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from console import Notice, UserError
from training.checkpoints import write_aside

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

Arrays = dict[str, np.ndarray]
AGAIN = "type the same line again: what is done is kept"


def work_beside(pack: Path) -> Path:
    """The work folder of a bake into `pack`: hidden, on the same disk."""
    return pack.with_name(f".{pack.name}.bake")


class WorkFolder:
    """Opened for one bake; `key` is anything JSON can hold that its result depends on.

    A folder left by another bake is emptied, with a notice. UserError where another process is baking into it, or the
    disk refuses.
    """

    def __init__(self, path: Path, key: Mapping[str, Any]) -> None:
        self.path = path
        text = json.dumps(key, indent=2, sort_keys=True) + "\n"
        file = path / "key.json"
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._lock = self._hold()
            if file.is_file() and file.read_text(encoding="utf-8") != text:
                warnings.warn(Notice("the unfinished bake here was of another run or with other options: starting over"),
                              stacklevel=2)  # fmt: skip
                for old in path.glob("*.npz"):
                    old.unlink(missing_ok=True)
            for scrap in path.glob(".*.tmp"):  # a killed writer's
                scrap.unlink(missing_ok=True)
            write_aside(file, text.encode())
        except OSError as error:
            raise self._refused(error) from error

    def once(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """The arrays of piece `name`: read where they were made before, else made now and kept."""
        kept = self.read(name)
        if kept is not None:
            return kept
        arrays = make()
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        try:
            write_aside(self.file(name), buffer.getvalue())
        except OSError as error:
            raise self._refused(error) from error
        return arrays

    def read(self, name: str) -> Arrays | None:
        """The arrays of a piece, None where it is not there or damaged. Zip's checksums tell."""
        try:
            with np.load(self.file(name), allow_pickle=False) as stored:
                return {key: stored[key] for key in stored.files}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def has(self, name: str) -> bool:
        """Whether a piece was made before (it may yet turn out damaged)."""
        return self.file(name).is_file()

    def file(self, name: str) -> Path:
        """Where a piece lies."""
        return self.path / f"{name}.npz"

    def close(self) -> None:
        """Lets others bake here; what was done stays."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def remove(self) -> None:
        """The bake is done: nothing of it stays."""
        self.close()
        shutil.rmtree(self.path, ignore_errors=True)

    def _hold(self) -> int | None:
        if fcntl is None:
            return None
        handle = os.open(self.path / "lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(handle)
            raise UserError("another process is baking into this pack", where=self.path,
                            remedy="wait for it, or choose another --out") from error  # fmt: skip
        except OSError:  # some network file systems have no locks
            with suppress(OSError):
                os.close(handle)
            return None
        return handle

    def _refused(self, error: OSError) -> UserError:
        return UserError(
            f"the bake cannot be kept: {error.strerror or error}", where=self.path, remedy=f"make room, then {AGAIN}"
        )


def once(work: WorkFolder | None, name: str, make: Callable[[], Arrays]) -> Arrays:
    """WorkFolder.once, or just `make()` where nothing is kept."""
    return make() if work is None else work.once(name, make)
