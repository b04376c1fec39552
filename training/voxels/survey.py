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
def _weigh(
    trainable: Trainable, layout: GridLayout, best: jax.Array, total: jax.Array, rays: Rays, counted: jax.Array,
    sizes: MarchSizes, settings: Settings,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """Raises best [V + 1] to the weights that rays [N] give to the voxels that their samples lie in, and adds these to total."""
    count = rays.near.shape[0]
    grid_rays = to_grid(layout, rays)
    samples = march(layout, grid_rays, jnp.full(count, 0.5), sizes, settings.step_voxels, settings.last_depth)
    raw = interpolate(trainable.rows, layout, samples.g)
    _, _, weights = render_samples(raw, trainable.head, samples, grid_rays.length, rays.viewdirs, sizes, settings)
    nearest, weights = layout.nearest(samples.g), weights * counted[samples.ray]
    return best.at[nearest].max(weights), total.at[nearest].add(weights)


def visible_weights(
    state: VoxelState, geometry: RayDataset, ids: np.ndarray, settings: Settings
) -> tuple[np.ndarray, np.ndarray]:
    """See training.voxels.engine.Engine.visible_weights."""
    best, total = jnp.zeros(state.trainable.rows.shape[0]), jnp.zeros(state.trainable.rows.shape[0])
    assert state.sizes is not None
    for start in range(0, len(ids), state.rays):
        part = ids[start : start + state.rays]
        rays = geometry.geometry_at(jnp.asarray(np.resize(part, state.rays)))
        counted = jnp.arange(state.rays) < len(part)
        best, total = _weigh(state.trainable, state.layout, best, total, rays, counted, state.sizes, settings)
    return agree((np.asarray(best), np.asarray(total)))  # processes that differ in the last bit would keep other voxels
