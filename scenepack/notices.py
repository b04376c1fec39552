"""Warnings about what the reader repairs in untidy packs (docs/format.md, "Untidy packs")."""

from __future__ import annotations

import warnings

from console import Notice


class PackWarning(Notice):
    """An untidy pack was opened all the same; the message says what was mended or left out."""


def warn(message: str) -> None:
    """One PackWarning line. Commands print it plainly (console.plain_notices)."""
    warnings.warn(PackWarning(message), stacklevel=3)
