"""Messages about scenes: what was left out or mended, names, sizes."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from console import Notice

NAMED = 8  # names in a message


def notice(where: Path | str, text: str, names: Sequence[str] = ()) -> None:
    """Tells the user what was left out or mended, and the first of the `names` that it concerns."""
    warnings.warn(Notice(f"{where}: {text} ({few(names)})" if names else f"{where}: {text}"), stacklevel=3)


def few(names: Sequence[str]) -> str:
    """The first NAMED of some names; where there are more, how many."""
    return ", ".join(names[:NAMED]) + (f", … ({len(names)} in all)" if len(names) > NAMED else "")


def times(size: Sequence[int]) -> str:
    """A size, (width, height) in pixels."""
    return f"{size[0]}x{size[1]}"
