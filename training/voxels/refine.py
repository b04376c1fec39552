"""What happens to voxels between steps: the dense start, pruning by visible weight, refining.

Pruning by the largest weight that a voxel has in any training pixel is Plenoxels' (Fridovich-Keil et al. 2022). On the host,
in NumPy; what looks at rays and at rows is the engine's.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from training.dataset import RayDataset
from training.method import ViewMlpParams
from training.voxels.coverage import views_that_see
from training.voxels.engine import Engine
from training.voxels.settings import Plan
from training.voxels.sparse_grid import CHANNELS, Occupancy, build_layout, dilate
from training.voxels.state import Trainable, VoxelState, ray_ids, state_over

# How many rays tell which voxels stay. A surface is several voxels thick, so that one ray for two voxels is a few for each that
# can be seen, however fine the grid; with a fixed number, one in ten visible voxels at 512³ was met by none and lost.
PRUNE_RAYS, PRUNE_RAYS_PER_VOXEL = 200_000, 0.5
FEWER = 0.5  # where no more than this share of the voxels is left, fewer rays meet any
# No pruning takes a larger share of what photographs show: 0.01 to 0.2 is usual, 0.99 where all is mist still.
MOST_FAINT = 0.1
LISTED_TOGETHER = 1 << 25  # rays whose ids are listed together to ask which meet content


def dense_start(plan: Plan, geometry: RayDataset, head: ViewMlpParams | None, step_voxels: float = 1.0) -> VoxelState:
    """Every voxel of the first stage present, but for what too few photographs see; raw values zero.

    geometry: the dataset on one device of this process (RayDataset.local).
    """
    voxel = plan.extent / plan.resolutions[0] * plan.shape
    shape = np.maximum(np.ceil((plan.box[1] - plan.box[0]) / voxel - 1e-6).astype(int), 1)
    present = np.ones(tuple(shape[::-1]), bool)
    layout = build_layout(present, plan.box[0], voxel)
    if plan.least_views > 1:
        seen = views_that_see(geometry, layout)
        present = seen >= min(plan.least_views, max(int(seen.max()), 1))  # no voxel at all says nothing of anything
        layout = build_layout(present, plan.box[0], voxel)
    rows = jnp.zeros((present.sum() + 1, CHANNELS), jnp.float32)
    blank, blank_too = (Trainable(jnp.zeros_like(rows), jax.tree.map(jnp.zeros_like, head)) for _ in range(2))
    return state_over(layout, (Trainable(rows, head), blank, blank_too), jnp.int32(0), geometry.count, step_voxels)


def refine(engine: Engine, state: Any, resolution: int, plan: Plan) -> Any:
    """An engine's state without the voxels that no pixel sees, in a box that fits the rest, resampled at `resolution` where
    that is finer; Adam's moments of voxels begin anew only there."""
    hits, hit_count = engine.drawn(state)
    present, origin, voxel = engine.occupancy(state)
    voxels = int(np.count_nonzero(present))
    best, total = engine.visible_weights(state, _pruning_rays(hits, hit_count, voxels))
    keep = np.zeros(present.shape, bool)
    keep[present] = worth_keeping(best, total, plan.keep_weight)[1:]
    if not keep.any():
        return state  # nothing is visible yet: too early to prune
    keep = dilate(keep) & present
    kept = np.concatenate([[0], 1 + np.flatnonzero(keep[present])])
    low, high = _bounds(keep)
    origin, keep = origin + low * voxel, keep[tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))]
    finest_asked = min(plan.extent, ((high - low) * voxel).max()) / resolution
    if finer := finest_asked < 0.75 * voxel[0]:
        keep, voxel = _resample(keep, voxel, finest_asked * plan.shape)
    del present, best, total  # hundreds of megabytes at 512³, before as much is asked for
    state = engine.regrid(state, Occupancy(keep, origin, voxel), None if finer else kept)
    if not plan.always_hit and (finer or len(kept) < FEWER * (voxels + 1)):
        hits, hit_count = _rays_that_meet(engine, state, hits, hit_count)
    return engine.draw_from(state, hits, hit_count)


def _pruning_rays(hits: np.ndarray, hit_count: int, voxels: int) -> np.ndarray:
    """Ids of the rays that tell which voxels stay; in order, since neighbours read the same memory."""
    count = max(PRUNE_RAYS, int(PRUNE_RAYS_PER_VOXEL * voxels))
    if count >= hit_count:
        return ray_ids(hits, np.arange(hit_count, dtype=np.int32))
    return ray_ids(hits, np.sort(np.random.default_rng(1).integers(0, hit_count, count)))


def worth_keeping(best: np.ndarray, total: np.ndarray, keep_weight: float) -> np.ndarray:
    """bool [V]: voxels whose largest visible weight, best [V], is above keep_weight; or above less, where voxels below it still
    make up more than MOST_FAINT of what is seen, total [V], as they do early, when everything is mist."""
    order = np.argsort(best)
    share = np.cumsum(total[order], dtype=np.float64)
    faint = np.searchsorted(share, MOST_FAINT * share[-1], side="right")  # so many may go; all where nothing is seen
    if faint == len(order) or best[order[faint]] > keep_weight:
        return best > keep_weight
    return best >= best[order[faint]]  # what is as bright as the first that stays, stays


def _rays_that_meet(engine: Engine, state: Any, hits: np.ndarray, hit_count: int) -> tuple[np.ndarray, int]:
    """Of the rays that a stage drew from, those that may meet content in a state, some at a time."""
    kept = []
    for low in range(0, hit_count, LISTED_TOGETHER):
        ids = ray_ids(hits, np.arange(low, min(low + LISTED_TOGETHER, hit_count), dtype=np.int32))
        kept.append(ids[engine.meeting(state, ids)])
    found = np.concatenate(kept)
    if not len(found):
        found = ray_ids(hits, np.zeros(1, np.int32))  # a step needs something to draw
    return (hits, hit_count) if len(found) == hit_count else (found, len(found))


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
