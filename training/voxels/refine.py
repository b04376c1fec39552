"""What happens to voxels between steps: the dense start, pruning by visible weight, refining.

Pruning by the largest weight that a voxel has in any training pixel is Plenoxels' (Fridovich-Keil et al. 2022). On the host,
in NumPy, with short jitted helpers.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from training.dataset import RayDataset
from training.devices import agree
from training.marching.march import MarchSizes, march
from training.marching.rays import to_grid
from training.method import Rays, ViewMlpParams
from training.voxels.coverage import views_that_see
from training.voxels.field import remember_depths, render_samples
from training.voxels.lists import fitting_sizes, hits_of
from training.voxels.settings import Plan, Settings
from training.voxels.sparse_grid import (
    CHANNELS,
    GridLayout,
    build_layout,
    dilate,
    interpolate,
    present_voxels,
    voxel_centres,
)  # fmt: skip
from training.voxels.state import Trainable, VoxelState

PRUNE_RAYS = 200_000  # rays whose weights decide which voxels stay
QUERY_POINTS = 131_072


def dense_start(plan: Plan, geometry: RayDataset, settings: Settings, head: ViewMlpParams | None) -> VoxelState:
    """Every voxel of the first stage present, but for what too few photographs see; raw values zero.

    geometry: the dataset on one device of this process (RayDataset.local), as everywhere here.
    """
    voxel = plan.extent / plan.resolutions[0] * plan.shape
    shape = np.maximum(np.ceil((plan.box[1] - plan.box[0]) / voxel - 1e-6).astype(int), 1)
    present = np.ones(tuple(shape[::-1]), bool)
    layout = build_layout(present, plan.box[0], voxel)
    if plan.least_views > 1:
        present = views_that_see(geometry, layout) >= plan.least_views
        layout = build_layout(present, plan.box[0], voxel)
    rows = jnp.zeros((present.sum() + 1, CHANNELS), jnp.float32)
    every_ray = jnp.arange(geometry.count, dtype=jnp.int32)
    blank, blank_too = (jax.tree.map(jnp.zeros_like, head) for _ in range(2))  # each is given away on its own
    return _stage_of(
        Trainable(rows, head),
        (blank, blank_too),
        jnp.int32(0),
        layout,
        (every_ray, len(every_ray)),
        plan,
        geometry,
        settings,
    )


def refine(state: VoxelState, resolution: int, plan: Plan, geometry: RayDataset, settings: Settings) -> VoxelState:
    """Drops voxels that no pixel sees, fits the box to the rest, and resamples at `resolution` where that is finer."""
    weights = _visible_weights(state, geometry, settings)
    present = present_voxels(state.layout)
    keep = np.zeros(present.shape, bool)
    keep[present] = weights[1:] > plan.keep_weight
    if not keep.any():
        return state  # nothing is visible yet: too early to prune
    keep = dilate(keep) & present
    origin, voxel = np.asarray(state.layout.origin, np.float64), np.asarray(state.layout.voxel, np.float64)
    low, high = _bounds(keep)
    origin, keep = origin + low * voxel, keep[tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))]
    finest_asked = min(plan.extent, ((high - low) * voxel).max()) / resolution
    if finest_asked < 0.75 * voxel[0]:
        keep, voxel = _resample(keep, voxel, finest_asked * plan.shape)
    layout = build_layout(keep, origin, voxel)
    rows = agree(_resample_rows(state, voxel_centres(keep, origin, voxel)))
    return _stage_of(
        Trainable(rows, state.trainable.head), (state.first.head, state.second.head), state.updates, layout,
        (state.hits, int(state.hit_count)), plan, geometry, settings,
    )  # fmt: skip


def _stage_of(
    trainable: Trainable, head_moments: tuple[ViewMlpParams | None, ViewMlpParams | None], updates: jax.Array,
    layout: GridLayout, candidates: tuple[jax.Array, int], plan: Plan, geometry: RayDataset, settings: Settings,
) -> VoxelState:  # fmt: skip
    """A state around new voxels: rays that meet them, list sizes that fit, fresh moments for voxels.

    candidates: hits and hit_count of before; rays that met no content then meet none now.
    """
    layout = remember_depths(trainable.rows, layout, settings)
    hits, hit_count = candidates
    if not plan.always_hit:
        hits, hit_count = hits_of(geometry, layout, hits, hit_count, settings.step_voxels)
    (cells,) = np.nonzero(np.asarray(layout.lookup))
    sizes, rays = fitting_sizes(geometry, layout, hits, hit_count, plan, settings)
    first, second = (Trainable(jnp.zeros_like(trainable.rows), head) for head in head_moments)
    return VoxelState(
        trainable=trainable,
        first=first,
        second=second,
        updates=updates,
        layout=layout,
        cells=jnp.asarray(np.concatenate([[0], cells]).astype(np.int32)),
        hits=hits,
        hit_count=jnp.int32(hit_count),
        sizes=sizes,
        rays=rays,
    )


def _bounds(volume: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The (x, y, z) range of voxels that are set."""
    ranges = []
    for axis in (2, 1, 0):
        (where,) = np.nonzero(volume.any(axis=tuple(a for a in range(3) if a != axis)))
        ranges.append((where[0], where[-1] + 1))
    return np.array([r[0] for r in ranges]), np.array([r[1] for r in ranges])


def _resample(keep: np.ndarray, voxel: np.ndarray, finer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`keep` [z, y, x] at another voxel size [3]: a finer voxel is set where its centre lies in a set coarse one."""
    axes = []
    for size, old, new in zip(keep.shape, voxel[::-1], finer[::-1], strict=True):
        count = int(np.ceil(size * old / new - 1e-6))
        axes.append(np.minimum(((np.arange(count) + 0.5) * new / old).astype(int), size - 1))
    return keep[np.ix_(*axes)], finer


def _resample_rows(state: VoxelState, centres: np.ndarray) -> jax.Array:
    """Raw values [V + 1, 8] of new voxels from the old grid."""
    parts = [jnp.zeros((1, CHANNELS), jnp.float32)]
    for start in range(0, len(centres), QUERY_POINTS):
        points = centres[start : start + QUERY_POINTS]
        padded = np.zeros((QUERY_POINTS, 3), np.float32)
        padded[: len(points)] = points
        parts.append(_raw_at(state.trainable.rows, state.layout, jnp.asarray(padded))[: len(points)])
    return jnp.concatenate(parts)


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


def _visible_weights(state: VoxelState, geometry: RayDataset, settings: Settings) -> np.ndarray:
    """float32 [V + 1]: the largest share that the voxel contributed to any of many training pixels."""
    best = jnp.zeros(state.trainable.rows.shape[0])
    count = int(state.hit_count)
    ids = np.random.default_rng(1).permutation(np.asarray(state.hits)[:count])[:PRUNE_RAYS]
    for start in range(0, len(ids), state.rays):
        part = np.resize(ids[start : start + state.rays], state.rays)
        rays = geometry.geometry_at(jnp.asarray(part))
        best = _nearest_weights(state.trainable, state.layout, best, rays, state.sizes, settings)
    return agree(np.asarray(best))  # processes that differ in the last bit would keep different voxels
