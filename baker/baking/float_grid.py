"""A bake before it is quantised: the paper's "SNeRG (Float)" (table 3), which is never written to disk.

It has the macroblocks of a pack, and lies in an atlas of the same layout. Of the 32 bytes of a voxel only those with opacity are
held: `rows` says where in the atlas lies which of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from scenepack.blocks import atlas_layout, atlas_shape, choose_atlas_blocks
from scenepack.pack import Pack
from scenepack.blocks import restore_padding

CHANNELS = 8


@dataclass(frozen=True)
class FloatGrid:
    """The grid and its content."""

    pack: Pack  # of the same grid; its atlas has alpha 255 where there is any opacity, and nothing else
    rows: np.ndarray  # int32 [D, H, W]: of each place in the atlas, padding included, its row of values
    values: np.ndarray  # float32 [V + 1, 8]: premultiplied rgb, alpha, features, in 0 … 1; the first is empty

    @property
    def bytes(self) -> int:
        """What an atlas of floats takes, empty voxels included: what the paper counts."""
        return self.rows.size * CHANNELS * 4


Part = tuple[np.ndarray, np.ndarray, np.ndarray]


def assemble(parts: Iterable[Part], kept: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """atlas_indices (as Pack has them), rows and values of parts: macroblocks [n, 3] (z, y, x), flat places int [N] among their
    voxels, content float32 [N, 8]. kept: bool [blocks z, y, x], all macroblocks. size: data voxels a side.
    """
    atlas_blocks = choose_atlas_blocks(int(kept.sum()), size)
    indices = atlas_layout(kept, atlas_blocks)
    rows = np.zeros((*atlas_shape(atlas_blocks, size), 1), np.int32)
    values = [np.zeros((1, CHANNELS), np.float32)]
    count = 1
    for blocks, places, content in parts:
        some = content[:, 3] > 0
        number, flat = np.divmod(places[some], size**3)
        slots = indices[tuple(blocks[number].T)].astype(np.int64)  # x, y, z
        z, y, x = (
            at + 1 + slots[:, 2 - axis] * (size + 2) for axis, at in enumerate(np.unravel_index(flat, (size,) * 3))
        )
        rows[z, y, x, 0] = np.arange(count, count + len(flat), dtype=np.int32)
        count += len(flat)
        values.append(content[some])
    restore_padding(rows, indices, size)
    return indices, rows[..., 0], np.concatenate(values)
