"""Replacing a file or a folder so that a kill at any moment leaves the old or the new one, never a mixture.

All is written under a hidden name beside the target, flushed to disk, and then takes the target's place:
- a file, or a target that is absent: one rename.
- a folder over a folder: two renames, target → .NAME.old-…, new → target. A kill between them leaves no target but a
  complete .old; whoever next reads or writes that target puts it back (recover_interrupted_write).
Hidden names are .NAME.KIND-PID-TOKEN: "new" being written or deleted, "old" complete and set aside. Those whose process
has died are cleaned up by the next writer of the same target. A process shows that it is alive by its id and by a lock
(flock) on what it writes, which counts across containers and hosts that share the folder; where the file system knows
no locks, what is less than an hour old is left alone.
Work of hours in one folder locks it (locked_folder).
"""

import errno
import os
import re
import secrets
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from console.errors import UserError
from console.streams import printable

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

NEW, OLD = "new", "old"
_LEFTOVER_AGE_S = 3600.0  # a process id may have been given to another process since
_SWAP_PATIENCE_S = 2.0
_GIVE_WAY_S = 5.0


def write_file(path: Path, data: bytes | str | Iterable[Any]) -> None:
    """Puts `data` (printable text as UTF-8; or parts, one after the other) at `path`, whose folder exists, in one step.
    Raises OSError.

    A device or a pipe (/dev/stdout, >(wc)) is written as it is: nothing takes its place.
    """
    parts = [printable(data).encode()] if isinstance(data, str) else [data] if isinstance(data, bytes) else data
    with nullcontext(path) if is_stream(path) else replacing(path) as new, new.open("wb") as file:
        for part in parts:
            file.write(part)


def is_stream(path: Path) -> bool:
    """Whether a device, a pipe or a socket lies at `path`."""
    return path.exists() and not path.is_file() and not path.is_dir()


def try_folder(folder: Path) -> None:
    """OSError where no file could be made in `folder`, which need not be there yet."""
    above = next(place for place in (folder, *folder.absolute().parents) if os.path.lexists(place))
    with tempfile.TemporaryDirectory(prefix=".snerg-", dir=above):
        pass


@contextmanager
def replacing(target: Path, *, folder: bool = False, durable: bool = True, alone: bool = False) -> Iterator[Path]:
    """Yields the path of an empty file or folder to be written; on a clean exit it takes the place of `target`.

    Where the block raises, what was written is deleted and the target is untouched. Where `target` is a symbolic link, what it
    leads to is replaced, not the link. durable: False spares the disk, for what nobody misses after a power cut. alone: what
    takes a while to write is written by one process at a time; otherwise the last one stays. Raises OSError as reserved() does.
    """
    target = target.resolve() if target.is_symlink() else target
    with reserved(target, folder=folder, alone=alone) as new:
        yield new
        if durable:
            _flush(new)
        _take_place(new, target)
        if durable:
            _flush_names(target.parent)


@contextmanager
def writing_alone(target: Path) -> Iterator[None]:
    """For work of a while that ends in writing to the file or folder `target`. OSError where another process is at such work."""
    target = target.resolve()
    with ExitStack() as stack:
        if target.name and not is_stream(target):  # to which as many may write as like
            try:
                stack.enter_context(reserved(target, alone=True))
            except OSError as error:  # a folder, say, that may be written to, but not what it lies in
                if error.errno == errno.EBUSY:
                    raise
        yield


@contextmanager
def locked_folder(folder: Path, doing: str) -> Iterator[None]:
    """Holds a lock on a folder, which is made where it is missing, and removed again where it is left empty.

    The lock ends with its process. It counts on all hosts that share the folder, unless their file system locks only what is open
    for writing (NFS), as no folder can be. UserError where another process holds it; doing: what that process does.
    """
    missing = [place for place in (folder, *folder.absolute().parents) if not place.exists()]
    handle = -1
    try:
        with suppress(OSError):  # whoever writes there will say why nothing can be written
            folder.mkdir(parents=True, exist_ok=True)
            handle = os.open(folder, os.O_RDONLY)
        if handle >= 0 and try_lock(handle) is False:
            raise UserError(f"another process is {doing}", where=folder, remedy="wait for it, or choose another --out")
        yield
    finally:
        if handle >= 0:
            os.close(handle)
        for place in missing:
            with suppress(OSError):  # not empty: the work is in it
                place.rmdir()


@contextmanager
def reserved(target: Path, *, folder: bool = False, alone: bool = False) -> Iterator[Path]:
    """Yields the path of a new empty file or folder beside `target`, whose folder exists; deletes it at the end, if still there.

    Raises OSError, also where `target` is a device or a pipe, or another process writes it alone.
    """
    if is_stream(target):
        raise OSError(errno.EINVAL, "a device or a pipe is there", str(target))
    recover_interrupted_write(target)
    remove_leftovers(target)
    if alone:
        _require_alone(target)
    path = _sibling(target, NEW)
    with ExitStack() as stack:
        if folder:
            path.mkdir()
        else:
            path.touch()
        stack.callback(_delete, path)
        if fcntl:
            lock = stack.enter_context(_opened(path))
            with suppress(OSError):  # there are no locks; else it waits for those who look whether anybody holds it
                fcntl.flock(lock, fcntl.LOCK_EX)
        if alone:
            _require_alone(target, path)
        yield path


def recover_interrupted_write(target: Path) -> None:
    """Puts back a target that a killed writer had set aside. Cheap where there is nothing to do."""
    deadline = time.monotonic() + _SWAP_PATIENCE_S
    while not os.path.lexists(target):
        aside = _siblings(target, OLD)
        if not aside:
            return
        if _is_alive(aside[-1]) and time.monotonic() < deadline:
            time.sleep(0.02)  # its writer is between its two renames
            continue
        with suppress(OSError):  # another process may have put it back first
            os.rename(aside[-1], target)
        return


def remove_leftovers(target: Path) -> None:
    """Deletes what killed writers of `target` left beside it."""
    for path in _siblings(target, NEW):
        if not _is_alive(path):
            _delete(path)
    if os.path.lexists(target):
        for path in _siblings(target, OLD):
            if not _is_alive(path):
                discard(path, target)


def discard(path: Path, target: Path | None = None) -> None:
    """Deletes a file or folder, gone from its name in one step: who still writes into it finds nothing there. Raises nothing.

    What a kill leaves of it, under a hidden name of `target` (by default `path`), goes with the next remove_leftovers(target).
    """
    gone = _sibling(target or path, NEW)
    with suppress(OSError):
        os.rename(path, gone)  # first: a half deleted .old must never be put back
        _delete(gone)


def is_leftover(name: str) -> bool:
    """Whether a file's name is a hidden one of ours, left by a writer that was killed, or being written."""
    return re.fullmatch(rf"\..+\.({NEW}|{OLD})-\d+-[0-9a-f]{{8}}", name) is not None


def _flush(path: Path) -> None:
    """Flushes a file, or a folder and the files in it, to the disk."""
    for file in path.iterdir() if path.is_dir() else [path]:
        if file.is_file():
            with _opened(file) as handle:
                os.fsync(handle)
    if path.is_dir():
        _flush_names(path)


def _flush_names(folder: Path) -> None:
    """Makes names in `folder` survive a power cut; nothing where the system has no such call."""
    if os.name == "posix":
        with suppress(OSError), _opened(folder) as handle:
            os.fsync(handle)


def _take_place(new: Path, target: Path) -> None:
    if target.exists() and new.is_dir() == target.is_dir():  # a folder with the mode of a file could not be deleted
        shutil.copymode(target, new)
    if not (new.is_dir() and target.is_dir()):
        os.replace(new, target)
        return
    old = _sibling(target, OLD)
    os.rename(target, old)
    try:
        os.rename(new, target)
    except OSError:
        os.rename(old, target)
        raise
    discard(old, target)


def _delete(path: Path) -> None:
    with suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _sibling(target: Path, kind: str) -> Path:
    return target.with_name(f".{target.name}.{kind}-{os.getpid()}-{secrets.token_hex(4)}")


def _siblings(target: Path, kind: str) -> list[Path]:
    """Hidden names of that kind beside `target`, oldest first."""
    pattern = re.compile(re.escape(f".{target.name}.{kind}-") + r"\d+-[0-9a-f]{8}")
    found: list[tuple[float, Path]] = []
    with suppress(OSError), os.scandir(target.parent) as entries:
        for entry in entries:
            if pattern.fullmatch(entry.name):
                with suppress(OSError):
                    found.append((entry.stat(follow_symlinks=False).st_mtime, Path(entry.path)))
    return [path for _, path in sorted(found)]


def _require_alone(target: Path, own: Path | None = None) -> None:
    """OSError where another process is writing `target`; own: what this one writes.

    Two that begin in one moment see each other: the one whose name comes first waits for the other to give way.
    """
    deadline = time.monotonic() + (_GIVE_WAY_S if own else 0.0)
    while others := [path for path in _siblings(target, NEW) if _writer_of(path) != os.getpid() and _is_held(path)]:
        if (own and own > min(others)) or time.monotonic() > deadline:
            raise OSError(errno.EBUSY, "another process is writing it", str(target))
        time.sleep(0.02)


def try_lock(handle: int, *, shared: bool = False) -> bool | None:
    """Takes the lock on an open file or folder, without waiting: False where another has it; None where there are no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some network file systems have none
        return None
    return True


def _writer_of(path: Path) -> int:
    """The id of the process that made the hidden name `path`."""
    return int(path.name.rsplit("-", 2)[1])


def _is_held(path: Path) -> bool | None:
    """Whether a process has a lock on the hidden name `path`; None where nothing tells: no locks, or another user's file."""
    try:
        with _opened(path) as handle:
            taken = try_lock(handle, shared=True)
    except FileNotFoundError:
        return False
    except OSError:
        return None
    return None if taken is None else not taken


def _is_alive(path: Path) -> bool:
    """Whether the process that made the hidden name `path` may still be at work on it."""
    if _writer_of(path) == os.getpid() or (held := _is_held(path)):
        return True
    with suppress(OSError):  # it is gone
        young = time.time() - path.stat().st_mtime < _LEFTOVER_AGE_S
        return young and (held is None or _process_exists(_writer_of(path)))  # on another host, an id tells nothing
    return False


@contextmanager
def _opened(path: Path) -> Iterator[int]:
    flags = os.O_RDONLY if path.is_dir() else os.O_RDWR  # network file systems lock only what is open for writing
    handle = os.open(path, flags)
    try:
        yield handle
    finally:
        os.close(handle)


def _process_exists(pid: int) -> bool:
    try:
        if os.name == "posix":  # elsewhere os.kill would end it; age decides
            os.kill(pid, 0)
    except OSError as error:
        return not isinstance(error, ProcessLookupError)
    return True
