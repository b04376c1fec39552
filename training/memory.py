"""Memory: how much is free, and arrays that JAX takes over without a copy. No JAX here."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np

ALIGNED = 64  # bytes: where arrays begin that JAX takes over on a processor without copying them
ASSUMED_FREE = 4 << 30  # bytes, where the system does not tell


def free_memory() -> int:
    """Bytes that this process may take, as far as the system tells."""
    try:
        lines = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text().splitlines())
        free = 1024 * int(lines["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        free = ASSUMED_FREE
    with contextlib.suppress(OSError, ValueError):  # a container's limit
        most, used = (int(Path("/sys/fs/cgroup", name).read_text()) for name in ("memory.max", "memory.current"))
        free = min(free, most - used)
    return max(free, 0)


def aligned(shape: tuple[int, ...], dtype: Any = np.float32) -> np.ndarray:
    """Zeros that begin where JAX takes an array over on a processor (jnp.asarray) without copying it."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.zeros(size + ALIGNED, np.uint8)
    start = -memory.ctypes.data % ALIGNED
    return memory[start : start + size].view(dtype).reshape(shape)
