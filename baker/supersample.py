"""The content of kept macroblocks: 16 Gaussian samples per voxel, averaged and quantised (SNeRG sections 5.4 and 5.5)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from baker.culling import CELL, TAU_ALPHA, Culling
from baker.field_query import FieldQuery
from baker.grid import BakeGrid

SAMPLES = 16
SIGMA = 1 / np.sqrt(12)  # of the Gaussian, in voxels
VOXELS_AT_ONCE = 65_536


class BlockStore:
    """Baked voxels by macroblock: uint8 [blocks, block_size³ as z, y, x, 8]; rgb and alpha, premultiplied, then features.

    read_box serves scenepack.blocks.atlas_from_volume; macroblocks that were not kept read as zeros.
    """

    def __init__(self, kept: np.ndarray, block_size: int) -> None:
        self.block_size = block_size
        self.slot = np.full(kept.shape, -1, np.int64)
        self.slot[kept] = np.arange(kept.sum())
        self.voxels = np.zeros((int(kept.sum()), *(block_size,) * 3, 8), np.uint8)

    def read_box(self, low: tuple[int, int, int], high: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Voxels of the box from low to high, both (z, y, x): rgba and features, uint8 [z, y, x, 4] each."""
        out = np.zeros((*(b - a for a, b in zip(low, high, strict=True)), 8), np.uint8)
        size = self.block_size
        ranges = [range(a // size, (b - 1) // size + 1) for a, b in zip(low, high, strict=True)]
        for block in ((k, j, i) for k in ranges[0] for j in ranges[1] for i in ranges[2]):
            slot = self.slot[block]
            if slot < 0:
                continue
            start = [max(b * size, a) for b, a in zip(block, low, strict=True)]
            stop = [min((b + 1) * size, a) for b, a in zip(block, high, strict=True)]
            to = tuple(slice(s - a, e - a) for s, e, a in zip(start, stop, low, strict=True))
            of = tuple(slice(s - b * size, e - b * size) for s, e, b in zip(start, stop, block, strict=True))
            out[to] = self.voxels[(slot, *of)]
        return out[..., :4], out[..., 4:]


def supersample(
    query: FieldQuery,
    grid: BakeGrid,
    culling: Culling,
    *,
    tau_alpha: float = TAU_ALPHA,
    seed: int = 0,
    on_block: Callable[[int], None] | None = None,
) -> BlockStore:
    """Fills the kept macroblocks. Voxels far from any opacity stay zero without being asked.

    Voxels fainter than tau_alpha become empty: what is too faint to keep a macroblock alive only costs samples (a fifth
    of those that a ray took on lego) and bytes.
    """
    store = BlockStore(culling.kept, grid.block_size)
    per_block = grid.block_size // CELL
    for slot, block in enumerate(np.argwhere(culling.kept)):
        at = tuple(slice(b * per_block, (b + 1) * per_block) for b in block)
        wanted = np.repeat(np.repeat(np.repeat(culling.cells[at], CELL, 0), CELL, 1), CELL, 2)
        z, y, x = np.nonzero(wanted)
        local = np.stack([x, y, z], -1)
        rng = np.random.default_rng((seed, *block))
        values = np.empty((len(local), 8), np.float32)
        for start in range(0, len(local), VOXELS_AT_ONCE):
            part = local[start : start + VOXELS_AT_ONCE]
            values[start : start + len(part)] = _average(query, grid, part + block[::-1] * grid.block_size, rng)
        values[values[:, 3] < tau_alpha] = 0
        store.voxels[slot][z, y, x] = np.round(255 * values)
        if on_block:
            on_block(slot + 1)
    return store


def _average(query: FieldQuery, grid: BakeGrid, voxels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """float32 [N, 8] of voxels [N, 3] (x, y, z): premultiplied rgb, alpha and features, averaged over the samples.

    Colours are weighted by opacity before they are averaged: what is transparent must not tint what is not.
    """
    offsets = rng.normal(0.0, SIGMA, (len(voxels), SAMPLES, 3))
    points = (voxels[:, None] + 0.5 + offsets).reshape(-1, 3)
    field = query(grid.training_points(points))
    alpha = (1 - np.exp(-np.asarray(field.density) * grid.voxel_size))[:, None]
    stacked = np.concatenate([field.diffuse * alpha, alpha, field.features * alpha], axis=-1)
    return stacked.reshape(len(voxels), SAMPLES, 8).mean(1)
