"""Warnings that a person should read: one plain line on stderr, without source lines of ours."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from console.streams import one_line

LONGEST_NOTICE = 600  # characters


class Notice(UserWarning):
    """A warning meant for the user of a command: something was mended or left out, and work goes on. One line, as errors are."""

    def __init__(self, text: object) -> None:
        super().__init__(one_line(str(text), LONGEST_NOTICE))


@contextmanager
def plain_notices(prog: str) -> Iterator[None]:
    """Prints each Notice as "PROG: warning: ..." on stderr; other warnings stay as Python shows them."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", Notice)
        usual = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if issubclass(category, Notice):
                print(f"{prog}: warning: {message}", file=file or sys.stderr)
            else:
                usual(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        yield
