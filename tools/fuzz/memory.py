"""What this process holds, so that it can be compared from one hour to the next."""

import ctypes
import gc
import os
import sys
from contextlib import suppress
from pathlib import Path

# Of glibc's many arenas each grows to what its fullest moment took, and where threads come and go that goes on for a hundred
# rounds. With threads of its own, Mesa's llvmpipe keeps what up to 64 frames were drawn from until they are needed again.
STEADY = {"MALLOC_ARENA_MAX": "1", "LP_NUM_THREADS": "0"}


def with_steady_memory(module: str) -> None:
    """Begins `python -m module` anew, with what libraries keep for later kept small, where it is not so yet."""
    if any(os.environ.get(name) != value for name, value in STEADY.items()):
        os.environ.update(STEADY)  # read when a program begins
        os.execv(sys.executable, [sys.executable, "-m", module, *sys.argv[1:]])


def resident() -> int:
    """Bytes of our own, without mapped files such as libraries, behind all that is garbage; 0 where the system does not tell as
    Linux does.
    """
    gc.collect()
    with suppress(OSError, AttributeError):  # other C libraries than glibc
        ctypes.CDLL(None).malloc_trim(0)
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("RssAnon:"))
    except (OSError, StopIteration):
        return 0
