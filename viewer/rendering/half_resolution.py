"""A pack at half its resolution, for graphics cards that have no room for the whole.

Notation: each voxel of the half pack stands for 2^3 voxels of the whole one, the last of an odd side for those it has.
Its premultiplied colour, features and opacity a are their mean. A ray takes half as many samples there, each of which
must do the work of two, one behind the other: c + (1 - a) c and a + (1 - a) a, both 2 - a times the mean. The block size
stays, so that the padding, which is made anew from the neighbours, takes no greater share.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from scenepack.blocks import atlas_from_volume, block_copy, grid_block_counts
from scenepack.pack import Pack

Triple = tuple[int, int, int]


def half_resolution(pack: Pack) -> Pack:
    """`pack` with voxels of twice the side, in the same place; the grid's far faces may lie one old voxel farther out."""
    x, y, z = (-(-side // 2) for side in pack.grid_size)
    grid_size = (x, y, z)
    occupied = np.zeros(grid_block_counts(grid_size, pack.block_size)[::-1], bool)
    bz, by, bx = np.nonzero(pack.occupied)
    occupied[bz // 2, by // 2, bx // 2] = True  # along each axis, macroblocks 2 i and 2 i + 1 make the new one i

    def read_box(low: Triple, high: Triple) -> tuple[np.ndarray, np.ndarray | None]:
        rgba = _means(pack, pack.atlas_rgba, low, high)
        gain = 2.0 - rgba[..., 3:] / 255.0
        features = None
        if pack.atlas_features is not None:
            features = _quantised(_means(pack, pack.atlas_features, low, high) * gain)
        return _quantised(rgba * gain), features

    indices, rgba, features = atlas_from_volume(read_box, grid_size, pack.block_size, occupied)
    if pack.atlas_features is not None and features is None:
        features = np.zeros_like(rgba)
    return replace(
        pack,
        voxel_size=2.0 * pack.voxel_size,
        grid_size=grid_size,
        atlas_indices=indices,
        atlas_rgba=rgba,
        atlas_features=features,
    )


def _quantised(values: np.ndarray) -> np.ndarray:
    return np.rint(np.minimum(values, 255.0)).astype(np.uint8)


def _means(pack: Pack, atlas: np.ndarray, low: Triple, high: Triple) -> np.ndarray:
    """float32 [z, y, x, c], 0 … 255: means of 2^3 voxels, for the half pack's voxels `low` to `high` (z, y, x)."""
    start = [2 * n for n in low]
    voxels = np.zeros((*(2 * (hi - lo) for lo, hi in zip(low, high, strict=True)), atlas.shape[3]), np.uint8)
    stop = [min(s + n, side) for s, n, side in zip(start, voxels.shape, pack.grid_size[::-1], strict=False)]
    size = pack.block_size
    occupied = pack.occupied
    for block in product(*(range(s // size, -(-e // size)) for s, e in zip(start, stop, strict=True))):
        if not occupied[block]:
            continue
        first = [max(i * size, s) for i, s in zip(block, start, strict=True)]
        last = [min((i + 1) * size, e) for i, e in zip(block, stop, strict=True)]
        to = tuple(slice(a - s, b - s) for a, b, s in zip(first, last, start, strict=True))
        of = tuple(slice(a - i * size + 1, b - i * size + 1) for a, b, i in zip(first, last, block, strict=True))
        voxels[to] = block_copy(pack, atlas, block)[of]
    z, y, x, channels = voxels.shape
    pairs = voxels.reshape(z // 2, 2, y // 2, 2, x // 2, 2, channels)
    return pairs.mean(axis=(1, 3, 5), dtype=np.float32)
