"""GPU memory: packs halved to fit.

Notation: each voxel of the half pack stands for 2^3 voxels of the whole one, the last of an odd side for those it has.
Its premultiplied colour, features and opacity a are their mean. A ray takes half as many samples there, each of which
must do the work of two, one behind the other: c + (1 - a) c and a + (1 - a) a, both 2 - a times the mean. The block size
stays, so that the padding, which is made anew from the neighbours, takes no greater share.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from console import UserError
from scenepack.blocks import Triple, atlas_from_volume, dense_from_pack, grid_block_counts
from scenepack.pack import Pack

OR_HALF = "or measure it at half resolution: --allow-half"  # the remedy of commands that have this option


class NoRoomError(UserError):
    """A pack does not fit on the graphics card."""


def half_resolution(pack: Pack) -> Pack:
    """`pack` with voxels of twice the side, in the same place; the grid's far faces may lie one old voxel farther out."""
    x, y, z = (-(-side // 2) for side in pack.grid_size)
    grid_size = (x, y, z)
    occupied = np.zeros(grid_block_counts(grid_size, pack.block_size)[::-1], bool)
    bz, by, bx = np.nonzero(pack.occupied)
    occupied[bz // 2, by // 2, bx // 2] = True  # along each axis, macroblocks 2 i and 2 i + 1 make the new one i

    def read_box(low: Triple, high: Triple) -> np.ndarray:
        end = [min(2 * n, side) for n, side in zip(high[::-1], pack.grid_size, strict=True)]
        box = (2 * low[2], 2 * low[1], 2 * low[0]), (end[0], end[1], end[2])
        means = np.concatenate([_means(part) for part in dense_from_pack(pack, box) if part is not None], axis=-1)
        gain = 2.0 - means[..., 3:4] / 255.0
        return np.rint(np.minimum(means * gain, 255.0)).astype(np.uint8)

    channels = 4 * len(pack.atlases)
    indices, rgba, features = atlas_from_volume(read_box, grid_size, pack.block_size, occupied, channels)
    atlas = {"atlas_indices": indices, "atlas_rgba": rgba, "atlas_features": features}
    return replace(pack, voxel_size=2.0 * pack.voxel_size, grid_size=grid_size, **atlas)


def _means(voxels: np.ndarray) -> np.ndarray:
    """float32 [z, y, x, c], 0 … 255: means of 2^3 voxels of uint8 [z', y', x', c], whose odd sides end with nothing."""
    voxels = np.pad(voxels, [(0, side % 2) for side in voxels.shape[:3]] + [(0, 0)])
    z, y, x, channels = voxels.shape
    return voxels.reshape(z // 2, 2, y // 2, 2, x // 2, 2, channels).mean(axis=(1, 3, 5), dtype=np.float32)
