"""Which rays a stage draws from, and how long the lists of its steps are, so that nothing is looked at for nothing."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from training.dataset import RayDataset
from training.devices import agree
from training.marching.batches import rays_that_meet
from training.marching.layout import COARSE, segments_across
from training.marching.march import MarchSizes, occupied_segments
from training.marching.rays import GridRays, to_grid
from training.voxels.settings import Plan, Settings
from training.voxels.sparse_grid import GridLayout
from training.voxels.state import ray_ids

PROBE_RAYS = 4096  # rays whose sample counts set the list sizes
HEADROOM = 1.15  # lists are this much longer than the mean asks for


def rays_with_content(geometry: RayDataset, layout: GridLayout, ids: np.ndarray, step_voxels: float) -> np.ndarray:
    """bool [N]: which of the rays int [N] may meet content."""
    segments = segments_across(np.asarray(layout.dims), step_voxels)
    return agree(rays_that_meet(layout, geometry, ids, segments, phase=0.0, step=step_voxels))


def fitting_sizes(
    geometry: RayDataset, layout: GridLayout, to_draw: tuple[jax.Array, int], plan: Plan, settings: Settings
) -> tuple[MarchSizes, int]:
    """List sizes and rays a step such that the sample list is just filled, from the counts of some probe rays.

    to_draw: hits and hit_count of the stage.
    """
    step = settings.step_voxels
    hits, hit_count = to_draw
    probe = jnp.asarray(np.random.default_rng(0).integers(0, hit_count, PROBE_RAYS))
    segments = segments_across(np.asarray(layout.dims), step)
    rays = to_grid(layout, geometry.geometry_at(ray_ids(hits, probe)))
    coarse, fine = (agree(np.asarray(a)) for a in _count(layout, rays, segments, step, settings.last_depth))
    per_ray = int(fine.max() * HEADROOM) + 8
    count = int(np.clip(plan.samples / max(fine.mean(), 1.0), 256, plan.most_rays))
    count = -(-count // 256) * 256
    return MarchSizes(segments, int(count * (coarse.mean() * HEADROOM + 1)), plan.samples, per_ray), count


@partial(jax.jit, static_argnames=("segments", "step", "last_depth"))
def _count(
    layout: GridLayout, rays: GridRays, segments: int, step: float, last_depth: int
) -> tuple[jax.Array, jax.Array]:
    """Coarse segments and samples before early termination, both [N], of each ray."""
    coarse = occupied_segments(layout, rays, jnp.zeros_like(rays.start), segments, step).sum(-1)

    def add(k, carry):
        total, deep = carry
        t = rays.start + k * step
        depth = jnp.where(t < rays.end, layout.optical_depth(rays.origins + t[:, None] * rays.directions), 0)
        return total + ((depth > 0) & (deep < last_depth)), deep + jnp.maximum(depth - 1, 0)

    nothing = jnp.zeros_like(coarse)
    return coarse, jax.lax.fori_loop(0, segments * COARSE, add, (nothing, nothing))[0]
