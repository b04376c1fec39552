"""What this process holds, so that it can be compared from one hour to the next."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from contextlib import suppress
from pathlib import Path

ARENAS = "MALLOC_ARENA_MAX"


def with_one_arena(module: str) -> None:
    """Begins `python -m module` anew where glibc has many arenas: each grows to what its fullest moment took, and where
    threads come and go that goes on for a hundred rounds.
    """
    if os.environ.get(ARENAS) != "1":
        os.environ[ARENAS] = "1"  # read when a program begins
        os.execv(sys.executable, [sys.executable, "-m", module, *sys.argv[1:]])


def resident() -> int:
    """Bytes, behind all that is garbage; 0 where the system does not tell as Linux does."""
    gc.collect()
    with suppress(OSError, AttributeError):  # other C libraries than glibc
        ctypes.CDLL(None).malloc_trim(0)
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0
