"""What happens between steps of the fast method: the dense start, pruning, refining, whole pictures, saving.

Host-side code in NumPy with short jitted helpers; the step itself is in training.voxels.method.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from training.dataset import RayDataset
from training.devices import agree
from training.method import Rays, RenderOutput, ViewMlpParams
from training.voxels.coverage import views_that_see
from training.voxels.march import GridRays, MarchSizes, march, occupied_segments, to_grid
from training.voxels.sparse_grid import (
    BRICK,
    CHANNELS,
    GridLayout,
    build_layout,
    interpolate,
    present_voxels,
    voxel_centres,
)  # fmt: skip

if TYPE_CHECKING:
    from training.voxels.config import KindSettings
    from training.voxels.method import Settings, Trainable, VoxelMethod, VoxelState

SETTLING_STEPS = 80  # before this nothing is visible enough to tell content from air, however short the run
CHUNK = 16_384  # rays looked at at once when only occupancy is asked
PROBE_RAYS = 4096  # rays whose sample counts set the list sizes
PRUNE_RAYS = 200_000  # rays whose weights decide which voxels stay
RENDER_RAYS, RENDER_SAMPLES = 4096, 131_072
QUERY_POINTS = 131_072
HEADROOM = 1.15  # lists are this much longer than the mean asks for


def schedule(voxels: KindSettings, steps: int, resolutions: tuple[int, ...]) -> dict[int, int]:
    """step -> resolution of the grid from then on; a step that keeps the resolution only prunes."""
    events: dict[int, int] = {}
    for share in sorted({*voxels.stage_starts, *voxels.prunings}):
        stage = max(i for i, start in enumerate(voxels.stage_starts) if start <= share)
        step = round(share * steps)
        events[max(step, SETTLING_STEPS) if step else 0] = resolutions[stage]
    return events


# --- starting, pruning, refining ---------------------------------------------------------------------------------------


def dense_start(method: VoxelMethod, head: ViewMlpParams | None) -> VoxelState:
    """Every voxel of the first stage present, raw values zero."""
    voxel = (method.box[1] - method.box[0]).max() / method.resolutions[0] * method.shape
    shape = np.maximum(np.ceil((method.box[1] - method.box[0]) / voxel - 1e-6).astype(int), 1)
    present = np.ones(tuple(shape[::-1]), bool)
    layout = build_layout(present, method.box[0], voxel)
    if method.by_kind.least_views > 1:
        present = views_that_see(method.geometry, layout) >= method.by_kind.least_views
        layout = build_layout(present, method.box[0], voxel)
    rows = jnp.zeros((present.sum() + 1, CHANNELS), jnp.float32)
    every_ray = jnp.arange(method.dataset.count, dtype=jnp.int32)
    return _assemble(method, rows, head, layout, every_ray, len(every_ray))


def refine(method: VoxelMethod, state: VoxelState, resolution: int) -> VoxelState:
    """Drops voxels that no pixel sees, fits the box to the rest, and resamples at `resolution` where that is finer."""
    weights = _visible_weights(method, state)
    present = present_voxels(state.layout)
    keep = np.zeros(present.shape, bool)
    keep[present] = weights[1:] > method.by_kind.keep_weight
    if not keep.any():
        return state  # nothing is visible yet: too early to prune
    keep = dilate(keep) & present
    origin, voxel = np.asarray(state.layout.origin, np.float64), np.asarray(state.layout.voxel, np.float64)
    extents = (method.box[1] - method.box[0]).max()
    low, high = _bounds(keep)
    origin, keep = origin + low * voxel, keep[tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))]
    finest_asked = min(extents, ((high - low) * voxel).max()) / resolution
    if finest_asked < 0.75 * voxel[0]:
        keep, voxel = _resample(keep, voxel, finest_asked * method.shape)
    layout = build_layout(keep, origin, voxel)
    rows = agree(_resample_rows(state, voxel_centres(keep, origin, voxel)))
    return _assemble(method, rows, state.trainable.head, layout, state.hits, int(state.hit_count), state)


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


def _assemble(
    method: VoxelMethod, rows: jax.Array, head: ViewMlpParams | None, layout: GridLayout, hits: jax.Array,
    hit_count: int, before: VoxelState | None = None,
) -> VoxelState:  # fmt: skip
    """A state around new voxels: rays that meet them, list sizes that fit, fresh moments for voxels."""
    from training.voxels.method import Trainable, VoxelState, remember_depths

    layout = remember_depths(rows, layout, method.settings)
    if method.dataset.kind == "object":  # elsewhere every ray ends at something
        hits, hit_count = _rays_that_hit(method.geometry, layout, hits, hit_count, method.settings.step_voxels)
    present = np.asarray(layout.lookup)
    (cells,) = np.nonzero(present)
    zeros = jnp.zeros_like(rows)
    blank = jax.tree.map(jnp.zeros_like, head)
    sizes, rays = _fit_sizes(method, layout, hits, hit_count)
    return VoxelState(
        trainable=Trainable(rows, head),
        first=Trainable(zeros, before.first.head if before else blank),
        second=Trainable(jnp.zeros_like(rows), before.second.head if before else jax.tree.map(jnp.zeros_like, head)),
        updates=before.updates if before else jnp.int32(0),
        layout=layout,
        cells=jnp.asarray(np.concatenate([[0], cells]).astype(np.int32)),
        hits=hits,
        hit_count=jnp.int32(hit_count),
        sizes=sizes,
        rays=rays,
    )


# --- which rays, how many samples ---------------------------------------------------------------------------------------


def _segments(layout: GridLayout, step_voxels: float) -> int:
    diagonal = float(np.linalg.norm(np.asarray(layout.dims, np.float64)))
    return int(np.ceil(diagonal / step_voxels / BRICK)) + 1


@partial(jax.jit, static_argnames=("segments", "step"))
def _meets_content(dataset: RayDataset, layout: GridLayout, ids: jax.Array, segments: int, step: float) -> jax.Array:
    rays = dataset.geometry_at(ids)
    return occupied_segments(layout, to_grid(layout, rays), jnp.zeros(ids.shape[0]), segments, step).any(-1)


def _rays_that_hit(
    dataset: RayDataset, layout: GridLayout, hits: jax.Array, hit_count: int, step: float
) -> tuple[jax.Array, int]:
    """The ids among the first hit_count of `hits` whose rays may meet content; the rest of the array is padding."""
    candidates = np.asarray(hits)[:hit_count]
    padded = np.zeros(-(-len(candidates) // CHUNK) * CHUNK, np.int32)
    padded[: len(candidates)] = candidates
    segments = _segments(layout, step)
    meets = [
        np.asarray(_meets_content(dataset, layout, jnp.asarray(part), segments, step))
        for part in padded.reshape(-1, CHUNK)
    ]
    kept = candidates[agree(np.concatenate(meets)[: len(candidates)])]
    out = np.zeros(dataset.count, np.int32)
    out[: len(kept)] = kept
    return jnp.asarray(out), max(len(kept), 1)


def _fit_sizes(method: VoxelMethod, layout: GridLayout, hits: jax.Array, hit_count: int) -> tuple[MarchSizes, int]:
    """List sizes and rays a step such that the sample list is just filled, from the counts of some probe rays."""
    step = method.settings.step_voxels
    probe = np.random.default_rng(0).integers(0, hit_count, PROBE_RAYS)
    segments = _segments(layout, step)
    rays = method.geometry.geometry_at(hits[jnp.asarray(probe)])
    horizon = method.settings.horizon
    coarse, fine = (agree(np.asarray(a)) for a in _count(layout, to_grid(layout, rays), segments, step, horizon))
    total = method.voxels.samples_per_step
    per_ray = int(fine.max() * HEADROOM) + 8
    count = int(np.clip(total / max(fine.mean(), 1.0), 256, 8 * method.config.batch_size))
    count = -(-count // 256) * 256
    return MarchSizes(segments, int(count * (coarse.mean() * HEADROOM + 1)), total, per_ray), count


@partial(jax.jit, static_argnames=("segments", "step", "horizon"))
def _count(layout: GridLayout, rays: GridRays, segments: int, step: float, horizon: int) -> tuple[jax.Array, jax.Array]:
    """Coarse segments and samples before the horizon [N] of each ray."""
    coarse = occupied_segments(layout, rays, jnp.zeros_like(rays.start), segments, step).sum(-1)

    def add(k, carry):
        total, deep = carry
        t = rays.start + k * step
        depth = jnp.where(t < rays.end, layout.optical_depth(rays.origins + t[:, None] * rays.directions), 0)
        return total + ((depth > 0) & (deep < horizon)), deep + jnp.maximum(depth - 1, 0)

    nothing = jnp.zeros_like(coarse)
    return coarse, jax.lax.fori_loop(0, segments * BRICK, add, (nothing, nothing))[0]


@partial(jax.jit, static_argnames=("sizes", "settings"))
def _nearest_weights(
    trainable: Trainable, layout: GridLayout, best: jax.Array, rays: Rays, sizes: MarchSizes, settings: Settings
) -> jax.Array:
    from training.voxels.method import render_samples

    count = rays.near.shape[0]
    grid_rays = to_grid(layout, rays)
    samples = march(layout, grid_rays, jnp.full(count, 0.5), sizes, settings.step_voxels, settings.horizon)
    raw = interpolate(trainable.rows, layout, samples.g)
    _, _, weights = render_samples(raw, trainable.head, samples, grid_rays.length, rays.viewdirs, sizes, settings)
    cell = jnp.clip(jnp.floor(samples.g).astype(jnp.int32) + 1, 0, layout.dims + 1)
    flat = (cell[:, 2] * (layout.dims[1] + 2) + cell[:, 1]) * (layout.dims[0] + 2) + cell[:, 0]
    return best.at[layout.lookup[flat]].max(weights)


def _visible_weights(method: VoxelMethod, state: VoxelState) -> np.ndarray:
    """float32 [V + 1]: the largest share that the voxel contributed to any of many training pixels."""
    best = jnp.zeros(state.trainable.rows.shape[0])
    count = int(state.hit_count)
    ids = np.random.default_rng(1).permutation(np.asarray(state.hits)[:count])[:PRUNE_RAYS]
    for start in range(0, len(ids), state.rays):
        part = np.resize(ids[start : start + state.rays], state.rays)
        rays = method.geometry.geometry_at(jnp.asarray(part))
        best = _nearest_weights(state.trainable, state.layout, best, rays, state.sizes, method.settings)
    return agree(np.asarray(best))  # processes that differ in the last bit would keep different voxels


def boxes_with_voxels(layout: GridLayout, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """bool [N]: which world boxes [N, 3] have a present voxel within them or next to them, by a summed-area table."""
    present = present_voxels(layout)
    table = np.zeros([n + 1 for n in present.shape], np.int64)
    table[1:, 1:, 1:] = present.cumsum(0, dtype=np.int64).cumsum(1).cumsum(2)
    origin, voxel = np.asarray(layout.origin, np.float64), np.asarray(layout.voxel, np.float64)
    most = np.array(present.shape[::-1])
    a = np.clip(np.floor((low - origin) / voxel).astype(int) - 1, 0, most)
    b = np.clip(np.ceil((high - origin) / voxel).astype(int) + 1, 0, most)
    count = np.zeros(len(low), np.int64)
    for corner in range(8):  # inclusion and exclusion over the box's corners
        picked = [(a if corner >> axis & 1 else b)[:, axis] for axis in range(3)]
        count += (-1) ** bin(corner).count("1") * table[picked[2], picked[1], picked[0]]
    return count > 0


# --- whole pictures -----------------------------------------------------------------------------------------------------


@partial(jax.jit, static_argnames=("sizes", "settings"))
def _render_chunk(
    trainable: Trainable, layout: GridLayout, rays: Rays, sizes: MarchSizes, settings: Settings
) -> tuple[RenderOutput, jax.Array]:
    from training.voxels.method import render_samples

    grid_rays = to_grid(layout, rays)
    samples = march(layout, grid_rays, jnp.full(rays.near.shape[0], 0.5), sizes, settings.step_voxels)
    raw = interpolate(trainable.rows, layout, samples.g)
    output, _, _ = render_samples(raw, trainable.head, samples, grid_rays.length, rays.viewdirs, sizes, settings)
    depth = output.depth / jnp.maximum(output.alpha, 1e-6) / grid_rays.scale
    return output._replace(rgb=jnp.clip(output.rgb, 0, 1), depth=depth), samples.complete


def render_all(method: VoxelMethod, state: VoxelState, rays: Rays) -> RenderOutput:
    """Every ray, sample at start + (1/2 + k) step as the viewer takes them; as many rays a chunk as fit the lists."""
    segments = _segments(state.layout, method.settings.step_voxels)
    sizes = MarchSizes(segments, RENDER_SAMPLES, RENDER_SAMPLES, segments * BRICK)
    total = rays.near.shape[0]
    parts = list(_render_parts(method, state, rays, sizes, total))
    return RenderOutput(*(jnp.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _render_parts(
    method: VoxelMethod, state: VoxelState, rays: Rays, sizes: MarchSizes, total: int
) -> Iterator[tuple[jax.Array, ...]]:
    host = [np.asarray(array) for array in rays]
    start = 0
    while start < total:
        index = np.minimum(np.arange(start, start + RENDER_RAYS), total - 1)
        output, complete = _render_chunk(
            state.trainable, state.layout, Rays(*(jnp.asarray(a[index]) for a in host)), sizes, method.settings
        )
        done = np.asarray(complete)
        ready = int(done.argmin()) if not done.all() else RENDER_RAYS
        ready = min(ready, total - start)
        yield tuple(array[:ready] for array in output)
        start += ready


# --- saving -------------------------------------------------------------------------------------------------------------


def save(state: VoxelState) -> dict[str, np.ndarray]:
    """Named arrays: what `restore` cannot derive."""
    arrays = {
        "origin": state.layout.origin, "voxel": state.layout.voxel, "dims": state.layout.dims,
        "depths": np.asarray(state.layout.support)[np.asarray(state.layout.support) > 0],
        "cells": state.cells, "hits": state.hits[: int(state.hit_count)], "updates": state.updates,
        "sizes": np.array([*state.sizes, state.rays], np.int32),
    }  # fmt: skip
    for name in ("trainable", "first", "second"):
        part = getattr(state, name)
        arrays[f"{name}.rows"] = part.rows
        if part.head is not None:
            arrays |= {f"{name}.weight{i}": w for i, w in enumerate(part.head.weights)}
            arrays |= {f"{name}.bias{i}": b for i, b in enumerate(part.head.biases)}
    return {name: np.asarray(array, order="C") for name, array in arrays.items()}


def restore(method: VoxelMethod, arrays: Mapping[str, np.ndarray]) -> VoxelState:
    """The inverse of save."""
    from training.voxels.method import Trainable, VoxelState

    width, height, depth = (int(n) for n in arrays["dims"])
    padded = np.zeros((depth + 2, height + 2, width + 2), bool)
    padded.ravel()[arrays["cells"][1:]] = True
    layout = build_layout(padded[1:-1, 1:-1, 1:-1], arrays["origin"], arrays["voxel"])
    layout = layout._replace(support=layout.support.at[layout.support > 0].set(jnp.asarray(arrays["depths"])))
    parts = {}
    for name in ("trainable", "first", "second"):
        head = None
        if f"{name}.weight0" in arrays:
            head = ViewMlpParams(
                tuple(jnp.asarray(arrays[f"{name}.weight{i}"]) for i in range(3)),  # type: ignore[arg-type]
                tuple(jnp.asarray(arrays[f"{name}.bias{i}"]) for i in range(3)),  # type: ignore[arg-type]
            )
        parts[name] = Trainable(jnp.asarray(arrays[f"{name}.rows"]), head)
    hits = np.zeros(method.dataset.count, np.int32)
    hits[: len(arrays["hits"])] = arrays["hits"]
    *sizes, rays = (int(n) for n in arrays["sizes"])
    return VoxelState(
        **parts, updates=jnp.asarray(arrays["updates"]), layout=layout, cells=jnp.asarray(arrays["cells"]),
        hits=jnp.asarray(hits), hit_count=jnp.int32(len(arrays["hits"])), sizes=MarchSizes(*sizes), rays=rays,
    )  # fmt: skip
