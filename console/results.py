"""Files that a command writes where an option names them: figures as JSON, tables as text.

Commands ask `check_results` before work that takes minutes, so that a place where nothing can be written is reported first.
"""

import errno
import json
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from console.atomic import is_stream, reserved, write_file
from console.errors import UserError, not_written

STDOUT = Path("-")


def check_results(*files: Path | None, folder: Path | None = None) -> None:
    """UserError where one of `files` could not be written, or no file in `folder`. Tries it, and leaves nothing behind.

    None stands for what is not asked for, "-" for stdout. Folders that are missing are not made.
    """
    for file in files:
        if file is not None and file != STDOUT:
            with _written_to(file):
                _try_file(file)
    if folder is not None:
        with _written_to(folder):
            try_folder(folder)


def write_json(path: Path | None, value: Any) -> bool:
    """Writes `value` where `--json` asks for it; True where that is stdout ("-") and nothing else should be printed.

    UserError where it cannot be written.
    """
    text = json.dumps(value, indent=2)
    if path == STDOUT:
        print(text)
        return True
    write_result(path, text + "\n")
    return False


def write_result(path: Path | None, content: bytes | str | Iterable[bytes]) -> None:
    """Writes the file that an option names, if it does, in one step, and makes its folder. UserError where it cannot."""
    if path is not None:
        with _written_to(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_file(path, content)


def try_folder(folder: Path) -> None:
    """OSError where no file could be made in `folder`, which need not be there yet."""
    above = next(place for place in (folder, *folder.absolute().parents) if os.path.lexists(place))
    with tempfile.TemporaryDirectory(prefix=".snerg-", dir=above):
        pass


def _try_file(path: Path) -> None:
    if is_stream(path):
        if not os.access(path, os.W_OK):  # opened only once: the reader of a pipe would take it for the end
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    elif path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    elif path.parent.is_dir():
        with reserved(path.resolve()):  # by the name that it will have
            pass
    else:
        try_folder(path.parent)


@contextmanager
def _written_to(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        words, remedy = not_written(error)
        raise UserError(f"cannot be written: {words}", where=path, remedy=remedy) from error
