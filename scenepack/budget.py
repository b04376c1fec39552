"""What opening a pack may take: asked before anything is allocated, for a few bytes can claim gigabytes."""

from __future__ import annotations

import math

import numpy as np

from console import UserError
from console.memory import free_memory

SHARED_FREELY, SHARED_AT_MOST = 4096, 16  # macroblocks; more of them to an atlas block make no scene
# Voxels that an atlas may have whatever is in use, and how many for each in use: bakers fill theirs to the last rows.
EMPTY_FREELY, EMPTY_AT_MOST = 1 << 26, 16


def require_memory(needed: int, where: object) -> None:
    """UserError where so many bytes are more than is free."""
    free = free_memory()
    if free is not None and needed > free:
        raise UserError(
            "its atlas does not fit in memory",
            where=str(where),
            expected=f"at most {free / 1e9:.1f} GB, which are free",
            found=f"{needed / 1e9:.1f} GB",
            remedy="close other programs, or bake it at a lower resolution",
        )


def require_filled(atlas_size: tuple[int, int, int], used: int, where: str) -> None:
    """UserError where an atlas is large and next to nothing in use: room for it is made, however few bytes are behind it.

    used: voxels of the macroblocks in use, padding included.
    """
    held = math.prod(atlas_size)
    if held > max(EMPTY_FREELY, EMPTY_AT_MOST * used):
        raise UserError(
            "the atlas is far larger than its content",
            where=where,
            expected=f"about {used:,} voxels, those of the macroblocks in use",
            found=f"{held:,}",
            remedy="copy the pack again, or bake it again",
        )


def require_distinct(used: np.ndarray, where: str) -> None:
    """UserError where far more macroblocks than atlas blocks make work and memory that the pack's bytes do not explain: each
    macroblock takes a place of its own on the graphics card.

    used: uint8 [n, 3], the atlas block of each macroblock.
    """
    if len(used) <= SHARED_FREELY:
        return
    distinct = len(np.unique(used.astype(np.uint32) @ np.array([1, 256, 65536], np.uint32)))
    if len(used) > SHARED_FREELY + SHARED_AT_MOST * distinct:
        raise UserError(
            f"{len(used)} macroblocks share {distinct} blocks of the atlas",
            where=where,
            expected=f"about one each, and at most {SHARED_AT_MOST} to a block",
            remedy="copy the pack again, or bake it again",
        )
