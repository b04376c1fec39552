"""Grids of the fused loops: bricks with a place in the world, made of a layout or of the voxels that are present, and back.

Notation: V voxels; `order` int32 [V + 1] is the row of the layout that each of ours is, which follow a Morton curve.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from training.arrays import aligned
from training.voxels.fused.bricks import Bricks, build_bricks, support_of
from training.voxels.sparse_grid import GridLayout, Occupancy, cell_support, coarse_occupancy


class Grid(NamedTuple):
    """Where the voxels are: bricks, order; origin, voxel [3] world units, float64."""

    bricks: Bricks
    order: np.ndarray
    origin: np.ndarray
    voxel: np.ndarray


def grid_of(cells: ArrayLike, support: ArrayLike, dims: ArrayLike, origin: ArrayLike, voxel: ArrayLike) -> Grid:
    """The grid of a layout, from its arrays: cells [V + 1] padded flat index of each row, the first for row 0."""
    bricks, order = build_bricks(np.asarray(cells)[1:], np.asarray(support), np.asarray(dims))
    return Grid(bricks, order, np.asarray(origin, np.float64), np.asarray(voxel, np.float64))


def grid_over(occupancy: Occupancy) -> Grid:
    """The grid of these voxels, as the layout that they have in a checkpoint would make it: in float32 of origin and voxel."""
    present, origin, voxel = occupancy
    cells = np.concatenate([[0], np.flatnonzero(np.pad(present, 1))]).astype(np.int32)
    place = (np.asarray(a, np.float32) for a in (origin, np.broadcast_to(voxel, 3)))
    return grid_of(cells, cell_support(present).ravel(), present.shape[::-1], *place)


def layout_of(grid: Grid, dense: bool = True) -> tuple[GridLayout, jax.Array]:
    """The layout of a grid, with the depths that its bricks remember, and the padded cell int32 [V + 1] of each of its rows.

    dense: with lookup and coarse occupancy; these are empty otherwise.
    """
    dims = grid.bricks.dims.astype(np.int64)
    x, y, z = grid.bricks.coordinates.astype(np.int32).T
    cells = aligned((len(grid.order),), np.int32)
    cells[grid.order] = (z * np.int32(dims[1] + 2) + y) * np.int32(dims[0] + 2) + x
    support = support_of(grid.bricks)
    lookup, coarse = np.zeros(0, np.int32), np.zeros((0, 0, 0), np.uint8)
    if dense:
        lookup = aligned((support.size,), np.int32)
        lookup[cells[1:]] = np.arange(1, len(cells))
        coarse = coarse_occupancy((support > 0).astype(np.uint8).reshape(dims[::-1] + 2), tuple(dims[::-1]))
    layout = GridLayout(
        origin=jnp.asarray(grid.origin, jnp.float32), voxel=jnp.asarray(grid.voxel, jnp.float32),
        dims=jnp.asarray(dims, jnp.int32), lookup=jnp.asarray(lookup), support=jnp.asarray(support),
        coarse=jnp.asarray(coarse.ravel()), coarse_dims=jnp.asarray(coarse.shape[::-1], jnp.int32),
    )  # fmt: skip
    return layout, jnp.asarray(cells)
