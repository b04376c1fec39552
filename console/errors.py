"""The error a user can mend (docs/commands.md: exit status 2, one line on stderr)."""

from __future__ import annotations

import errno
from pathlib import Path

# What the machine refuses is not a bug of ours, wherever it surfaces.
_REFUSED = {errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EPERM, errno.EROFS, errno.EMFILE}


class UserError(Exception):
    """Something the user can mend: bad arguments, files, data, or no OpenGL.

    what: the thing that is wrong ("the picture cannot be decoded"). where: file, key or argument.
    expected / found: the two sides of the mismatch. remedy: what to do about it.
    Printed as one line; parts left out are left out of the line.
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
        line = what if where is None else f"{where}: {what}"
        if expected is not None and found is not None:
            line += f" (expected {expected}, found {found})"
        elif expected is not None:
            line += f" (expected {expected})"
        elif found is not None:
            line += f" (found {found})"
        if remedy is not None:
            line += f"; {remedy}"
        super().__init__(" ".join(line.split()))


def refusal(error: BaseException) -> str | None:
    """In plain words what the machine refuses: disk, permissions, memory. None where `error` is about something else."""
    if isinstance(error, OSError) and error.errno in _REFUSED:
        words = "the disk is full" if error.errno == errno.ENOSPC else str(error.strerror)
        return f"{error.filename}: {words}" if error.filename else words
    if isinstance(error, MemoryError):
        return f"this machine has not enough free memory for it ({error or 'allocation failed'})"
    return None
