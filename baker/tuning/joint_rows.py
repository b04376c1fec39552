"""A pack's voxels as one list without copies, for optimising them: each grid voxel once, wherever the atlas repeats it.

Notation: row 0 stands for every empty voxel and stays zero; rows 1 ... V are the voxels with alpha, in the order in which
the atlas holds them. A padding voxel has the row of the voxel that it copies, so a gradient that reaches any copy reaches
the one row, and what is written back is padded right by construction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from scenepack.blocks import block_copy
from scenepack.pack import Pack
from scenepack.padding import restore_padding


@dataclass(frozen=True)
class VoxelRows:
    """content uint8 [V + 1, 8]: rgb, alpha, features, premultiplied. atlas int32 [D, H, W]: the row of each atlas voxel."""

    content: np.ndarray
    atlas: np.ndarray


def voxel_rows(pack: Pack) -> VoxelRows:
    """The rows of a pack; features are zero where it has none."""
    atlas = np.zeros(pack.atlas_rgba.shape[:3], np.int32)
    count = 0
    for block in np.argwhere(pack.occupied):
        data = block_copy(pack, atlas, tuple(block))[1:-1, 1:-1, 1:-1]
        some = block_copy(pack, pack.atlas_rgba, tuple(block))[1:-1, 1:-1, 1:-1, 3] > 0
        found = int(np.count_nonzero(some))
        data[some] = np.arange(count + 1, count + found + 1, dtype=np.int32)
        count += found
    first = np.zeros(count + 1, np.int64)  # an atlas voxel that holds the row's content
    flat = atlas.ravel()
    where = np.flatnonzero(flat)
    first[flat[where]] = where
    content = np.zeros((count + 1, 8), np.uint8)
    content[1:, :4] = pack.atlas_rgba.reshape(-1, 4)[first[1:]]
    if pack.atlas_features is not None:
        content[1:, 4:] = pack.atlas_features.reshape(-1, 4)[first[1:]]
    restore_padding(atlas, pack.atlas_indices, pack.block_size)
    return VoxelRows(content, atlas)


def with_content(pack: Pack, rows: VoxelRows, content: np.ndarray) -> Pack:
    """The pack with its voxels' content uint8 [V + 1, 8] replaced, all copies alike."""
    features = None if pack.atlas_features is None else content[rows.atlas, 4:]
    return replace(pack, atlas_rgba=content[rows.atlas, :4], atlas_features=features)


def rows_by_slot(pack: Pack, rows: VoxelRows) -> np.ndarray:
    """int32 [slots B³]: the row of each voxel of the padded copies, in baker.tuning.pack_layout's order."""
    blocks = np.argwhere(pack.occupied)
    side = pack.padded_block_size
    out = np.zeros((max(len(blocks), 1), side, side, side), np.int32)
    for slot, block in enumerate(blocks):
        out[slot] = block_copy(pack, rows.atlas, tuple(block))
    return out.reshape(-1)


def cells_of_rows(pack: Pack, rows: VoxelRows, side: int) -> np.ndarray:
    """int32 [V + 1]: which cell of side³ grid voxels each row lies in, numbered from 1; row 0 is cell 0."""
    width, height, _ = (-(-n * pack.block_size // side) for n in pack.grid_blocks)
    place = np.full(len(rows.content), -1, np.int64)
    for some, at in _places(pack, rows):
        z, y, x = (along // side for along in at)
        place[some] = (z * height + y) * width + x
    return np.unique(place, return_inverse=True)[1].astype(np.int32)


def odd_of_rows(pack: Pack, rows: VoxelRows) -> np.ndarray:
    """uint8 [V + 1]: x + 2 y + 4 z of whether each row's place in the grid is odd; 0 for row 0."""
    odd = np.zeros(len(rows.content), np.uint8)
    for some, (z, y, x) in _places(pack, rows):
        odd[some] = (x & 1) + 2 * (y & 1) + 4 * (z & 1)
    return odd


def _places(pack: Pack, rows: VoxelRows) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
    """The rows of each macroblock, and where in the grid they lie: z, y, x."""
    for block in np.argwhere(pack.occupied):
        data = block_copy(pack, rows.atlas, tuple(block))[1:-1, 1:-1, 1:-1]
        local = np.nonzero(data)
        yield data[local], [i + b * pack.block_size for i, b in zip(local, block.tolist(), strict=True)]
