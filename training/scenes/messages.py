"""Messages about scenes: what was left out or repaired, names, sizes."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from console import Notice

NAMED = 8  # names in a message


def notice(where: Path | str | None, text: str, names: Sequence[str] | None = None) -> None:
    """Warns of what was left out or repaired, with the first of the `names` that it concerns; not where there are none."""
    if names is not None and not names:
        return
    words = text if where is None else f"{where}: {text}"
    warnings.warn(Notice(f"{words} ({few(names)})" if names else words), stacklevel=3)


def few(names: Sequence[str]) -> str:
    """The first NAMED of some names; where there are more, how many."""
    return ", ".join(names[:NAMED]) + (f", … ({len(names)} in all)" if len(names) > NAMED else "")


def times(size: Sequence[int]) -> str:
    """A size, (width, height) in pixels."""
    return f"{size[0]}x{size[1]}"
