"""What the march asks of a sparse grid, and the parts that every such grid is made of.

Notation: a grid of dims (Dx, Dy, Dz) voxels; voxel i covers [i, i+1) in grid coordinates g and its value sits at its centre,
i + 0.5. Its coarse occupancy has one byte for each COARSE³ voxels, 1 where a sample within COARSE/2 voxels of these could
have support. Each cell of 8 voxels also has a code: 0 where none of the 8 is present (no support), else 1 + the optical
depth of one step there, in 1 / DEPTH_UNITS. By these a march can end early, where no light is left.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

COARSE = 4  # side of a coarse occupancy cell, in voxels
DEPTH_UNITS = 16.0  # a cell's optical depth is counted in sixteenths, up to DEEPEST of them
DEEPEST = 254


class Boxed(Protocol):
    """Where a grid is. origin [3], voxel [] or [3] in world units, dims int32 [3] = (x, y, z) voxels. contraction []: of a
    contracted grid, half the side of its inner cube in world units (scenepack.contraction); None of others."""

    @property
    def origin(self) -> jax.Array: ...

    @property
    def voxel(self) -> jax.Array: ...

    @property
    def dims(self) -> jax.Array: ...

    @property
    def contraction(self) -> jax.Array | float | None: ...


class GridBox(NamedTuple):
    """Where a grid is, and no more; see Boxed."""

    origin: jax.Array
    voxel: jax.Array
    dims: jax.Array
    contraction: jax.Array | float | None = None


class Layout(Boxed, Protocol):
    """Where the voxels of a grid are."""

    def near_content(self, g: jax.Array) -> jax.Array:
        """bool [...]: whether anything stored may lie within COARSE/2 voxels of g [..., 3]; False only where none does."""
        ...

    def has_support(self, g: jax.Array) -> jax.Array:
        """bool [...]: whether interpolation at grid coordinates g [..., 3] meets anything stored."""
        ...

    def optical_depth(self, g: jax.Array) -> jax.Array:
        """int32 [...]: the code of the cell at g [..., 3]: 0 without support, else 1 + optical depth of one step."""
        ...


def depth_where(transmittance: float) -> int:
    """The optical depth, in 1 / DEPTH_UNITS, behind which no more than this share of the light arrives."""
    return int(-np.log(transmittance) * DEPTH_UNITS)


def segments_across(dims: tuple[int, ...] | np.ndarray, step: float = 1.0) -> int:
    """How many runs of COARSE steps the longest ray through a grid of dims voxels has. step: in voxels."""
    return int(np.ceil(float(np.linalg.norm(np.asarray(dims, np.float64))) / step / COARSE)) + 1


def flat_index(cell: jax.Array, dims: jax.Array) -> jax.Array:
    """Flat index, x fastest, of integer cells [..., 3] in a box of dims [3]."""
    return (cell[..., 2] * dims[1] + cell[..., 1]) * dims[0] + cell[..., 0]


def coarse_cell(g: jax.Array, coarse_dims: jax.Array) -> jax.Array:
    """Flat index of the coarse occupancy cell of g [..., 3]."""
    return flat_index(jnp.clip((g * (1.0 / COARSE)).astype(jnp.int32), 0, coarse_dims - 1), coarse_dims)


def trilinear_weights(fraction: jax.Array) -> jax.Array:
    """Weights [N, 8] of the corners (z slowest, x fastest) of a cell at fractions [N, 3] along x, y, z."""
    low_high = jnp.stack([1.0 - fraction, fraction], axis=-1)  # [N, 3, 2]
    weights = low_high[:, 2, :, None, None] * low_high[:, 1, None, :, None] * low_high[:, 0, None, None, :]
    return weights.reshape(-1, 8)


def blend(values: jax.Array, weights: jax.Array) -> jax.Array:
    """Sum over the 8 corners of values [N, 8, C] times weights [N, 8]."""
    return jnp.einsum("nk,nkc->nc", weights, values, precision=jax.lax.Precision.HIGHEST)
