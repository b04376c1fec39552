"""Messages about scenes: what was left out or mended, names, sizes."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from console import Notice


def notice(where: Path | str, text: str, names: Sequence[str] = ()) -> None:
    """Tells the user what was left out or mended, and the first of the `names` that it concerns."""
    warnings.warn(Notice(f"{where}: {text} ({few(names)})" if names else f"{where}: {text}"), stacklevel=3)


def few(names: Sequence[str], most: int = 3) -> str:
    """The first of some names."""
    return ", ".join(names[:most]) + (", …" if len(names) > most else "")


def times(size: Sequence[int]) -> str:
    """A size, (width, height) in pixels."""
    return f"{size[0]}x{size[1]}"
