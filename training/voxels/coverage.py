"""How many training photographs see each part of the scene's box.

What a single photograph sees, anything can explain: specks right before its lens reproduce it and spoil every other
view. Voxels that few photographs see are therefore left out from the start (DVGO, Sun et al. 2022, section 4.1, slows their
learning down by the same count).

Notation: V views; a coverage grid of side cells lies over the voxels' dims (x, y, z), cell (i, j, k) covers the share
[i, i+1) / side of each axis. Rays are marched in straight steps, so that lenses and the NDC warp need nothing of their own.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from training.dataset import RayDataset
from training.marching.rays import to_grid
from training.voxels.sparse_grid import GridLayout

SIDE = 48  # cells of the coverage grid along each axis
LATTICE = 96  # rays a view along each side of its picture: more than one a cell
STEPS_PER_CELL = 1.5


@partial(jax.jit, static_argnames="steps")
def _seen_by(dataset: RayDataset, layout: GridLayout, view: jax.Array, size: jax.Array, steps: int) -> jax.Array:
    """bool [SIDE^3]: the cells that rays of a view meet. size int32 [2]: width and height of its picture."""
    at = (jnp.arange(LATTICE) + 0.5) / LATTICE
    y, x = jnp.meshgrid(at * size[1] - 0.5, at * size[0] - 0.5, indexing="ij")
    rays = to_grid(layout, dataset.rays(jnp.full(LATTICE * LATTICE, view), x.ravel(), y.ravel()))
    share = (jnp.arange(steps) + 0.5) / steps
    inside = rays.end > rays.start
    t = rays.start[:, None] + share * jnp.maximum(rays.end - rays.start, 0.0)[:, None]
    g = rays.origins[:, None] + t[..., None] * rays.directions[:, None]
    cell = jnp.clip((g / layout.dims * SIDE).astype(jnp.int32), 0, SIDE - 1)
    flat = (cell[..., 2] * SIDE + cell[..., 1]) * SIDE + cell[..., 0]
    return jnp.zeros(SIDE**3, bool).at[jnp.where(inside[:, None], flat, SIDE**3)].set(True, mode="drop")


def views_that_see(dataset: RayDataset, layout: GridLayout) -> np.ndarray:
    """int [Dz, Dy, Dx]: how many training views see each voxel of the layout's box, by its cell of the coverage grid."""
    width, first = np.asarray(dataset.width), np.asarray(dataset.first)
    height = np.diff(np.append(first, dataset.count)) // width * dataset.facts.row_step
    steps = int(SIDE * 3**0.5 * STEPS_PER_CELL)
    counts = np.zeros(SIDE**3, np.int32)
    for view in range(dataset.views):
        size = jnp.asarray([width[view], height[view]], jnp.float32)
        counts += np.asarray(_seen_by(dataset, layout, jnp.int32(view), size, steps))
    x, y, z = (((np.arange(n) + 0.5) / n * SIDE).astype(int) for n in np.asarray(layout.dims))
    return counts.reshape(SIDE, SIDE, SIDE)[np.ix_(z, y, x)]
