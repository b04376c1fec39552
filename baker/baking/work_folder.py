"""What a bake has done so far, kept on disk: a bake that was killed goes on there, and ends with the same pack.

A work folder holds `key.json`, which says of which bake it is, and one .npz for each piece of work done. A piece that cannot be
read (a power cut) is made again. Every piece depends on the key alone, so an unbroken bake, a resumed one, and one shared by many
hosts give the same bytes. Hosts share a bake through its work folder and nothing else: each makes the pieces of its own share
first, then whatever is still missing, so that none waits for another.
"""

import io
import itertools
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from console import Notice, UserError, notify
from console.atomic import discard, remove_leftovers, try_lock, write_file
from scenepack.files import ZIP_ERRORS

Arrays = dict[str, np.ndarray]
AGAIN = "run the same command again; finished work is kept"
PATIENCE = 600.0  # seconds that a helper waits for the first process to begin


@dataclass(frozen=True)
class Share:
    """Which of how many processes of a bake this one is, from 0. Process 0 ends the bake; the others help it."""

    process: int = 0
    processes: int = 1

    @property
    def helps(self) -> bool:
        """Whether another process writes the pack."""
        return self.process > 0

    def order(self, count: int) -> list[int]:
        """0 to count - 1 in the order in which to make pieces: its own share, then the others' from their ends."""
        own, *others = ((self.process + turn) % self.processes for turn in range(self.processes))
        theirs = (reversed(range(other, count, self.processes)) for other in others)
        return [*range(own, count, self.processes), *itertools.chain(*theirs)]


class BakeEnded(Exception):
    """The work folder is gone: process 0 has all it needs."""


def work_beside(pack: Path) -> Path:
    """The work folder of a bake into `pack`: hidden, on the same disk."""
    return pack.with_name(f".{pack.name}.bake")


class WorkFolder:
    """Opened for one bake; `key` is anything JSON can hold that its result depends on.

    A folder left by another bake is emptied, with a notice. UserError where another process is baking into it, or the
    disk refuses. A helper (share) changes nothing but adds pieces, and waits until process 0 has begun.
    """

    def __init__(self, path: Path, key: Mapping[str, Any], share: Share | None = None) -> None:
        self.path, self.share = path, share or Share()
        self.made = 0  # pieces, here and now
        self._lock: int | None = None
        text = json.dumps(key, indent=2, sort_keys=True) + "\n"
        file = path / "key.json"
        if self.share.helps:
            self._wait_for(file, text)
            return
        try:
            path.mkdir(parents=True, exist_ok=True)
            remove_leftovers(path)
            self._lock = os.open(path / "lock", os.O_RDWR | os.O_CREAT, 0o644)
            if try_lock(self._lock) is False:
                os.close(self._lock)
                raise UserError("another process is baking into this pack", where=path,
                                remedy="wait for it, or choose another --out")  # fmt: skip
            if file.is_file() and file.read_text(encoding="utf-8") != text:
                notify(Notice("the unfinished bake here was of another run or with other options: starting over"))
                for old in path.glob("*.npz"):
                    old.unlink(missing_ok=True)
            write_file(file, text)
        except OSError as error:
            raise self._refused(error) from error

    def once(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """The arrays of piece `name`: read where they were made before, else made now and kept."""
        with suppress(OSError, KeyError, *ZIP_ERRORS), np.load(self.file(name), allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}  # zip's checksums tell of damage
        arrays = make()
        self.made += 1
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        try:
            write_file(self.file(name), buffer.getvalue())
        except OSError as error:
            if not (self.share.helps and isinstance(error, FileNotFoundError)):
                raise self._refused(error) from error
            if not self.path.is_dir():
                raise BakeEnded from error
        return arrays

    def has(self, name: str) -> bool:
        """Whether a piece was made before (it may yet turn out damaged)."""
        return self.file(name).is_file()

    def file(self, name: str) -> Path:
        return self.path / f"{name}.npz"

    def close(self) -> None:
        """Lets others bake here; what was done stays. Where nothing was, nothing stays."""
        if not self.share.helps and self.path.is_dir() and next(self.path.glob("*.npz"), None) is None:
            discard(self.path)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def remove(self) -> None:
        self.close()
        discard(self.path)  # in one step: a helper may be writing a piece, and a folder that is not empty stays

    def _wait_for(self, file: Path, text: str) -> None:
        """Until process 0 bakes the same here."""
        until = time.monotonic() + PATIENCE
        while not (file.is_file() and file.read_text(encoding="utf-8") == text):
            if time.monotonic() > until:
                raise UserError(
                    "process 0 of this bake has not started", where=file,
                    expected="the same command line in every process, with folders that all hosts share",
                )  # fmt: skip
            time.sleep(0.2)

    def _refused(self, error: OSError) -> UserError:
        return UserError(f"its pieces cannot be written: {error.strerror or error}", where=self.path,
                         remedy=f"free some space; then {AGAIN}")  # fmt: skip


def once(work: WorkFolder | None, name: str, make: Callable[[], Arrays]) -> Arrays:
    """WorkFolder.once, or just `make()` where nothing is kept."""
    return make() if work is None else work.once(name, make)


Tick = Callable[[float], None]  # called with the share that is done
Piece = tuple[str, Callable[[Tick], Arrays]]  # its name, and what makes it


def in_order(work: WorkFolder | None, pieces: Sequence[Piece], tick: Tick) -> Iterator[Arrays]:
    """The arrays of each piece. A bake of several processes makes all before the first, a bake of one each when it is its turn.

    tick: first called with what was made before, so that an estimate of the time left does not count it.
    """
    total = max(len(pieces), 1)

    def there() -> int:
        return 0 if work is None else sum(work.has(name) for name, _ in pieces)

    def made(number: int, done: int) -> Arrays:
        name, make = pieces[number]
        return once(work, name, lambda: make(lambda share: tick((done + share) / total)))

    done = there()
    tick(done / total)
    if work is not None and work.share.processes > 1:
        for number in work.share.order(len(pieces)):
            if not work.has(pieces[number][0]):
                made(number, done)
                done = there()
                tick(done / total)
    for number in range(len(pieces)):
        arrays = made(number, max(done, number))
        done = max(done, number + 1)
        tick(done / total)
        yield arrays
