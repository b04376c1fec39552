"""What a command prints: characters that any terminal takes, to readers that may go away."""

import errno
import io
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

LONGEST_LINE = 2000  # characters; names and values in it may come from anybody
_GONE = {errno.EPIPE, errno.EIO, errno.ENXIO, errno.EBADF}  # `| head` has read enough; the terminal was closed
_SURROGATES = re.compile("[\ud800-\udfff]")  # what Python makes of names of files that are not UTF-8


def printable(text: str) -> str:
    """`text` as it can be written as UTF-8 and drawn: bytes of names that are not UTF-8 become U+FFFD."""
    return _SURROGATES.sub("\N{REPLACEMENT CHARACTER}", text)


def one_line(text: str, longest: int = LONGEST_LINE) -> str:
    """`text` in one line without control characters, which could move the cursor or colour what others print.

    longest: characters; of more, the middle is left out.
    """
    shown = text if len(text) <= 4 * longest else text[: 2 * longest] + text[-2 * longest :]
    line = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in " ".join(shown.split()))
    return line if len(line) <= longest else f"{line[: longest // 2]} … {line[-longest // 2 :]}"


def open_closed_streams() -> None:
    """Leads stdin, stdout and stderr nowhere where they were closed before the start (`>&-`). Call before files are opened.

    Otherwise the first files that are opened get their numbers, and what libraries print goes into these files.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "r" if number == 0 else "w", encoding="utf-8", closefd=False))  # noqa: SIM115


@contextmanager
def lasting_output() -> Iterator[None]:
    """stdout and stderr that the work outlives: what is printed after their reader went away is dropped.

    On a terminal or pipe that is not UTF-8, what it cannot show becomes "?" instead of an exception.
    """
    open_closed_streams()
    before = sys.stdout, sys.stderr
    encoding = (getattr(sys.stdout, "encoding", None) or "utf-8").lower().replace("-", "")
    if encoding != "utf8" and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    sys.stdout, sys.stderr = (_Lasting(stream) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


class _Lasting:
    """A text stream, but for what happens when its reader is gone."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return self._stream.write(printable(text))
        except OSError as error:
            self._drop(error)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._drop(error)

    def _drop(self, error: OSError) -> None:
        """From now on into nothing; also what is still buffered, and what libraries print without asking Python."""
        if error.errno not in _GONE:
            raise error
        with suppress(OSError, ValueError):
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, self._stream.fileno())
            os.close(nothing)
