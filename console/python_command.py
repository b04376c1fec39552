"""Command lines that start modules of ours in processes of their own."""

from __future__ import annotations

import sys


def module_command(module: str, *words: str) -> list[str]:
    """`python -m module words`, without the modules that lie in the current folder, which is the user's (-P)."""
    return [sys.executable, "-P", "-m", module, *words]
