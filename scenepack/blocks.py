"""Cutting a volume into padded macroblocks, and putting it back together (SNeRG paper, section 5.1).

Notation: bs = block_size, data voxels per macroblock side; B = bs + 2, the side of its copy in the atlas. Volumes are [z, y, x,
c]; sizes and block counts written as triples are (x, y, z), as in Pack. A macroblock's data voxel (i, j, k) lies in the atlas at
B·slot + 1 + (i, j, k). The voxels around it copy the neighbours' data voxels in the grid, or are zeros where a neighbour is
empty or outside of the grid, so that a trilinear fetch within the macroblock never leaves its padded copy. Slots are handed out
x fastest, then y, then z, both in the grid and in the atlas. A step is one of the 26 directions (z, y, x), each -1, 0 or 1, in
which a neighbour lies; its shell is the part of the padded copy that lies in that neighbour.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import ceil, sqrt

import numpy as np

from scenepack.constants import EMPTY_BLOCK, MAX_BLOCK_INDEX, PLANES_PER_IMAGE
from scenepack.pack import Pack

COPIED_AT_ONCE = 2048  # macroblocks

STEPS = [step for step in product((-1, 0, 1), repeat=3) if any(step)]
# Along an axis, what lies a step away: of a padded copy, and of that neighbour's own data.
PADDING = {-1: slice(0, 1), 0: slice(1, -1), 1: slice(-1, None)}
COPIED = {-1: slice(-1, None), 0: slice(None), 1: slice(0, 1)}

Voxels = tuple[np.ndarray, ...]  # index arrays (z, y, x) into an atlas, together [n, …]


def along(slices: Mapping[int, slice], step: Sequence[int]) -> tuple[slice, ...]:
    """PADDING or COPIED along all three axes."""
    return tuple(slices[s] for s in step)


@dataclass(frozen=True)
class Shell:
    """One direction's padding of n macroblocks."""

    step: tuple[int, ...]
    offsets: list[np.ndarray]  # along z, y, x: its place in their padded copies
    inside: np.ndarray  # bool [n]: whose neighbour there is occupied
    originals: Voxels  # of these, the voxels that the padding copies


def shells(atlas_indices: np.ndarray, block_size: int, blocks: np.ndarray) -> Iterator[Shell]:
    """The 26 shells of occupied macroblocks `blocks` int [n, 3] (z, y, x), of a grid laid out by `atlas_indices`."""
    occupied, side = atlas_indices[..., 0] != EMPTY_BLOCK, block_size + 2
    every = np.arange(side)
    for step in STEPS:
        near = blocks + step
        inside = np.all((near >= 0) & (near < occupied.shape), axis=1)
        inside[inside] = occupied[tuple(near[inside].T)]
        origin = [every[1:-1][copied] for copied in along(COPIED, step)]
        originals = voxels_at(atlas_indices, near[inside], origin, side)
        yield Shell(step, [every[padding] for padding in along(PADDING, step)], inside, originals)


def restore_padding(atlas: np.ndarray, atlas_indices: np.ndarray, block_size: int) -> None:
    """Writes every padding voxel of `atlas` [D, H, W, …] anew: the neighbour's data voxel, or zero where the neighbour is
    empty or outside of the grid."""
    blocks = np.argwhere(atlas_indices[..., 0] != EMPTY_BLOCK)
    for start in range(0, len(blocks), COPIED_AT_ONCE):
        some = blocks[start : start + COPIED_AT_ONCE]
        for shell in shells(atlas_indices, block_size, some):
            atlas[voxels_at(atlas_indices, some[~shell.inside], shell.offsets, block_size + 2)] = 0
            to = voxels_at(atlas_indices, some[shell.inside], shell.offsets, block_size + 2)
            atlas[to] = atlas[shell.originals]


def restore_pack_padding(pack: Pack) -> None:
    """Writes the padding of a pack's atlases anew, in place."""
    for atlas in pack.atlases:
        restore_padding(atlas, pack.atlas_indices, pack.block_size)


def voxels_at(indices: np.ndarray, blocks: np.ndarray, offsets: list[np.ndarray], side: int) -> Voxels:
    """The voxels at `offsets` within the copies of grid blocks [n, 3]."""
    x, y, z = (indices[tuple(blocks.T)].astype(np.intp) * side).T
    return (
        (z[:, None] + offsets[0])[:, :, None, None],
        (y[:, None] + offsets[1])[:, None, :, None],
        (x[:, None] + offsets[2])[:, None, None, :],
    )


MAX_SLICE_SIDE = 2048  # voxels; every OpenGL 3.3 driver in use takes 3D textures of this side

Triple = tuple[int, int, int]
Macroblocks = Iterable[tuple[tuple[int, ...], np.ndarray]]  # place (z, y, x), and data voxels, uint8 [bs, bs, bs, c]


def grid_block_counts(grid_size: Triple, block_size: int) -> Triple:
    """Macroblocks (x, y, z) that cover a grid of `grid_size` voxels (x, y, z)."""
    x, y, z = (-(-side // block_size) for side in grid_size)
    return x, y, z


def choose_atlas_blocks(count: int, block_size: int) -> Triple:
    """The atlas layout (x, y, z), in macroblocks, that holds `count` of them.

    As few layers along z as slices of MAX_SLICE_SIDE² voxels allow, then the squarest slice; never more than 255 along an axis,
    for a byte must hold the index and 255 means empty. ValueError where no layout is large enough.
    """
    side = min(MAX_SLICE_SIDE // (block_size + 2), MAX_BLOCK_INDEX + 1)
    count = max(count, 1)
    layers = ceil(count / side**2)
    if layers > MAX_BLOCK_INDEX + 1:
        raise ValueError(f"{count} macroblocks of {block_size} voxels do not fit in an atlas")
    per_layer = ceil(count / layers)
    across = min(side, ceil(sqrt(per_layer)))
    return across, ceil(per_layer / across), layers


def atlas_shape(atlas_blocks: Triple, block_size: int) -> Triple:
    """The atlas array's (depth, height, width) in voxels; depth is a multiple of four (whole images)."""
    x, y, z = (blocks * (block_size + 2) for blocks in atlas_blocks)
    return -(-z // PLANES_PER_IMAGE) * PLANES_PER_IMAGE, y, x


def atlas_layout(occupied: np.ndarray, atlas_blocks: Triple) -> np.ndarray:
    """atlas_indices uint8 [blocks z, y, x, 3] that hand slots to the macroblocks of `occupied`, in the grid's order."""
    across, down, _ = atlas_blocks
    indices = np.full((*occupied.shape, 3), EMPTY_BLOCK, np.uint8)
    slots = np.arange(np.count_nonzero(occupied))
    indices[occupied] = np.stack([slots % across, slots // across % down, slots // (across * down)], -1)
    return indices


def fill_atlas(
    blocks: Macroblocks, kept: np.ndarray, block_size: int, channels: int = 8
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """atlas_indices, atlas_rgba and atlas_features, as Pack has them.

    kept: bool [blocks z, y, x], all places. channels: c, 8, or 4 without features. Only data voxels are written: restore_padding
    does the rest. ValueError where no layout is large enough.
    """
    atlas_blocks = choose_atlas_blocks(int(kept.sum()), block_size)
    indices, shape = atlas_layout(kept, atlas_blocks), (*atlas_shape(atlas_blocks, block_size), 4)
    rgba, features = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8) if channels == 8 else None
    side = block_size + 2
    for place, voxels in blocks:
        at = tuple(slice(i * side + 1, (i + 1) * side - 1) for i in indices[place].tolist()[::-1])
        rgba[at] = voxels[..., :4]
        if features is not None:
            features[at] = voxels[..., 4:]
    return indices, rgba, features


def with_macroblocks(pack: Pack, blocks: Macroblocks, kept: np.ndarray) -> Pack:
    """`pack` with the macroblocks that fill_atlas is given instead of its own, and their padding."""
    indices, rgba, features = fill_atlas(blocks, kept, pack.block_size, 4 * len(pack.atlases))
    filled = replace(pack, atlas_indices=indices, atlas_rgba=rgba, atlas_features=features)
    restore_pack_padding(filled)
    return filled


def block_copy(pack: Pack, atlas: np.ndarray, block_zyx: tuple[int, ...]) -> np.ndarray:
    """The padded copy [B, B, B, c] (a view into `atlas`) of an occupied macroblock of the grid."""
    side = pack.padded_block_size
    sx, sy, sz = (int(i) * side for i in pack.atlas_indices[block_zyx])
    return atlas[sz : sz + side, sy : sy + side, sx : sx + side]


def block_data(pack: Pack, atlas: np.ndarray, block_zyx: tuple[int, ...]) -> np.ndarray:
    """The data voxels [bs, bs, bs, c] (a view into `atlas`) of an occupied macroblock of the grid."""
    return block_copy(pack, atlas, block_zyx)[1:-1, 1:-1, 1:-1]


def dense_from_pack(pack: Pack, box: tuple[Triple, Triple] | None = None) -> tuple[np.ndarray, np.ndarray | None]:
    """The grid's voxels as full arrays: rgba uint8 [z, y, x, 4], premultiplied, and features or None.

    box: ((x0, y0, z0), (x1, y1, z1)) in voxels; by default all of the grid.
    Empty macroblocks are zeros, and so is what lies beyond the grid.
    """
    low, high = (np.array(corner)[::-1] for corner in box or ((0, 0, 0), pack.grid_size))  # z, y, x
    shape, size = (high - low).tolist(), pack.block_size
    dense = [np.zeros((*shape, 4), np.uint8) for _ in pack.atlases]
    first = low // size
    end = np.minimum(high, pack.grid_size[::-1])
    for block in np.argwhere(pack.occupied[tuple(map(slice, first, -(-high // size)))]) + first:
        start, stop = np.maximum(block * size, low), np.minimum((block + 1) * size, end)
        to, of = (tuple(map(slice, start - corner, stop - corner)) for corner in (low, block * size))
        for part, atlas in zip(dense, pack.atlases, strict=True):
            part[to] = block_data(pack, atlas, tuple(block))[of]
    return dense[0], dense[1] if len(dense) > 1 else None
