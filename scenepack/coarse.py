"""Something to see of a pack whose atlas is not whole yet: the same scene with coarser voxels.

Notation: bs = block_size, B = bs + 2; f = how many voxels, along an axis, become one; a *layer* is the B planes of the atlas that
one row of macroblocks along z takes. Any plane tells a slice of every macroblock in its layer. The coarse macroblock takes every
f-th data voxel and the outermost padding, and for a plane that is missing the nearest that is there. A ray takes 1/f as many
samples, so that each must do the work of f: a becomes 1 - (1 - a)^f, and colour and features grow likewise.
"""

from dataclasses import replace

import numpy as np

from scenepack.constants import PLANES_PER_IMAGE
from scenepack.pack import Pack

FACTORS = (3, 2, 5, 4)  # the first that divides the block size


def order_of_groups(depth: int, padded_block_size: int) -> tuple[list[int], list[int]]:
    """All groups of four planes of an atlas of `depth` planes, each once, and how many of them make a picture each.

    First the middle of every layer, then its quarters, then the rest.
    """
    order, steps = list[int](), list[int]()
    layers = range(0, depth - padded_block_size + 1, padded_block_size)
    for quarters in ((2,), (1, 3)):
        planes = [start + padded_block_size * quarter // 4 for start in layers for quarter in quarters]
        order += sorted({plane // PLANES_PER_IMAGE for plane in planes} - set(order))
        steps.append(len(order))
    return order + [group for group in range(-(-depth // PLANES_PER_IMAGE)) if group not in set(order)], steps


def coarse_pack(pack: Pack, known: np.ndarray) -> Pack | None:
    """`pack` with voxels of f times the side, from those planes of its atlas that are `known` (bool [D]).

    None where its block size allows none. The grid's far faces may lie up to f - 1 voxels farther out.
    """
    if (f := next((f for f in FACTORS if pack.block_size % f == 0 and pack.block_size > f), None)) is None:
        return None
    side = pack.padded_block_size
    kept = np.array([0, *range(1 + f // 2, side - 1, f), side - 1])
    across, down, layers = pack.atlas_blocks
    rows, columns = ((np.arange(count)[:, None] * side + kept).ravel() for count in (down, across))
    planes = np.concatenate([_nearest(known, layer * side, side, kept) for layer in range(layers)] or [[]])

    coarse = [np.zeros((len(planes), len(rows), len(columns), 4), np.uint8) for _ in pack.atlases]
    alpha = np.arange(1, 256) / 255.0
    gains = np.concatenate([[f], (1.0 - (1.0 - alpha) ** f) / alpha]).astype(np.float32)  # by 8-bit opacity
    for i, plane in enumerate(planes.tolist()):  # one by one, so that what is between stays in a processor's caches
        if plane >= 0:
            # four bytes at once
            wholes = [np.ascontiguousarray(atlas[plane]).view(np.uint32) for atlas in pack.atlases]
            taken = [whole[rows[:, None], columns].view(np.uint8) for whole in wholes]
            gain = gains[taken[0][..., 3:]]
            for part, values in zip(coarse, taken, strict=True):
                part[i] = np.rint(np.minimum(values * gain, 255.0))
    x, y, z = (-(-n // f) for n in pack.grid_size)
    return replace(
        pack,
        voxel_size=f * pack.voxel_size,
        grid_size=(x, y, z),
        block_size=pack.block_size // f,
        atlas_rgba=coarse[0],
        atlas_features=coarse[1] if len(coarse) > 1 else None,
    )


def _nearest(known: np.ndarray, start: int, side: int, kept: np.ndarray) -> np.ndarray:
    """For each of the `kept` planes of the layer at `start` the nearest that is known, -1 where none is."""
    there = np.flatnonzero(known[start : start + side])
    if not len(there):
        return np.full(len(kept), -1)
    return start + there[np.abs(there[None] - kept[:, None]).argmin(axis=1)]
