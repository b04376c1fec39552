"""Aligned arrays, and what the C library does with freed buffers. No JAX here."""

from __future__ import annotations

import contextlib
import ctypes
from typing import Any

import numpy as np

ALIGNED = 64  # bytes: where arrays begin that JAX takes over on a processor without copying them
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -2, -4, -8


def aligned(shape: tuple[int, ...], dtype: Any = np.float32) -> np.ndarray:
    """Zeros that begin where JAX takes an array over on a processor (jnp.asarray) without copying it."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.zeros(size + ALIGNED, np.uint8)
    start = -memory.ctypes.data % ALIGNED
    return memory[start : start + size].view(dtype).reshape(shape)


def keep_freed_memory() -> None:
    """Makes glibc keep freed buffers; does nothing with another C library. Call once, early.

    Every step of JAX on a CPU frees and takes the same large buffers. By default glibc returns those beyond 32 MB to the kernel,
    which clears and maps their pages anew: a gather's gradient took 58 ms instead of 16 ms.
    """
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL("libc.so.6").mallopt
        for parameter, value in (
            (_M_MMAP_MAX, 0), (_M_TRIM_THRESHOLD, 2**31 - 1), (_M_TOP_PAD, 1 << 26), (_M_ARENA_MAX, 1)
        ):  # fmt: skip
            mallopt(parameter, value)
