"""A sparse voxel grid: only occupied voxels own a row.

Notation: see training.marching.layout. Voxels may be deeper than wide (NDC scenes: depth there is disparity, which cameras side
by side tell less finely than directions). `lookup` maps a voxel, padded by one on every side, to its row: flat int32, x fastest;
row 0 stands for every absent voxel.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from training.marching.layout import COARSE, DEEPEST, DEPTH_UNITS, coarse_cell, flat_index
from training.memory import aligned


class GridLayout(NamedTuple):
    """Where voxels are: a training.marching.layout.Layout."""

    origin: jax.Array  # [3], world units
    voxel: jax.Array  # [3], world units
    dims: jax.Array  # int32 [3] = (Dx, Dy, Dz)
    lookup: jax.Array  # int32 [(Dz+2)(Dy+2)(Dx+2)]: row of each padded voxel, 0 = absent
    support: jax.Array  # uint8, same size: the code of each cell
    coarse: jax.Array  # uint8 [Cz*Cy*Cx]: coarse occupancy
    coarse_dims: jax.Array  # int32 [3]
    contraction: jax.Array | None = None

    def has_support(self, g: jax.Array) -> jax.Array:
        return self.optical_depth(g) > 0

    def optical_depth(self, g: jax.Array) -> jax.Array:
        lowest = jnp.clip(jnp.floor(g - 0.5).astype(jnp.int32) + 1, 0, self.dims)  # of the 8 voxels around g
        return self.support[flat_index(lowest, self.dims + 2)].astype(jnp.int32)

    def near_content(self, g: jax.Array) -> jax.Array:
        return self.coarse[coarse_cell(g, self.coarse_dims)] > 0

    def nearest(self, g: jax.Array) -> jax.Array:
        """Row int32 [N] of the voxel that each of the points g [N, 3] lies in; 0 where it is absent."""
        cell = jnp.clip(jnp.floor(g).astype(jnp.int32) + 1, 0, self.dims + 1)
        return self.lookup[flat_index(cell, self.dims + 2)]


def build_layout(
    present: np.ndarray, origin: np.ndarray, voxel: np.ndarray | float, contraction: float | None = None
) -> GridLayout:  # fmt: skip
    """The layout of the voxels marked in `present` bool [Dz, Dy, Dx]; rows are numbered from 1 in z, y, x order.

    voxel: sides (x, y, z), or one side for all.
    """
    depth, height, width = present.shape
    padded = aligned((depth + 2, height + 2, width + 2), np.int32)
    padded[1:-1, 1:-1, 1:-1][present] = np.arange(1, np.count_nonzero(present) + 1, dtype=np.int32)
    support = cell_support(present)
    coarse = coarse_occupancy(support, present.shape)
    return GridLayout(
        origin=jnp.asarray(origin, jnp.float32),
        voxel=jnp.asarray(np.broadcast_to(voxel, 3), jnp.float32),
        dims=jnp.asarray([width, height, depth], jnp.int32),
        lookup=jnp.asarray(padded.ravel()),
        support=jnp.asarray(support.ravel()),
        coarse=jnp.asarray(coarse.ravel()),
        coarse_dims=jnp.asarray(coarse.shape[::-1], jnp.int32),
        contraction=None if contraction is None else jnp.float32(contraction),
    )


def cell_support(present: np.ndarray) -> np.ndarray:
    """uint8 [Dz + 2, Dy + 2, Dx + 2]: 1 in the padded cells that a voxel of `present` [Dz, Dy, Dx] helps to interpolate."""
    support = aligned(tuple(n + 2 for n in present.shape), np.uint8)
    support[1:-1, 1:-1, 1:-1] = present
    for axis in range(3):  # cell c is interpolated from voxels c and c + 1 along each axis
        here, ahead = [slice(None)] * 3, [slice(None)] * 3
        here[axis], ahead[axis] = slice(None, -1), slice(1, None)
        support[tuple(here)] |= support[tuple(ahead)]
    return support


def cell_means(layout: GridLayout, values: jax.Array) -> jax.Array:
    """float32, one for each padded cell: the mean of values [V + 1] over the 8 voxels that interpolate the cell's points."""
    x, y = layout.dims[0] + 2, layout.dims[1] + 2
    total = values[layout.lookup]
    for ahead in (1, x, x * y):  # along x, y, z; what wraps round comes from the padding, where nothing is
        total = total + jnp.roll(total, -ahead)
    return total * 0.125


def with_depths(layout: GridLayout, tau: jax.Array) -> GridLayout:
    """The layout that remembers the optical depth tau of one step in every padded cell; `march` may stop by these."""
    code = 1 + jnp.clip(tau * DEPTH_UNITS, 0, DEEPEST).astype(jnp.uint8)
    return layout._replace(support=jnp.where(layout.support > 0, code, 0).astype(jnp.uint8))


def coarse_occupancy(support: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """uint8 [Cz, Cy, Cx]: cell c answers for samples at g in [4c - 2, 4c + 6), whose padded cells are 4c - 2 ... 4c + 6."""
    coarse = support
    for axis in range(3):
        count = -(-shape[axis] // COARSE)
        wide = np.pad(coarse, [(COARSE, 3 * COARSE) if other == axis else (0, 0) for other in range(3)])
        coarse = np.zeros(1, np.uint8)
        for first in range(COARSE // 2, 2 * COARSE + COARSE // 2 + 1):
            some = (slice(None),) * axis + (slice(first, first + COARSE * (count - 1) + 1, COARSE),)
            coarse = np.maximum(coarse, wide[some])
    return coarse


def dilate(volume: np.ndarray) -> np.ndarray:
    """bool volume grown by one voxel along every axis and diagonal."""
    for axis in range(3):
        grown = volume.copy()
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        grown[tuple(ahead)] |= volume[tuple(behind)]
        grown[tuple(behind)] |= volume[tuple(ahead)]
        volume = grown
    return volume
