"""One step of the voxel method by the fused loops, which share it out among threads.

Notation: V voxels, B bricks; `order` int32 [V + 1] is the layout's row of each of ours, which follow a Morton curve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from scenepack.constants import TRANSMITTANCE_SHADED
from training.marching.layout import COARSE, DEEPEST, DEPTH_UNITS, segments_across
from training.voxels.fused.grid import Grid
from training.voxels.fused.head import (
    COLOUR,
    PARAMETERS,
    PENALTY,
    RAYS,
    SAMPLES,
    SCATTER,
    SQUARED,
    Head,
    make_head_work,
)
from training.voxels.fused.passes import UP_TO
from training.multires.fused.rays import Batch, Photographs, empty_batch, fill_batch, take_rays
from training.voxels.fused.render import CHUNK, Numbers, Work, make_scratch, make_work
from training.voxels.fused.rows import WORD, Variation, adam_rows, gather_slopes, remember, variation
from training.voxels.fused.survey import activate, gather_rays, interpolate, rays_meet, weigh
from training.multires.fused.workers import Workers
from training.voxels.settings import ADAM_BETAS, Settings
from training.voxels.smoothness import WINDOW

NEVER = 2**62  # an optical depth that no ray reaches
CHUNKS_AT_ONCE = 4  # that a worker claims
ROOM = 64  # samples a ray that a chunk has room for, before one of them needs more
POINTS_TOGETHER = 1 << 20  # of voxels, whose values are interpolated together
PROBE_RAYS = 4096  # whose sample counts tell how many rays fill a step


class Values(NamedTuple):
    """rows [V + 1, 8] and the view MLP's flat parameters [883] (empty: diffuse): values, or a moment of them."""

    rows: np.ndarray
    head: np.ndarray


class Gradient(NamedTuple):
    """What a batch says: slopes of rows are in the engine's accumulator; head [883] summed over rays; rays that counted."""

    head: np.ndarray
    rays: float
    metrics: dict[str, float]


def split_head(flat: np.ndarray) -> Head:
    """The view MLP whose parameters lie one after the other in `flat` (no copy): w0, b0, w1, b1, w2, b2."""
    used = flat.size > 0
    flat = flat if used else np.zeros(PARAMETERS, np.float32)
    parts, start = [], 0
    for shape in ((34, 16), (16,), (16, 16), (16,), (16, 3), (3,)):
        size = int(np.prod(shape))
        parts.append(flat[start : start + size].reshape(shape))
        start += size
    return Head(used, *parts)


class Stepper:
    """The fused loops over one grid; a new one is made where the grid changes."""

    def __init__(self, grid: Grid, settings: Settings, workers: Workers) -> None:
        self.grid, self.settings, self.workers = grid, settings, workers
        rows = len(grid.order)
        self.slopes = np.zeros((rows, 8), np.float32)
        self.marks = np.zeros(-(-rows // 64), np.uint64)
        self._most = CHUNK * COARSE * segments_across(grid.bricks.dims, settings.step_voxels)  # samples of a chunk
        self.shading = [make_head_work(CHUNK) for _ in range(workers.count)]
        self._give_room(min(CHUNK * ROOM, self._most))
        f = np.float32
        voxel = float(grid.voxel.max())
        spread = settings.distortion_spread / voxel
        self.numbers = Numbers(
            f(settings.step_voxels), f(settings.shift), f(settings.reference), np.int64(settings.last_depth),
            f(settings.sparsity_weight * settings.step_voxels * voxel / settings.sparsity_spacing),
            f(settings.sparsity_scale), f(settings.distortion_weight / spread), f(TRANSMITTANCE_SHADED),
        )  # fmt: skip

    def batch(
        self, photographs: Photographs, ids: np.ndarray, phase: np.ndarray | float, background: np.ndarray | None
    ) -> Batch:
        """The rays of ids [N] in the grid's frame, over `background` [N, 3] (None: without colours), with samples at
        `phase` [N]."""
        grid, batch = self.grid, empty_batch(len(ids), background is not None)
        batch.phase[:] = phase
        if background is not None:
            batch.background[:] = background
        size = 16 * CHUNK

        def fill(_: int, part: int) -> None:
            low, high = part * size, min((part + 1) * size, len(ids))
            fill_batch(photographs, ids, grid.origin, grid.voxel, grid.bricks.dims, batch, low, high)

        self.workers.share(-(-len(ids) // size), fill)
        return batch

    def differentiate(self, values: Values, batch: Batch, picked: np.ndarray) -> Gradient:
        """Forward and backward: fills `slopes` (sums over rays, the variation's times their number) and `marks`."""
        *_, (_, gradient) = self.gradient_parts(values, batch, picked)
        return gradient

    def gradient_parts(self, values: Values, batch: Batch, picked: np.ndarray) -> Iterator[tuple[str, Any]]:
        """`differentiate` part by part: after each, its name and what it leaves. The last is ("scatter", gradient)."""
        work = self.render(values, batch)
        yield "render", work
        rough = self._variation(values, picked)
        yield "variation", rough
        yield "scatter", self._scattered(work, rough)

    def render(self, values: Values, batch: Batch, up_to: str = "backward") -> Work:
        """A batch's samples and their slopes; up_to: the name of an earlier part to end with (see passes)."""
        head, bricks, chunks_of = split_head(values.head), self.grid.bricks, UP_TO[up_to]

        def look(worker: int, low: int, high: int, work: Work) -> None:
            chunks_of(low, high, bricks, values.rows, batch, head, self.numbers, work, self.scratch[worker],
                      self.shading[worker])  # fmt: skip

        return self.over_chunks(batch, look)

    def _scattered(self, work: Work, rough: Variation) -> Gradient:
        """Adds the slopes of samples and of the variation to those of their rows."""
        room, sums, numbers = self._room, work.metrics.sum(0), self.numbers
        rays = max(sums[RAYS], 1.0)
        scale, bounds = np.float32(rays), self._ranges(work, room)

        def gather(_: int, part: int) -> None:
            gather_slopes(work, room, rough, scale, self.slopes, self.marks, bounds[part], bounds[part + 1])

        self.workers.share(len(bounds) - 1, gather)
        weights, norms = self.settings.variation, rough.sums.sum(0) / max(len(rough.near), 1)
        metrics = {
            "mse": sums[SQUARED] / (3 * rays),
            "sparsity": float(numbers.sparsity) * sums[PENALTY] / rays,
            "variation": weights[0] * norms[0] + weights[1] * norms[1],
            "distortion": float(numbers.scatter) * sums[SCATTER] / rays,
        }
        metrics["loss"] = sums[COLOUR] / rays + metrics["sparsity"] + metrics["variation"] + metrics["distortion"]
        metrics |= {"rays": rays, "samples": sums[SAMPLES]}
        return Gradient(work.head.sum(0), rays, metrics)

    def adam(
        self, values: Values, first: Values, second: Values, gradient: Gradient, updates: int, decay: float
    ) -> None:
        """Moves values and moments in place by the gradient that `differentiate` left; updates: how many came before."""
        beta1, beta2 = ADAM_BETAS
        correction = np.sqrt(1 - beta2 ** (updates + 1)) / (1 - beta1 ** (updates + 1)) * decay
        density, colours, head_rate = (np.float32(rate * correction) for rate in self.settings.rates)
        rates = np.array([[density, *[colours] * 7]], np.float32)
        scale = np.float32(1.0 / gradient.rays)
        rows = len(values.rows)
        count = self.workers.count * 2
        bounds = [*(rows * i // count // WORD * WORD for i in range(count)), rows]

        def move(_: int, part: int) -> None:
            adam_rows(values.rows, first.rows, second.rows, self.slopes, self.marks, rates, scale, bounds[part],
                      bounds[part + 1])  # fmt: skip

        self.workers.share(count, move)
        if values.head.size:
            slope = gradient.head * scale
            first.head[:] += np.float32(1 - beta1) * (slope - first.head)
            second.head[:] += np.float32(1 - beta2) * (np.square(slope) - second.head)
            values.head[:] -= head_rate * first.head / np.sqrt(second.head + np.float32(1e-20))

    def remember_depths(self, values: Values) -> None:
        """The bricks remember their cells' optical depths as they are now; `march` ends by these."""
        settings, bricks = self.settings, self.grid.bricks
        thickness = np.float32(settings.step_voxels * self.grid.voxel.max())
        slots, size = len(bricks.base), 512

        def look(_: int, part: int) -> None:
            remember(bricks, values.rows, np.float32(settings.shift), np.float32(settings.reference), thickness,
                     np.float32(DEPTH_UNITS), DEEPEST, part * size, min((part + 1) * size, slots))  # fmt: skip

        self.workers.share(-(-slots // size), look)

    def mean_samples(self, values: Values, batch: Batch) -> float:
        """Samples a ray of a batch has."""
        return float(self.render(values, batch, "march").counts.sum() / max(len(batch.start), 1))

    def meets(self, batch: Batch) -> np.ndarray:
        """bool [N]: which rays of a batch have support at any of their samples, wherever these begin."""
        meets, size = np.zeros(len(batch.start), bool), 16 * CHUNK
        step = np.float32(0.5 * self.settings.step_voxels)

        def look(_: int, part: int) -> None:
            rays_meet(self.grid.bricks, batch, step, meets, part * size, min((part + 1) * size, len(meets)))

        self.workers.share(-(-len(meets) // size), look)
        return meets

    def blank_weights(self) -> tuple[np.ndarray, np.ndarray]:
        """For `weigh`: zeros [T, V + 1], float32 and int64, one row for each worker."""
        shape = self.workers.count, len(self.grid.order)
        return np.zeros(shape, np.float32), np.zeros(shape, np.int64)

    def weigh(self, values: Values, batch: Batch, best: np.ndarray, total: np.ndarray) -> None:
        """Raises `best` to the weights of a batch's samples by the voxel they lie in, and adds these to `total`."""
        weighed = np.zeros(-(-len(batch.start) // CHUNK), bool)  # chunks that are not to be counted again

        def look(worker: int, low: int, high: int, work: Work) -> None:
            weigh(low, high, self.grid.bricks, values.rows, batch, self.numbers, work, self.scratch[worker],
                  (best[worker], total[worker], weighed))  # fmt: skip

        self.over_chunks(batch, look)

    def interpolate(self, values: Values, points: np.ndarray) -> np.ndarray:
        """Raw values float32 [N, 8] at world points float32 [N, 3]."""
        raw, size, grid = np.empty((len(points), 8), np.float32), 4096, self.grid

        def look(_: int, part: int) -> None:
            low, high = part * size, min((part + 1) * size, len(points))
            interpolate(grid.bricks, values.rows, grid.origin, grid.voxel, points, raw, low, high)

        self.workers.share(-(-len(points) // size), look)
        return raw

    def resampled(self, values: Values, grid: Grid) -> np.ndarray:
        """Raw values float32 [V' + 1, 8] at the centres of another grid's voxels, by its rows."""
        coordinates = grid.bricks.coordinates
        rows = np.zeros((len(coordinates), 8), np.float32)
        for low in range(1, len(rows), POINTS_TOGETHER):
            padded = coordinates[low : low + POINTS_TOGETHER]
            centres = (padded - np.float32(0.5)) * grid.voxel.astype(np.float32) + grid.origin.astype(np.float32)
            rows[low : low + POINTS_TOGETHER] = self.interpolate(values, centres)
        return rows

    def query(self, values: Values, points: np.ndarray) -> np.ndarray:
        """float32 [N, 8] at world points float32 [N, 3]: density (0 without support), colours and features in [0, 1]."""
        field, size, grid, numbers = np.empty((len(points), 8), np.float32), 4096, self.grid, self.numbers

        def look(_: int, part: int) -> None:
            low, high = part * size, min((part + 1) * size, len(points))
            interpolate(grid.bricks, values.rows, grid.origin, grid.voxel, points, field, low, high)
            activate(grid.bricks, grid.origin, grid.voxel, points, numbers.shift, numbers.reference, field, low, high)

        self.workers.share(-(-len(points) // size), look)
        return field

    def take(self, origins: np.ndarray, directions: np.ndarray, near: np.ndarray, far: np.ndarray) -> Batch:
        """Rays of the training frame, [N, 3] and [N], in the grid's frame; samples as the viewer takes them."""
        grid, batch = self.grid, empty_batch(len(near), coloured=False)
        batch.phase[:] = 0.5
        take_rays(origins, directions, near, far, grid.origin, grid.voxel, grid.bricks.dims, batch, 0, len(near))
        return batch

    def gather(self, values: Values, batch: Batch) -> np.ndarray:
        """float32 [N, 9] of a batch: accumulated colours and features (7), T behind each ray, and the sum of weights times t;
        to the last sample, however little light is left."""
        gathered = np.empty((len(batch.start), 9), np.float32)
        numbers = self.numbers._replace(last_depth=np.int64(NEVER))

        def look(worker: int, low: int, high: int, work: Work) -> None:
            gather_rays(low, high, self.grid.bricks, values.rows, batch, numbers, work, self.scratch[worker],
                        self.shading[worker], gathered)  # fmt: skip

        self.over_chunks(batch, look)
        return gathered

    def over_chunks(self, batch: Batch, look: Callable[[int, int, int, Work], None]) -> Work:
        """What look(worker, low, high, work) leaves of each chunk low … high - 1 of a batch's rays.

        Where a chunk was full, all is done again with more room: `look` must bear that. What it leaves does not depend on the
        room. The longest rays that there can be would ask for some hundred times of what is needed, gigabytes that a system
        may refuse even though nobody touches them.
        """
        chunks = -(-len(batch.start) // CHUNK)
        while True:
            if self._work is None or len(self._work.counts) < chunks:
                self._work = make_work(chunks, self._room)
            work = self._work
            work = work._replace(counts=work.counts[:chunks], metrics=work.metrics[:chunks], head=work.head[:chunks])

            def share(worker: int, part: int, work: Work = work) -> None:
                look(worker, part * CHUNKS_AT_ONCE, min((part + 1) * CHUNKS_AT_ONCE, chunks), work)

            self.workers.share(-(-chunks // CHUNKS_AT_ONCE), share)
            if self._room == self._most or work.counts.max(initial=0) < self._room:
                return work
            self._give_room(min(2 * self._room, self._most))

    def _give_room(self, samples: int) -> None:
        """Room for so many samples a chunk from now on."""
        self._room, self._work = samples, None
        self.scratch = [make_scratch(samples) for _ in range(self.workers.count)]

    def _variation(self, values: Values, picked: np.ndarray) -> Variation:
        count, size = len(picked), 64 * WINDOW
        parts = -(-count // size)
        rough = Variation(
            np.zeros((count, 4), np.int32), np.empty((4 * count, 8), np.float32), np.zeros((max(parts, 1), 2))
        )
        density, colours = self.settings.variation
        weights = (np.array([density, *[colours] * 7]) / max(count, 1)).astype(np.float32)

        def look(_: int, part: int) -> None:
            low, high = part * size, min((part + 1) * size, count)
            variation(self.grid.bricks, values.rows, picked, weights, part, rough, low, high)

        self.workers.share(parts, look)
        return rough

    def _ranges(self, work: Work, room: int) -> np.ndarray:
        """Ranges of rows, one a worker, that hold about the same number of samples: quantiles of a few. Bounds are multiples
        of 64, so that no two workers share a word of marks."""
        rows, count = len(self.slopes), self.workers.count
        some = [work.ids[c * room : c * room + min(work.counts[c], 512) : 16].ravel() for c in range(len(work.counts))]
        drawn = np.concatenate(some)
        drawn = drawn[drawn > 0]
        inner = np.quantile(drawn, np.arange(1, count) / count) if drawn.size else np.zeros(count - 1)
        bounds = np.concatenate([[0], np.minimum(np.round(inner / 64) * 64, rows // 64 * 64), [rows]])
        return bounds.astype(np.int64)
