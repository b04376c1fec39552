"""The voxels around a macroblock in the atlas: copies of what lies next to it in the grid (SNeRG paper, section 5.1).

Notation: bs = block_size, B = bs + 2 the side of a padded copy; a step is one of the 26 directions (z, y, x), each -1, 0
or 1, in which a neighbour lies; its shell is the part of the padded copy that lies in that neighbour.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from scenepack.constants import EMPTY_BLOCK

COPIED_AT_ONCE = 2048  # macroblocks

Voxels = tuple[np.ndarray, ...]  # index arrays (z, y, x) into an atlas, together [n, …]


@dataclass(frozen=True)
class Shell:
    """One direction's padding of n macroblocks. offsets: along z, y, x, its place in their padded copies. inside: bool [n],
    whose neighbour there is occupied. originals: of these, the voxels that the padding copies.
    """

    step: tuple[int, ...]
    offsets: list[np.ndarray]
    inside: np.ndarray
    originals: Voxels


def shells(atlas_indices: np.ndarray, block_size: int, blocks: np.ndarray) -> Iterator[Shell]:
    """The 26 shells of occupied macroblocks `blocks` int [n, 3] (z, y, x), of a grid laid out by `atlas_indices`."""
    occupied, side = atlas_indices[..., 0] != EMPTY_BLOCK, block_size + 2
    own = {-1: np.array([0]), 0: np.arange(1, side - 1), 1: np.array([side - 1])}
    origin = {-1: np.array([block_size]), 0: np.arange(1, side - 1), 1: np.array([1])}
    for step in product((-1, 0, 1), repeat=3):
        if step == (0, 0, 0):
            continue
        near = blocks + step
        inside = np.all((near >= 0) & (near < occupied.shape), axis=1)
        inside[inside] = occupied[tuple(near[inside].T)]
        originals = _voxels(atlas_indices, near[inside], [origin[s] for s in step], side)
        yield Shell(step, [own[s] for s in step], inside, originals)


def restore_padding(atlas: np.ndarray, atlas_indices: np.ndarray, block_size: int) -> None:
    """Writes every padding voxel of `atlas` [D, H, W, …] anew: the neighbour's data voxel, or zero where the neighbour is
    empty or outside of the grid.
    """
    blocks = np.argwhere(atlas_indices[..., 0] != EMPTY_BLOCK)
    for start in range(0, len(blocks), COPIED_AT_ONCE):
        some = blocks[start : start + COPIED_AT_ONCE]
        for shell in shells(atlas_indices, block_size, some):
            atlas[_voxels(atlas_indices, some[~shell.inside], shell.offsets, block_size + 2)] = 0
            to = _voxels(atlas_indices, some[shell.inside], shell.offsets, block_size + 2)
            atlas[to] = atlas[shell.originals]


def _voxels(indices: np.ndarray, blocks: np.ndarray, offsets: list[np.ndarray], side: int) -> Voxels:
    """The voxels at `offsets` within the copies of grid blocks [n, 3]."""
    x, y, z = (indices[tuple(blocks.T)].astype(np.intp) * side).T
    return (
        (z[:, None] + offsets[0])[:, :, None, None],
        (y[:, None] + offsets[1])[:, None, :, None],
        (x[:, None] + offsets[2])[:, None, None, :],
    )
