"""baker.tuning.tuner.Tuner by compiled loops on the processor's cores. A step marches its rays through the atlas as it is
stored, has JAX shade them, walks back along the samples that counted, and stores the cells that moved anew.

Results do not depend on threads: what is added up is added in the order of the rays.

Notation: R rays of a step, in chunks of CHUNK; C samples of a chunk contribute; K cells.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numba import njit

from baker.tuning.fused.cells import DEPTHS, add_slopes, cell_at, cells_of, move_cells, move_moments, store_cells
from baker.tuning.fused.marcher import LISTED, FusedMarcher, Tables, list_contributing, room_for_samples
from baker.tuning.marcher import Accumulated, Box
from baker.tuning.pack_layout import MAX_ALPHA
from baker.tuning.tuner import (
    PROBE_RAYS,
    Look,
    Trained,
    adam_head,
    bias_correction,
    psnr_of,
    squared_error,
)
from baker.view_mlp import from_params, to_params
from scenepack.codecs.steps import EXACT, Steps
from scenepack.constants import TRANSMITTANCE_STOP
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.marching.rays import GridFrameRays, to_grid
from training.method import ViewMlpParams
from training.multires.fused.workers import Workers

CHUNK = 256  # rays
PROBED = 96  # contributing samples a ray that a probe has room for, on average
SPARE = 2.0  # room for samples that contribute, over the mean: a chunk's rays differ
PART = 8192  # cells that a worker claims
STORED = 512  # cells that a worker stores at once
MOST_CORNERS = 8  # cells that a sample may touch
# d alpha / d log density of a stored alpha, where alpha = 1 - exp(-depth): depth exp(-depth); 0 where it is empty.
LOG_DENSITY = (
    -np.log1p(-np.minimum(np.arange(256) / 255, MAX_ALPHA)) * (1 - np.arange(256) / 255) / np.maximum(np.arange(256) / 255, 1e-6)
).astype(np.float32)  # fmt: skip


class Work(NamedTuple):
    """What a step lists. Of samples: at int64 [chunks, C] the lowest corner in the atlas; slot int32, local int32 [., 3] its cell
    in the copy; weights float32 [., 8] of the corners; before float32: T. first int32 [chunks, CHUNK + 1]: where a ray's begin.

    Of cells: cells int32 [chunks, 8 C], slopes float32 [., 8]; entries int64 [chunks]: how many. Of rays: sums float32 [R, 8],
    colour, features, T behind; whole bool [R]: which had room; supported int64 [chunks]: samples.
    """

    at: np.ndarray
    slot: np.ndarray
    local: np.ndarray
    weights: np.ndarray
    before: np.ndarray
    first: np.ndarray
    cells: np.ndarray
    slopes: np.ndarray
    entries: np.ndarray
    sums: np.ndarray
    whole: np.ndarray
    supported: np.ndarray


class Looked(NamedTuple):
    """Rays of a step as baker.tuning.tuner.squared_error asks for them, in its order; head: the view MLP."""

    sums: Accumulated
    head: ViewMlpParams | None
    viewdirs: jax.Array
    target: jax.Array
    whole: jax.Array
    background: tuple[float, ...]


def work_for(rays: int, room: int) -> Work:
    """Room for so many rays, and so many contributing samples of a chunk."""
    chunks = -(-rays // CHUNK)
    listed = (chunks, room)
    return Work(
        np.empty(listed, np.int64), np.empty(listed, np.int32), np.empty((*listed, 3), np.int32),
        np.empty((*listed, 8), np.float32), np.empty(listed, np.float32), np.zeros((chunks, CHUNK + 1), np.int32),
        np.empty((chunks, MOST_CORNERS * room), np.int32), np.empty((chunks, MOST_CORNERS * room, 8), np.float32),
        np.zeros(chunks, np.int64), np.zeros((rays, 8), np.float32), np.zeros(rays, bool), np.zeros(chunks, np.int64),
    )  # fmt: skip


@njit(nogil=True, cache=True)
def gather_chunk(tables: Tables, rays, chunk, low, high, found, work):
    """Lists the contributing samples of rays low … high - 1, and accumulates them; rays without room count for nothing."""
    rgba, features, row, layer = tables.rgba, tables.features, np.int64(tables.row), np.int64(tables.layer)
    coloured, one, room = features.shape[0] > 0, np.float32(1.0), work.at.shape[1]
    total, n, supported = np.empty(8, np.float32), 0, 0
    for ray in range(low, high):
        work.first[chunk, ray - low] = n
        passed, k, listed, own = one, np.int64(0), LISTED, n
        total[:] = np.float32(0.0)
        while listed == LISTED and passed > np.float32(TRANSMITTANCE_STOP) and own <= room:
            count, k, listed = list_contributing(tables, rays, ray, k, found)
            supported += listed
            for i in range(count):
                if own == room:
                    own = room + 1
                    break
                scale = passed * np.float32(1 / 255)
                for corner in range(8):
                    place = found.at[i] + (corner >> 2) * layer + (corner >> 1 & 1) * row + (corner & 1)
                    share = found.weights[i, corner] * scale
                    work.weights[chunk, own, corner] = found.weights[i, corner]
                    for c in range(3):
                        total[c] += share * np.float32(rgba[place, c])
                    if coloured:
                        for c in range(4):
                            total[3 + c] += share * np.float32(features[place, c])
                work.at[chunk, own], work.slot[chunk, own], work.before[chunk, own] = found.at[i], found.slot[i], passed
                for axis in range(3):
                    work.local[chunk, own, axis] = found.cell[i, axis]
                own += 1
                passed *= one - min(found.alpha[i], np.float32(MAX_ALPHA))
                if passed <= np.float32(TRANSMITTANCE_STOP):
                    break
        work.whole[ray] = own <= room
        if work.whole[ray]:
            n = own
            for c in range(7):
                work.sums[ray, c] = total[c]
            work.sums[ray, 7] = passed
        else:
            work.sums[ray, :7] = np.float32(0.0)
            work.sums[ray, 7] = one
    work.first[chunk, high - low] = n
    work.supported[chunk] = supported


@njit(nogil=True, cache=True)
def slope_chunk(tables: Tables, cells, log_density, slopes, chunk, low, high, work):
    """Lists what the loss's slopes float32 [R, 8] of sums of rays low … high - 1 say of cells.

    Back along a ray: with G = dL/dT behind a sample of v = (colour, features) and alpha, dL/dv = T s, dL/d alpha = -T G, and
    dL/dT before it = (1 - alpha) G + v · s.
    """
    one, most = np.float32(1.0), np.float32(MAX_ALPHA)
    value, of_value, entries = np.empty(8, np.float32), np.empty(8, np.float32), 0
    for ray in range(low, high):
        behind = slopes[ray, 7]
        for n in range(work.first[chunk, ray - low + 1] - 1, work.first[chunk, ray - low] - 1, -1):
            _interpolate(tables, work.at[chunk, n], work.weights[chunk, n], value)
            passed, change = work.before[chunk, n], np.float32(0.0)
            for c in range(7):
                channel = c if c < 3 else c + 1  # alpha lies between
                of_value[channel] = passed * slopes[ray, c]
                change += slopes[ray, c] * value[channel]
            of_value[3] = -passed * behind if value[3] < most else np.float32(0.0)
            entries = _list_cells(tables, cells, log_density, of_value, chunk, n, entries, work)
            behind = (one - min(value[3], most)) * behind + change
    work.entries[chunk] = entries


@njit(nogil=True, cache=True)
def _interpolate(tables, at, weights, value):
    """value float32 [8]: colour, alpha, features between the eight voxels from `at` on."""
    rgba, features, coloured = tables.rgba, tables.features, tables.features.shape[0] > 0
    value[:] = np.float32(0.0)
    for corner in range(8):
        place = at + (corner >> 2) * tables.layer + (corner >> 1 & 1) * tables.row + (corner & 1)
        share = weights[corner] * np.float32(1 / 255)
        for c in range(4):
            value[c] += share * np.float32(rgba[place, c])
            if coloured:
                value[4 + c] += share * np.float32(features[place, c])


@njit(nogil=True, cache=True)
def _list_cells(tables, cells, log_density, of_value, chunk, n, entries, work):
    """Lists, from `entries` on, what the slopes of a sample's value float32 [8] say of the cells of its eight voxels; where
    others go. A stored voxel is alpha (colour, 1, features); delta adds to what is in brackets."""
    rgba, features, coloured = tables.rgba, tables.features, tables.features.shape[0] > 0
    corners, local, slot, unit = cells.corners, work.local, work.slot[chunk, n], np.float32(1 / 255)
    begun = entries
    for corner in range(8):
        right, down, deeper = corner & 1, corner >> 1 & 1, corner >> 2
        place = work.at[chunk, n] + deeper * tables.layer + down * tables.row + right
        alpha, share = rgba[place, 3], work.weights[chunk, n, corner]
        if alpha == 0 or share == 0:
            continue
        x, y = corners[slot, 0] + local[chunk, n, 0] + right, corners[slot, 1] + local[chunk, n, 1] + down
        z = corners[slot, 2] + local[chunk, n, 2] + deeper
        cell = cell_at(cells.numbers, cells.dims, cells.side, x, y, z)
        if cell == 0:
            continue
        entry = begun
        while entry < entries and work.cells[chunk, entry] != cell:
            entry += 1
        if entry == entries:
            entries += 1
            work.cells[chunk, entry] = cell
            work.slopes[chunk, entry] = np.float32(0.0)
        own, opacity, density = work.slopes[chunk, entry], np.float32(alpha) * unit, np.float32(0.0)
        for c in range(8 if coloured else 4):
            density += of_value[c] * np.float32(rgba[place, c] if c < 4 else features[place, c - 4]) * unit
            if c != 3:
                own[c] += share * of_value[c] * opacity
        own[3] += share * density * log_density[alpha]
    return entries


class FusedTuner:
    """See baker.tuning.tuner.Tuner. It works on the pack's own arrays: a second copy of an atlas of 1000³ is a gigabyte."""

    def __init__(self, pack: Pack, dataset: RayDataset, cell: int, look: Look, steps: Steps) -> None:
        self.look, self.steps = look, steps.channels
        features = None if pack.atlas_features is None else np.ascontiguousarray(pack.atlas_features)
        self.pack = replace(pack, atlas_rgba=np.ascontiguousarray(pack.atlas_rgba), atlas_features=features)
        self.dataset, self.workers = dataset, Workers()
        self.marcher = FusedMarcher(self.pack, dataset)
        self.tables = self.marcher.tables
        self.cells = cells_of(pack, self.tables, cell)
        count = self.cells.count + 1
        self.delta, self.first, self.second, self.slopes = (np.zeros((count, 8), np.float32) for _ in range(4))
        self.met = np.zeros(count, np.uint8)
        self.head = pack.view_mlp and to_params(pack.view_mlp)
        self.head_moments = [jax.tree.map(jnp.zeros_like, self.head) for _ in range(2)]
        self.found = [room_for_samples() for _ in range(self.workers.count)]
        if steps != EXACT:
            self._store(self.delta, np.arange(1, count, dtype=np.int32))
        self.rays, self.work = 0, work_for(0, 0)

    def fill(self, ids: np.ndarray, samples: int, seed: int) -> None:
        probe = np.resize(np.random.default_rng(seed).permutation(ids)[:PROBE_RAYS], PROBE_RAYS)
        self.rays, self.work = PROBE_RAYS, work_for(PROBE_RAYS, CHUNK * PROBED)
        self._gather(probe)
        counts = np.diff(self.work.first, axis=1)
        room = int(SPARE * CHUNK * counts.mean()) + int(counts.max()) + LISTED
        each = max(self.work.supported.sum() / PROBE_RAYS, 1.0)
        self.rays = max(int(samples / each) // CHUNK, 1) * CHUNK
        self.work = work_for(self.rays, room)

    def update(self, ids: np.ndarray, rates: np.ndarray, count: int) -> None:
        slopes, head_slope = _slopes(*self._gather(ids), look=self.look)
        self._follow(np.ascontiguousarray(slopes))
        self._move(rates[:8] * np.float32(bias_correction(count)))
        if self.head is not None:
            self.head, *self.head_moments = _adam_head(
                self.head, head_slope, *self.head_moments, jnp.float32(rates[8]), jnp.int32(count)
            )

    def score(self, ids: np.ndarray) -> tuple[float, float]:
        error = weight = rays = samples = 0.0
        for start in range(0, len(ids), self.rays):
            some = ids[start : start + self.rays]
            looked = self._gather(np.resize(some, self.rays))
            counts = self.work.whole & (np.arange(self.rays) < len(some))
            own = _error(*looked._replace(whole=jnp.asarray(counts)), look=self.look)
            error, weight, rays = error + float(own[0]), weight + float(own[1]), rays + np.count_nonzero(counts)
            samples += np.diff(self.work.first, axis=1).ravel()[counts].sum()
        return psnr_of(error, weight), float(samples / max(rays, 1.0))

    def snapshot(self) -> Trained:
        return Trained(self.delta.copy(), jax.tree.map(np.asarray, self.head))  # type: ignore[arg-type]

    def tuned(self, snapshot: Trained) -> Pack:
        self._store(np.asarray(snapshot.delta), np.arange(1, self.cells.count + 1, dtype=np.int32))
        head = snapshot.head
        return self.pack if head is None else replace(self.pack, view_mlp=from_params(head))

    def _gather(self, ids: np.ndarray) -> Looked:
        """Fills the work's samples and sums of rays `ids` [rays]; what shading them asks for."""
        *rays, viewdirs, target = _looked_at(self.marcher.box, self.marcher.rays, self.dataset, jnp.asarray(ids))
        rays = tuple(np.asarray(a) for a in rays)

        def share(worker: int, chunk: int) -> None:
            low, high = chunk * CHUNK, (chunk + 1) * CHUNK
            gather_chunk(self.tables, rays, chunk, low, high, self.found[worker], self.work)

        self.workers.share(self.rays // CHUNK, share)
        sums, whole = jnp.asarray(self.work.sums), jnp.asarray(self.work.whole)
        sums = Accumulated(sums[:, :3], sums[:, 3:7], sums[:, 7])
        return Looked(sums, self.head, viewdirs, target, whole, self.dataset.background)

    def _follow(self, slopes: np.ndarray) -> None:
        """From slopes of sums to slopes of cells."""

        def share(_: int, chunk: int) -> None:
            low, high = chunk * CHUNK, (chunk + 1) * CHUNK
            slope_chunk(self.tables, self.cells, LOG_DENSITY, slopes, chunk, low, high, self.work)

        self.workers.share(self.rays // CHUNK, share)
        ends = np.linspace(1, self.cells.count + 1, self.workers.count + 1).astype(np.int64)

        def add(_: int, part: int) -> None:
            add_slopes(self.work, self.slopes, self.met, ends[part], ends[part + 1])

        self.workers.share(self.workers.count, add)

    def _move(self, rates: np.ndarray) -> None:
        """A step of Adam on the cells that were met, stored."""
        cells = self.cells.count + 1
        parts = -(-cells // PART)
        sums = np.zeros((parts, 2, 8))

        def moments(_: int, part: int) -> None:
            low, high = part * PART, min((part + 1) * PART, cells)
            move_moments(self.slopes, self.met, self.first, self.second, sums, part, low, high)

        self.workers.share(parts, moments)
        total, ever = sums.sum(0)
        floor = np.sqrt(total / np.maximum(ever, 1)).astype(np.float32)
        some = np.flatnonzero(self.met).astype(np.int32)
        self.met[:] = 0

        def move(_: int, part: int) -> None:
            low, high = part * PART, min((part + 1) * PART, len(some))
            move_cells(self.delta, self.slopes, self.first, self.second, floor, rates, some, low, high)

        self.workers.share(-(-len(some) // PART), move)
        self._store(self.delta, some)

    def _store(self, delta: np.ndarray, some: np.ndarray) -> None:
        def share(_: int, part: int) -> None:
            low, high = part * STORED, min((part + 1) * STORED, len(some))
            store_cells(self.cells, DEPTHS, delta, self.steps, some, self.tables.rgba, self.tables.features, low, high)

        self.workers.share(-(-len(some) // STORED), share)


def tuner_of(pack: Pack, dataset: RayDataset, cell: int, look: Look, steps: Steps) -> FusedTuner:
    """The tuner of a pack."""
    return FusedTuner(pack, dataset, cell, look, steps)


@jax.jit
def _looked_at(box: Box, source: GridFrameRays, dataset: RayDataset, ids: jax.Array) -> tuple[jax.Array, ...]:
    """Rays `ids` in voxels: origins, directions [R, 3], start and end [R]; their viewing directions and colours [R, 3]."""
    rays = source.geometry_at(ids)
    grid = to_grid(box, rays)
    return grid.origins, grid.directions, grid.start, grid.end, rays.viewdirs, dataset.colours_at(ids)


_error = jax.jit(partial(squared_error, clamped=True), static_argnames="look")
_adam_head = jax.jit(adam_head)


@partial(jax.jit, static_argnames="look")
def _slopes(
    sums: Accumulated, head: ViewMlpParams | None, viewdirs: jax.Array, target: jax.Array, whole: jax.Array,
    background: tuple[float, ...], look: Look,
) -> tuple[jax.Array, ViewMlpParams | None]:  # fmt: skip
    """Slopes of the mean loss with respect to sums, [R, 8] as Work.sums, and to the view MLP."""

    def loss_of(sums: Accumulated, head: ViewMlpParams | None) -> jax.Array:
        error, weight = squared_error(sums, head, viewdirs, target, whole, background, look, clamped=False)
        return error / jnp.maximum(weight, 1.0)

    slopes, head_slope = jax.grad(loss_of, argnums=(0, 1))(sums, head)
    return jnp.concatenate([slopes.colour, slopes.features, slopes.transmittance[:, None]], axis=-1), head_slope
