"""What the photographs say of a state's voxels, and what lies at points between these: the JAX engine's part of pruning and
refining."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from training.dataset import RayDataset
from training.devices import agree
from training.marching.march import MarchSizes, march
from training.marching.rays import to_grid
from training.method import Rays
from training.voxels.field import render_samples
from training.voxels.settings import Settings
from training.voxels.sparse_grid import CHANNELS, GridLayout, interpolate
from training.voxels.state import Trainable, VoxelState

QUERY_POINTS = 131_072


def raw_at(state: VoxelState, points: np.ndarray) -> np.ndarray:
    """Raw values float32 [N, 8] of a state at world points [N, 3]."""
    raw = np.empty((len(points), CHANNELS), np.float32)
    for start in range(0, len(points), QUERY_POINTS):
        some = points[start : start + QUERY_POINTS]
        padded = np.zeros((QUERY_POINTS, 3), np.float32)
        padded[: len(some)] = some
        raw[start : start + QUERY_POINTS] = _raw_at(state.trainable.rows, state.layout, jnp.asarray(padded))[
            : len(some)
        ]
    return agree(raw)


@jax.jit
def _raw_at(rows: jax.Array, layout: GridLayout, points: jax.Array) -> jax.Array:
    return interpolate(rows, layout, (points - layout.origin) / layout.voxel)


@partial(jax.jit, static_argnames=("sizes", "settings"))
def _nearest_weights(
    trainable: Trainable, layout: GridLayout, best: jax.Array, rays: Rays, sizes: MarchSizes, settings: Settings
) -> jax.Array:
    """Raises best [V + 1] to the weights that rays [N] give to the voxels that their samples lie in."""
    count = rays.near.shape[0]
    grid_rays = to_grid(layout, rays)
    samples = march(layout, grid_rays, jnp.full(count, 0.5), sizes, settings.step_voxels, settings.last_depth)
    raw = interpolate(trainable.rows, layout, samples.g)
    _, _, weights = render_samples(raw, trainable.head, samples, grid_rays.length, rays.viewdirs, sizes, settings)
    return best.at[layout.nearest(samples.g)].max(weights)


def visible_weights(state: VoxelState, geometry: RayDataset, ids: np.ndarray, settings: Settings) -> np.ndarray:
    """float32 [V + 1]: the largest share that each voxel has of what any of the training rays int [N] shows."""
    best = jnp.zeros(state.trainable.rows.shape[0])
    for start in range(0, len(ids), state.rays):
        part = np.resize(ids[start : start + state.rays], state.rays)
        rays = geometry.geometry_at(jnp.asarray(part))
        best = _nearest_weights(state.trainable, state.layout, best, rays, state.sizes, settings)
    return agree(np.asarray(best))  # processes that differ in the last bit would keep different voxels
