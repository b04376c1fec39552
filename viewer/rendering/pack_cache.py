"""Pack cache: weak per-pack memoisation. The thread that reads a pack computes first, so that no window waits."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from scenepack.pack import Pack

T = TypeVar("T")


def cached_per_pack(compute: Callable[[Pack], T]) -> Callable[[Pack], T]:
    """Decorator: keeps the result of `compute` for as long as the pack lives."""
    results: dict[int, T] = {}

    @wraps(compute)
    def cached(pack: Pack) -> T:
        key = id(pack)
        if key not in results:
            results[key] = compute(pack)
            weakref.finalize(pack, results.pop, key, None)
        return results[key]

    return cached
