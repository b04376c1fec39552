"""Whole pictures of the fast field by the JAX engine, in lists of one fixed length."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from training.marching.batches import until_complete
from training.marching.layout import COARSE, segments_across
from training.marching.march import MarchSizes, march
from training.marching.rays import to_grid
from training.method import Rays, RenderOutput
from training.voxels.field import finished, render_samples
from training.voxels.settings import Settings
from training.voxels.sparse_grid import GridLayout, interpolate
from training.voxels.state import Trainable, VoxelState

RENDER_RAYS, RENDER_SAMPLES = 4096, 131_072


def render_all(state: VoxelState, rays: Rays, settings: Settings) -> RenderOutput:
    """Every ray, sample at start + (1/2 + k) step as the viewer takes them; as many rays a chunk as fit the lists."""
    segments = segments_across(np.asarray(state.layout.dims), settings.step_voxels)
    sizes = MarchSizes(segments, RENDER_SAMPLES, RENDER_SAMPLES, segments * COARSE)
    host = [np.asarray(array) for array in rays]

    def render_some(places: np.ndarray) -> tuple[RenderOutput, jax.Array]:
        some = Rays(*(jnp.asarray(array[places]) for array in host))
        return _render_chunk(state.trainable, state.layout, some, sizes, settings)

    parts = [
        [array[: end - start] for array in output]
        for start, end, output in until_complete(len(host[0]), RENDER_RAYS, render_some)
    ]
    return RenderOutput(*(jnp.concatenate(arrays) for arrays in zip(*parts, strict=True)))


@partial(jax.jit, static_argnames=("sizes", "settings"))
def _render_chunk(
    trainable: Trainable, layout: GridLayout, rays: Rays, sizes: MarchSizes, settings: Settings
) -> tuple[RenderOutput, jax.Array]:
    grid_rays = to_grid(layout, rays)
    samples = march(layout, grid_rays, jnp.full(rays.near.shape[0], 0.5), sizes, settings.step_voxels)
    raw = interpolate(trainable.rows, layout, samples.g)
    output, _, _ = render_samples(raw, trainable.head, samples, grid_rays.length, rays.viewdirs, sizes, settings)
    return finished(output, grid_rays.scale), samples.complete
