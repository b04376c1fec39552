"""Errors and notices for users."""

from __future__ import annotations

import errno
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from console.streams import one_line

LONGEST_PART = 300  # characters of a part of an error; names and values in it may come from anybody

# What the machine refuses is not a bug of ours, wherever it surfaces.
_REFUSED = {errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EPERM, errno.EROFS, errno.EMFILE, errno.ENAMETOOLONG}

# Why nothing can be written somewhere, in plain words, and what to do about it.
_NOT_WRITTEN = {
    errno.ENOENT: ("there is no such folder, and none can be made", "choose a folder that is there"),
    errno.ENOTDIR: ("a part of the path is a file, not a folder", "choose another folder"),
    errno.EEXIST: ("a part of the path is a file, not a folder", "choose another folder"),
    errno.EISDIR: ("a folder of that name is there", "choose another name"),
    errno.EACCES: ("writing there is not permitted", "choose a folder of your own"),
    errno.EPERM: ("writing there is not permitted", "choose a folder of your own"),
    errno.EROFS: ("that disk is read-only", "choose another disk"),
    errno.ENOSPC: ("the disk is full", "make room or choose another disk"),
    errno.EDQUOT: ("your share of the disk is used up", "make room or choose another disk"),
    errno.EBUSY: ("another process is writing it", "wait for it, or choose another name"),
    errno.ENAMETOOLONG: ("the name is too long", "choose a shorter one"),
}

# What an installation may lack, by the name that is imported, and the extra of ours that brings it (pyproject.toml).
_EXTRAS = {
    "jax": "train", "jaxlib": "train", "matplotlib": "train", "numba": "train", "optax": "train",
    "safetensors": "train", "av": "video", "pycolmap": "poses", "skimage": "export",
    "fast_simplification": "export",
}  # fmt: skip


class UserError(Exception):
    """Something the user can correct: bad arguments, files, data, or no OpenGL.

    what: the thing that is wrong ("the picture cannot be decoded"). where: file, key or argument.
    expected / found: the two sides of the mismatch. remedy: what to do about it.
    Printed as one line, fit for terminals and labels: without control characters, the middle of long parts left out.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str | Path | None = None,
        expected: object = None,
        found: object = None,
        remedy: str | None = None,
    ) -> None:
        self.what, self.where, self.expected, self.found, self.remedy = what, where, expected, found, remedy
        line = _part(what) if where is None else f"{_part(where)}: {_part(what)}"
        sides = [
            f"{name} {_part(side)}" for name, side in (("expected", expected), ("found", found)) if side is not None
        ]
        if sides:
            line += f" ({', '.join(sides)})"
        if remedy is not None:
            line += f"; {_part(remedy)}"
        super().__init__(line)

    def with_remedy(self, remedy: str) -> UserError:
        """The same error of the same kind with something else to do about it, after what it says already."""
        both = remedy if self.remedy is None else f"{self.remedy}, {remedy}"
        return type(self)(self.what, where=self.where, expected=self.expected, found=self.found, remedy=both)


def _part(value: object) -> str:
    return one_line(str(value), LONGEST_PART)


def refusal(error: BaseException) -> str | None:
    """In plain words what the machine refuses: disk, permissions, memory. None where `error` is about something else."""
    if isinstance(error, OSError) and error.errno in _REFUSED:
        words = "the disk is full" if error.errno == errno.ENOSPC else str(error.strerror)
        return f"{error.filename}: {words}" if error.filename else words
    if isinstance(error, FileNotFoundError) and "temporary directory" in str(error):  # in the words of tempfile
        return "no temporary folder can be written; make room in /tmp, or name another folder: TMPDIR=FOLDER"
    if isinstance(error, MemoryError):
        return f"this machine has not enough free memory for it ({error or 'allocation failed'})"
    return None


def not_written(error: OSError) -> tuple[str, str]:
    """Why something could not be written, in plain words, and the remedy."""
    words = error.strerror or str(error) or type(error).__name__
    return _NOT_WRITTEN.get(error.errno or 0, (words, "choose another place"))


def missing_extra(error: BaseException) -> str | None:
    """What to install, where `error` comes of a package that an optional part of snerg needs; else None."""
    name = (error.name or "").split(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    extra = _EXTRAS.get(name)
    return extra and f"{name} is not installed; pip install 'snerg[{extra}]'"


# --- Warnings that a person should read ---

LONGEST_NOTICE = 600  # characters


class Notice(UserWarning):
    """A warning for the user, one line: the command repaired or left out something, and continues."""

    def __init__(self, text: object) -> None:
        super().__init__(one_line(str(text), LONGEST_NOTICE))


_collected = threading.local()
_handlers: list[tuple[Callable[[str], object], bool]] = []  # arguments of handle_notices, the innermost last


def notify(notice: Notice, stacklevel: int = 2) -> None:
    """Gives a notice to this thread's collect_notices, else to handle_notices, else to warnings.warn, with stacklevel."""
    texts = getattr(_collected, "texts", None)
    if texts is not None:
        texts.append(str(notice))
        return
    for on_notice, show_too in reversed(_handlers):
        on_notice(str(notice))
        if not show_too:
            return
    warnings.warn(notice, stacklevel=stacklevel + 1)


@contextmanager
def collect_notices() -> Iterator[list[str]]:
    """The texts of this thread's Notices in the `with` block, which go nowhere else."""
    outer, texts = getattr(_collected, "texts", None), []
    _collected.texts = texts
    try:
        yield texts
    finally:
        _collected.texts = outer


@contextmanager
def handle_notices(on_notice: Callable[[str], object], *, show_too: bool = False) -> Iterator[None]:
    """Calls `on_notice` with the text of each Notice, of any thread. show_too: they are also shown as without it."""
    handler = on_notice, show_too
    _handlers.append(handler)
    try:
        yield
    finally:
        _handlers.remove(handler)
