"""What the march asks of a sparse grid, and the parts that every such grid is made of.

Notation: a grid of dims (Dx, Dy, Dz) voxels; voxel i covers [i, i+1) in grid coordinates g and its value sits at its centre,
i + 0.5. Its coarse occupancy has one byte for each COARSE³ voxels, 1 where a sample within COARSE/2 voxels of these could
have support.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

COARSE = 4  # side of a coarse occupancy cell, in voxels


class GridBox(NamedTuple):
    """Where a grid is, and no more."""

    origin: jax.Array  # [3] in world units
    voxel: jax.Array  # [] or [3] in world units
    dims: jax.Array  # int32 [3] = (x, y, z) voxels
    # []: of a contracted grid, half the side of its inner cube in world units (scenepack.contraction); None of others
    contraction: jax.Array | float | None = None


class Cells(NamedTuple):
    """The cells of an occupancy grid. Where it is: see GridBox. occupied: uint8, flat, x fastest, of side³ cells."""

    origin: jax.Array
    voxel: jax.Array
    dims: jax.Array
    occupied: jax.Array
    side: jax.Array
    coarse: jax.Array
    coarse_dims: jax.Array
    contraction: jax.Array | None = None

    def has_support(self, g: jax.Array) -> jax.Array:
        """bool [...]: whether samples are taken at g [..., 3]."""
        cell = jnp.clip(g.astype(jnp.int32), 0, self.side - 1)
        return self.occupied[flat_index(cell, jnp.stack([self.side] * 3))] > 0

    def near_content(self, g: jax.Array) -> jax.Array:
        """bool [...]: False only where no cell within COARSE / 2 of g [..., 3] is on."""
        cell = jnp.clip((g * (1.0 / COARSE)).astype(jnp.int32), 0, self.coarse_dims - 1)
        return self.coarse[flat_index(cell, self.coarse_dims)] > 0


Boxed = GridBox | Cells


def segments_across(dims: tuple[int, ...] | np.ndarray, step: float = 1.0) -> int:
    """How many runs of COARSE steps the longest ray through a grid of dims voxels has. step: in voxels."""
    return int(np.ceil(float(np.linalg.norm(np.asarray(dims, np.float64))) / step / COARSE)) + 1


def flat_index(cell: jax.Array, dims: jax.Array) -> jax.Array:
    """Flat index, x fastest, of integer cells [..., 3] in a box of dims [3]."""
    return (cell[..., 2] * dims[1] + cell[..., 1]) * dims[0] + cell[..., 0]


def trilinear_weights(fraction: jax.Array) -> jax.Array:
    """Weights [N, 8] of the corners (z slowest, x fastest) of a cell at fractions [N, 3] along x, y, z."""
    low_high = jnp.stack([1.0 - fraction, fraction], axis=-1)  # [N, 3, 2]
    weights = low_high[:, 2, :, None, None] * low_high[:, 1, None, :, None] * low_high[:, 0, None, None, :]
    return weights.reshape(-1, 8)


def blend(values: jax.Array, weights: jax.Array) -> jax.Array:
    """Sum over the 8 corners of values [N, 8, C] times weights [N, 8]."""
    return jnp.einsum("nk,nkc->nc", weights, values, precision=jax.lax.Precision.HIGHEST)


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
