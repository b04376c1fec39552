"""The voxel grid that a field is baked into, and where its voxels lie in the training frame.

Notation: the grid frame is the pack's (OpenGL, y up; docs/format.md); voxel (x, y, z) covers
min_xyz + voxel_size [x, x+1) and so on. A block is a macroblock of block_size³ data voxels. Arrays are [z, y, x].
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from console import UserError
from scenepack.constants import MAX_BLOCK_INDEX

MAX_CELLS = 512  # of culling, along an axis


@dataclass(frozen=True)
class BakeGrid:
    """min_xyz float64 [3], voxel_size: grid frame. blocks (x, y, z). worldspace_T_opengl [4, 4]: grid to training frame.

    resolution: voxels along the longest side of the box that the blocks cover. contraction: half the side of the inner cube,
    where space is contracted (scenepack.contraction); None where it is not.
    """

    min_xyz: np.ndarray
    voxel_size: float
    blocks: tuple[int, int, int]
    block_size: int
    worldspace_T_opengl: np.ndarray
    resolution: int
    contraction: float | None = None

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
        moved = voxels_xyz @ (self.voxel_size * rotation.T).astype(kind)
        return (moved + offset.astype(kind)).astype(np.float32, copy=False)


def to_training(worldspace_T_opengl: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Grid-frame points [N, 3] in the training frame, float32."""
    return (points @ worldspace_T_opengl[:3, :3].T + worldspace_T_opengl[:3, 3]).astype(np.float32)


def box_in_grid_frame(aabb: np.ndarray, worldspace_T_opengl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The axis-aligned box (low, high) [3] in the grid frame around a training-frame box [2, 3]."""
    corners = np.stack(np.meshgrid(*np.asarray(aabb, np.float64).T, indexing="ij"), -1).reshape(-1, 3)
    grid_T_world = np.linalg.inv(worldspace_T_opengl)
    moved = corners @ grid_T_world[:3, :3].T + grid_T_world[:3, 3]
    return moved.min(0), moved.max(0)


def make_grid(
    low: np.ndarray, high: np.ndarray, resolution: int, block_size: int, worldspace_T_opengl: np.ndarray,
    contraction: float | None = None,
) -> BakeGrid:  # fmt: skip
    """The grid with `resolution` voxels along the longest side of the box, rounded up to whole blocks and centred on it.

    UserError where more than 254 blocks would lie along an axis.
    """
    voxel_size = float((high - low).max()) / resolution
    blocks = [max(ceil((side / voxel_size - 1e-6) / block_size), 1) for side in high - low]
    if max(blocks) > MAX_BLOCK_INDEX:
        limit = MAX_BLOCK_INDEX * block_size
        raise UserError(
            "the grid has too many macroblocks along one axis", where="--resolution", expected=f"at most {limit}",
            found=resolution, remedy="bake at a lower resolution",
        )  # fmt: skip
    extent = np.array(blocks) * block_size * voxel_size
    x, y, z = blocks
    return BakeGrid(
        0.5 * (low + high) - 0.5 * extent, voxel_size, (x, y, z), block_size, worldspace_T_opengl, resolution, contraction
    )  # fmt: skip
