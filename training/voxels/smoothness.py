"""What keeps a voxel grid from explaining photographs by mist: total variation and the distortion loss.

A few dozen photographs do not pin down every voxel; without these, specks float before the cameras that were there and
spoil every other view. Total variation as in Plenoxels (Fridovich-Keil et al. 2022); distortion, which draws what a ray
meets together into one surface, from mip-NeRF 360 (Barron et al. 2022), by running sums as in DVGO v2 (Sun et al. 2022).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from training.marching.march import Samples
from training.voxels.sparse_grid import GridLayout

WINDOW = 64  # voxels in a row whose variation is looked at together: neighbours in memory, mostly, as in space


def windows(key: jax.Array, voxels: int, share: float) -> jax.Array:
    """int32 [P] rows of random runs of voxels, about `share` of all `voxels` (numbered from 1)."""
    count = max(int(voxels * share / WINDOW), 1)
    starts = jax.random.randint(key, (count, 1), 0, voxels)
    return (1 + (starts + jnp.arange(WINDOW)) % voxels).ravel()


def neighbourhood(layout: GridLayout, cells: jax.Array, picked: jax.Array) -> jax.Array:
    """Rows int32 [P, 4] of the picked voxels and of their neighbours along +x, +y, +z (0 where absent)."""
    width, height = layout.dims[0] + 2, layout.dims[1] + 2
    ahead = jnp.stack([jnp.zeros_like(width), jnp.ones_like(width), width, width * height])
    return layout.lookup[cells[picked][:, None] + ahead]


def variation(values: jax.Array, ids: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Total variation of raw density and of raw colours in neighbourhoods [P, 4, 8] of rows ids [P, 4]: mean norms."""
    change = jnp.square(values[:, 1:] - values[:, :1]) * (ids[:, 1:] > 0)[..., None]
    norms = jnp.sqrt(change.sum(1) + 1e-6)
    return norms[:, 0].mean(), norms[:, 1:].sum(-1).mean()


def distortion(
    samples: Samples, weights: jax.Array, step: float, spread: jax.Array | float, rays: int, per_ray: int
) -> jax.Array:
    """Sum over rays of sum_kl w_k w_l |t_k - t_l| / spread + sum_k w_k^2 step / (3 spread); weights [S].

    step: distance between samples; spread: the length that counts as 1; both in voxels, as the samples' t.
    """
    slot = jnp.where(samples.valid, samples.ray * per_ray + samples.rank, rays * per_ray)

    def before(values: jax.Array) -> jax.Array:
        grid = jnp.zeros(rays * per_ray, values.dtype).at[slot].set(values, mode="drop").reshape(rays, per_ray)
        return jnp.cumsum(grid, axis=1).ravel().at[slot].get(mode="fill", fill_value=0.0) - values

    t = samples.t / spread
    pairs = 2.0 * weights * (t * before(weights) - before(weights * t))
    return jnp.where(samples.valid, pairs + jnp.square(weights) * step / (3.0 * spread), 0.0).sum()
