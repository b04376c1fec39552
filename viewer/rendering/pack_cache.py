"""What is worked out once for a pack, by whoever asks first: the thread that reads it, so that no window waits."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from scenepack.pack import Pack

T = TypeVar("T")


def cached_per_pack(work_out: Callable[[Pack], T]) -> Callable[[Pack], T]:
    """`work_out`, whose result is kept for as long as the pack is."""
    known: dict[int, T] = {}

    @wraps(work_out)
    def kept(pack: Pack) -> T:
        key = id(pack)
        if key not in known:
            known[key] = work_out(pack)
            weakref.finalize(pack, known.pop, key, None)
        return known[key]

    return kept
