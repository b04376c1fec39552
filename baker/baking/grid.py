"""The voxel grid that a field is baked into, and where its voxels lie in the training frame.

Notation: the grid frame is the pack's (OpenGL, y up; docs/format.md); voxel (x, y, z) covers
min_xyz + voxel_size [x, x+1) and so on. A block is a macroblock of block_size³ data voxels. Arrays are [z, y, x].

FloatGrid is the paper's "SNeRG (Float)" (table 3), never written to disk: the macroblocks of a pack, in an atlas of the same
layout, of which only voxels with opacity are held, of 32 bytes each.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil

import numpy as np

from scenepack.blocks import atlas_layout, atlas_shape, choose_atlas_blocks, restore_padding
from scenepack.pack import Pack
from scenepack.placement import transformed

MAX_CELLS = 512  # of culling, along an axis


@dataclass(frozen=True)
class BakeGrid:
    """Where the voxels are, and in which macroblocks."""

    min_xyz: np.ndarray  # float64 [3], grid frame
    voxel_size: float
    blocks: tuple[int, int, int]  # x, y, z
    block_size: int
    worldspace_T_opengl: np.ndarray  # [4, 4]: grid to training frame
    resolution: int  # voxels along the longest side of the box that the blocks cover
    contraction: float | None = None  # half the side of the inner cube of contracted space (scenepack.contraction)

    @property
    def cell(self) -> int:
        """Side in voxels of a cell, the unit of culling: the finest of at least 2 that gives at most MAX_CELLS an axis.

        So culling takes the same memory however fine the grid is.
        """
        sides = [n for n in range(2, self.block_size + 1) if self.block_size % n == 0]
        return next((n for n in sides if max(self.blocks) * self.block_size // n <= MAX_CELLS), self.block_size)

    @property
    def size(self) -> tuple[int, int, int]:
        """Voxels (x, y, z)."""
        x, y, z = (n * self.block_size for n in self.blocks)
        return x, y, z

    def training_points(self, voxels_xyz: np.ndarray) -> np.ndarray:
        """float32 [N, 3] training-frame points of positions [N, 3] in voxels (a voxel's centre is at + 0.5)."""
        rotation = self.worldspace_T_opengl[:3, :3]
        offset = rotation @ self.min_xyz + self.worldspace_T_opengl[:3, 3]
        kind = np.float32 if voxels_xyz.dtype == np.float32 else np.float64
        # not by matmul: BLAS has threads of its own, which wait busily where others work
        moved = np.einsum("ij,kj->ik", voxels_xyz, (self.voxel_size * rotation).astype(kind))
        return (moved + offset.astype(kind)).astype(np.float32, copy=False)


def box_in_grid_frame(aabb: np.ndarray, worldspace_T_opengl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The axis-aligned box (low, high) [3] in the grid frame around a training-frame box [2, 3]."""
    corners = np.stack(np.meshgrid(*np.asarray(aabb, np.float64).T, indexing="ij"), -1).reshape(-1, 3)
    moved = transformed(np.linalg.inv(worldspace_T_opengl), corners)
    return moved.min(0), moved.max(0)


def make_grid(
    low: np.ndarray, high: np.ndarray, resolution: int, block_size: int, worldspace_T_opengl: np.ndarray,
    contraction: float | None = None,
) -> BakeGrid:  # fmt: skip
    """The grid with `resolution` voxels along the longest side of the box, rounded up to whole blocks and centred on it."""
    voxel_size = float((high - low).max()) / resolution
    blocks = [max(ceil((side / voxel_size - 1e-6) / block_size), 1) for side in high - low]
    extent = np.array(blocks) * block_size * voxel_size
    x, y, z = blocks
    return BakeGrid(
        0.5 * (low + high) - 0.5 * extent, voxel_size, (x, y, z), block_size, worldspace_T_opengl, resolution, contraction
    )  # fmt: skip


# --- Before quantisation ----------------------------------------------------------------------------------------------

CHANNELS = 8


@dataclass(frozen=True)
class FloatGrid:
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
    voxels, content float32 [N, 8]. kept: bool [blocks z, y, x], all macroblocks. size: data voxels a side."""
    atlas_blocks = choose_atlas_blocks(int(kept.sum()), size)
    indices = atlas_layout(kept, atlas_blocks)
    rows = np.zeros((*atlas_shape(atlas_blocks, size), 1), np.int32)
    values = [np.zeros((1, CHANNELS), np.float32)]
    count = 1
    for blocks, places, content in parts:
        some = content[:, 3] > 0
        number, flat = np.divmod(places[some], size**3)
        slots = indices[tuple(blocks[number].T)].astype(np.int64)  # x, y, z
        within = np.stack(np.unravel_index(flat, (size,) * 3), -1)
        z, y, x = (within + 1 + slots[:, ::-1] * (size + 2)).T
        rows[z, y, x, 0] = np.arange(count, count + len(flat), dtype=np.int32)
        count += len(flat)
        values.append(content[some])
    restore_padding(rows, indices, size)
    return indices, rows[..., 0], np.concatenate(values)
