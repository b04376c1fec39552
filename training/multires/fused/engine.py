"""training.multires.method.Engine by the fused loops: one process, one machine, its processor's cores.

A step: chunks of rays give gradients of features at their samples; then each level adds these to its rows in the samples' order.
So a run repeats itself to the last bit whatever the number of threads, and goes on from a checkpoint alike.
"""

# pyright: reportCallIssue=false, reportArgumentType=false

import threading
from typing import Any

import jax.numpy as jnp
import numpy as np

from scenepack.constants import TRANSMITTANCE_SHADED, TRANSMITTANCE_STOP
from training.dataset import RayDataset, evenly_spread
from training.method import Rays, RenderOutput
from training.multires.field import HIDDEN, decoder_size, inputs_of, shade, split_parameters, view_mlp_of
from training.multires.fused import view_mlp as mlp
from training.multires.fused.chunk import (
    CHUNK,
    SAMPLED_BELOW,
    Field,
    Numbers,
    Output,
    Scratch,
    gather_chunk,
    make_scratch,
    query_points,
    smooth_chunk,
    train_chunks,
)
from training.multires.fused.compiled import Workers, kernel
from training.multires.fused.corners import BLOCK, MARKED_ROWS, scatter
from training.multires.fused.march import Grid, grid_of
from training.multires.fused.rays import Batch, empty_batch, fill_batch, photographs_of, take_rays
from training.multires.fused.vectors import LINE, adam_line
from training.multires.levels import HASHED, ROWS_OF_BRICK, Levels, absent_rows, decay_of_blocks, make_levels
from training.multires.occupancy import is_on, neighbouring_points
from training.multires.settings import ADAM_BETAS, ADAM_EPSILON, LARGEST_RAW, Settings
from training.multires.state import PARTS, State, Trainable

LINES = ROWS_OF_BRICK // MARKED_ROWS  # of a block
NEW_1, NEW_2, EPSILON = ADAM = tuple(
    np.float32(value) for value in (1 - ADAM_BETAS[0], 1 - ADAM_BETAS[1], ADAM_EPSILON)
)


@kernel
def move_marked(arrays, marks, decay, scale, rate, low, high):
    """Moves the blocks of rows low … high - 1 of flat arrays (values, moments, gradient), see adam_line: their marked lines,
    whose marks are taken away, and all of a block that has any and decays. decay: see levels.decay_of_blocks."""
    for block in range(low, high):
        lines, marked = range(block * LINES, (block + 1) * LINES), np.uint8(0)
        for line in lines:
            marked |= marks[line]
        if marked == 0:
            continue
        for line in lines:
            if marks[line] != 0 or decay[block] > 0:
                marks[line] = 0
                adam_line(arrays, line * LINE, scale, decay[block], rate, ADAM)


CHUNKS_TOGETHER = 4  # that a worker claims, and that share one sum of parameter gradients
POINTS_TOGETHER = 4096  # that are queried together
RENDERED_TOGETHER = 16_384  # rays
SPARE = 1.5, 8  # capacity of a chunk: times the mean of samples a ray, and so many more
PAIRS_TOGETHER = CHUNK * SPARE[1] // 2  # of points: as many as the smallest chunk can hold


class FusedEngine:
    """See training.multires.method.Engine. threads: None for all cores. sampled_below: see Numbers; 0 for exact gradients."""

    def __init__(
        self, dataset: RayDataset, settings: Settings, seed: int, threads: int | None = None,
        sampled_below: float = SAMPLED_BELOW,
    ) -> None:  # fmt: skip
        self.photographs, self.count = photographs_of(dataset), dataset.count
        self.settings, self.seed, self.sampled_below = settings, seed, sampled_below
        self.workers = Workers(threads)
        self.levels = len(settings.resolutions)
        self.inputs = inputs_of(self.levels)
        self.shading = [mlp.make_shading(CHUNK) for _ in range(self.workers.count)]
        self.scratch: list[Scratch] = []
        self._one_caller = threading.Lock()  # of those below that use `scratch`: a bake asks from many threads
        self._places_and_slopes = [np.empty(0, np.float32)] * 4  # memory for an Output
        self._spare = SPARE[0]

    def adopt(self, state: State) -> State:
        for name in PARTS:
            arrays = (np.require(np.asarray(a), np.float32, ["C", "W", "O"]) for a in getattr(state, name))
            setattr(state, name, Trainable(*arrays))
        state.kept = {}
        return state

    def step(self, state: State, step: int, progress: float) -> dict[str, Any]:
        batch = self.draw(state, step)
        output = self.differentiate(state, batch)
        gradient, marks = self.scatter(state, output)
        return self.move(state, output, gradient, marks, len(batch.start), progress)

    def move(
        self, state: State, output: Output, gradient: np.ndarray, marks: np.ndarray, rays: int, progress: float
    ) -> dict[str, Any]:
        """A step of Adam by what `scatter` returned of so many rays; the step's metrics."""
        metrics = self.metrics(state, output)
        self._adam(state, gradient, marks, self.parameter_gradient(output), metrics["rays"], progress)
        state.updates += 1
        state.next_ray += rays
        state.samples_per_ray += 0.2 * (max(metrics["samples"] / rays, 1.0) - state.samples_per_ray)
        return metrics

    def draw(self, state: State, step: int) -> Batch:
        """The rays of a step, in cells of the occupancy grid."""
        random, rays = np.random.default_rng((self.seed, step)), self.settings.rays(state.samples_per_ray)
        ids = evenly_spread(state.next_ray, rays, self.count)
        batch = empty_batch(rays, self.photographs.contraction)
        batch.phase[:] = random.random(rays, np.float32)
        batch.background[:] = self.settings.background
        if self.settings.random_background:
            batch.background[:] = random.random((rays, 3), np.float32)
        photographs = self.photographs if state.gains is None else self.photographs._replace(gains=state.gains)
        box = state.box

        def fill(_: int, low: int, high: int) -> None:
            fill_batch(photographs, ids, box.origin, box.cell, box.dims, batch, low, high)

        self.workers.share_range(rays, 16 * CHUNK, fill)
        if any(self.settings.smoothness):
            batch = batch._replace(pairs=neighbouring_points(self._derived(state)[2], self.settings, random))
        return batch

    def differentiate(self, state: State, batch: Batch) -> Output:
        """Samples, losses and gradients by sample of a batch."""
        chunks = -(-len(batch.start) // CHUNK)
        parts = -(-chunks // CHUNKS_TOGETHER)
        grid, numbers = self._derived(state)[0], self._numbers(state)
        field, pairs = self._field(state), batch.pairs
        of_pairs = -(-len(pairs) // PAIRS_TOGETHER)  # chunks, and parts
        while True:
            capacity = int(CHUNK * (self._spare * state.samples_per_ray + SPARE[1]))
            output = self._make_output(capacity, chunks + of_pairs, parts + of_pairs)

            def work(worker: int, low: int, high: int, output: Output = output) -> None:
                memory, part = (self.scratch[worker], self.shading[worker]), low // CHUNKS_TOGETHER
                train_chunks(low, high, part, grid, field, batch, numbers, *memory, output)

            self.workers.share_range(chunks, CHUNKS_TOGETHER, work)
            if output.counts.min() >= 0:
                break
            self._spare *= 1.5  # all is done again: what chunks leave does not depend on their capacity
        # the mean over pairs, as others are over rays
        scale = np.float32(output.metrics[:, mlp.RAYS].sum() / max(len(pairs), 1))

        def smooth(worker: int, low: int, high: int) -> None:
            chunk, part = (first + low // PAIRS_TOGETHER for first in (chunks, parts))
            smooth_chunk(chunk, part, pairs, low, high, scale, field, numbers, self.scratch[worker], output)

        self.workers.share_range(len(pairs), PAIRS_TOGETHER, smooth)
        return output

    def scatter(self, state: State, output: Output) -> tuple[np.ndarray, np.ndarray]:
        """The gradient [E, 4] of the table, summed over rays, and the marks of the lines that it is not zero in."""
        levels = self._derived(state)[1]
        gradient, marks = self._accumulators(state)
        slabs = self.workers.count
        joined = [int(level) for level in np.argsort(-levels.rows, kind="stable") if levels.offset[level] >= 0]

        def add(_: int, part: int) -> None:
            level, slab = joined[part // slabs], part % slabs
            planes = int(levels.resolution[level]) + 1
            low, high = planes * slab // slabs, planes * (slab + 1) // slabs
            if levels.place[level] != HASHED:
                scatter(levels, level, output, low, high, gradient, marks)
            elif slab == 0:  # its planes share rows: one worker adds them all
                scatter(levels, level, output, 0, planes, gradient, marks)

        self.workers.share(len(joined) * slabs, add)
        for rows in absent_rows(levels):
            gradient[rows] = 0.0
        return gradient, marks

    def parameter_gradient(self, output: Output) -> np.ndarray:
        """The gradient [P] of the parameters, summed over rays."""
        total, decoder = output.gradient.sum(0), decoder_size(self.inputs)
        return np.concatenate([total[:decoder], total[decoder:][mlp.PLACES]])

    def values_at(self, state: State, points: np.ndarray) -> np.ndarray:
        values = np.empty((len(points), 8), np.float32)
        points = np.ascontiguousarray(points, np.float32)
        field = self._field(state)

        def look(worker: int, low: int, high: int) -> None:
            query_points(field, np.float32(LARGEST_RAW), points, values, low, high, self.scratch[worker])

        with self._one_caller:
            self._make_scratch(CHUNK * SPARE[1])
            self.workers.share_range(len(points), POINTS_TOGETHER, look)
        return values

    def render(self, state: State, rays: Rays) -> RenderOutput:
        geometry = [np.asarray(a) for a in (rays.origins, rays.directions, rays.near, rays.far)]
        box, gathered, contraction = state.box, np.empty((len(rays.near), 8), np.float32), self.photographs.contraction
        for low in range(0, len(gathered), RENDERED_TOGETHER):
            some = slice(low, low + RENDERED_TOGETHER)
            batch = empty_batch(len(gathered[some]), contraction)
            batch.phase[:] = 0.5
            take_rays(*(a[some] for a in geometry), contraction, box.origin, box.cell, box.dims, batch)
            gathered[some] = self._gather(state, batch)
        background = jnp.asarray(self.settings.background, jnp.float32)
        view_mlp = view_mlp_of(state.values.parameters, self.settings)
        output = shade(jnp.asarray(gathered), view_mlp, rays.viewdirs, background)
        return output._replace(rgb=jnp.clip(output.rgb, 0, 1))

    def _gather(self, state: State, batch: Batch) -> np.ndarray:
        gathered, chunks = np.empty((len(batch.start), 8), np.float32), -(-len(batch.start) // CHUNK)
        grid, field = self._derived(state)[0], self._field(state)
        numbers, suffices = self._numbers(state), np.zeros(chunks, bool)
        capacity = int(CHUNK * (self._spare * state.samples_per_ray + SPARE[1]))
        while not suffices.all():

            def look(worker: int, chunk: int) -> None:
                if not suffices[chunk]:
                    suffices[chunk] = gather_chunk(chunk, grid, field, batch, numbers, self.scratch[worker], gathered)

            with self._one_caller:
                self._make_scratch(capacity)
                self.workers.share(chunks, look)
            capacity *= 2
        return gathered

    def _derived(self, state: State) -> tuple[Grid, Levels, np.ndarray, np.ndarray]:
        """What the loops need of codes and bricks: grid, levels, which cells are occupied, and decay by block."""
        if state.kept.get("of") != (id(state.codes), id(state.bricks)):
            state.kept["of"] = id(state.codes), id(state.bricks)
            on, levels = is_on(state.codes), make_levels(self.settings.resolutions, state.bricks)
            decay = decay_of_blocks(levels, self.settings.by_kind.feature_decay)
            state.kept["derived"] = grid_of(on), levels, np.flatnonzero(on), decay
        return state.kept["derived"]

    def _accumulators(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """The table's gradient, zero between steps, and the marks of its lines."""
        if "accumulators" not in state.kept:
            rows = len(state.values.table)
            state.kept["accumulators"] = np.zeros((rows, 4), np.float32), np.zeros(rows // MARKED_ROWS, np.uint8)
        return state.kept["accumulators"]

    def _adam(
        self, state: State, gradient: np.ndarray, marks: np.ndarray, of_parameters: np.ndarray, rays: float, progress: float
    ) -> None:  # fmt: skip
        table_rate, decoder_rate, view_rate = self.settings.rates_at(state.updates, progress)
        flat = tuple(a.reshape(-1) for a in (state.values.table, state.first.table, state.second.table, gradient))
        decay = np.float32(self.settings.decay_left(progress)) * self._derived(state)[-1]
        scale, share = np.float32(1.0 / rays), -(-len(decay) // (4 * self.workers.count))

        def move(_: int, low: int, high: int) -> None:
            move_marked(flat, marks, decay, scale, np.float32(table_rate), low, high)

        self.workers.share_range(len(decay), share, move)
        value, first, second = state.values.parameters, state.first.parameters, state.second.parameters
        slope = of_parameters * scale
        first += NEW_1 * (slope - first)
        second += NEW_2 * (np.square(slope) - second)
        rates = np.full(len(value), view_rate, np.float32)
        rates[: decoder_size(self.inputs)] = decoder_rate
        value -= rates * first / (np.sqrt(second) + EPSILON)

    def metrics(self, state: State, output: Output) -> dict[str, Any]:
        sums = output.metrics.sum(0)
        rays = max(sums[mlp.RAYS], 1.0)
        spread = self.settings.by_kind.distortion_weight / self.settings.resolution * sums[mlp.DISTORTION] / rays
        mse = sums[mlp.SQUARED] / (3 * rays)
        sparsity = self.settings.sparsity * state.box.cell[0] * self.settings.resolution * sums[mlp.SPARSITY] / rays
        loss = (sums[mlp.COLOUR] + sums[mlp.SMOOTHNESS]) / rays + spread + sparsity
        return {
            "loss": loss if np.isfinite(output.gradient).all() else np.nan, "mse": mse, "distortion": spread,
            "sparsity": sparsity, "smoothness": sums[mlp.SMOOTHNESS] / rays, "psnr": -10 * np.log10(max(mse, 1e-12)),
            "rays": rays, "samples": sums[mlp.SAMPLES],
        }  # fmt: skip

    def _numbers(self, state: State) -> Numbers:
        f, settings = np.float32, self.settings
        side, distortion = settings.resolution, settings.by_kind.distortion_weight
        return Numbers(
            f(state.step_cells), f(state.box.cell[0] * side), f(distortion / side), f(settings.sparsity),
            f(settings.sparsity_scale), f(LARGEST_RAW), f(TRANSMITTANCE_STOP), f(TRANSMITTANCE_SHADED),
            np.int64(settings.by_kind.view_octaves), settings.own.view_dependence,
            decoder_size(self.inputs), (8 + self.inputs + 1) * HIDDEN,
            (f(settings.smoothness[0]), f(settings.smoothness[1])), f(1 / settings.resolutions[-1]),
            f(self.sampled_below), f(settings.near), f(settings.whole_from),
        )  # fmt: skip

    def _field(self, state: State) -> Field:
        """A state's values as the loops have them."""
        flat, decoder = state.values.parameters, decoder_size(self.inputs)
        view_mlp = mlp.packed(flat[decoder:])
        w0, b0, w1, *_ = split_parameters(flat, self.inputs)
        turned = np.concatenate([w1.T.ravel(), w0.T.ravel(), np.zeros_like(b0), mlp.turned(view_mlp)])
        parameters = np.concatenate([flat[:decoder], view_mlp])
        return Field(self._derived(state)[1], state.values.table, parameters, turned, self.inputs)

    def _make_scratch(self, capacity: int) -> None:
        capacity = -(-capacity // BLOCK) * BLOCK + BLOCK
        if not self.scratch or self.scratch[0].ray.size < capacity:
            self.scratch = [make_scratch(capacity, self.levels, self.inputs) for _ in range(self.workers.count)]

    def _make_output(self, capacity: int, chunks: int, parts: int) -> Output:
        """An output for so many chunks, of at least this capacity each."""
        self._make_scratch(capacity)
        samples, parameters = chunks * (self.scratch[0].ray.size - BLOCK), decoder_size(self.inputs) + mlp.SIZE
        sizes = samples, samples, samples, self.levels * samples * 4
        if len(self._places_and_slopes[0]) < samples:
            self._places_and_slopes = [np.empty(size + size // 4, np.float32) for size in sizes]
        kept = (array[:size] for array, size in zip(self._places_and_slopes, sizes, strict=True))
        metrics, gradient = np.zeros((chunks, mlp.METRICS)), np.zeros((parts, parameters), np.float32)
        return Output(np.zeros(chunks, np.int64), *kept, metrics, gradient)
