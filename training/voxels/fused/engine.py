"""training.voxels.engine.Engine by the fused loops: one process, one machine, its processor's cores.

What is random about a step comes from (seed, step) through NumPy's generators, so that a run repeats itself whatever the
number of threads, and goes on from a checkpoint to the byte. It draws other rays than the JAX engine does.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from training.arrays import aligned
from training.dataset import RayDataset
from training.method import FieldOutput, Rays, RenderOutput, ViewMlpParams
from training.voxels.field import finished, shade
from training.voxels.fused.bricks import present_of
from training.voxels.fused.grid import Grid, grid_of, grid_over, layout_of
from training.multires.fused.rays import Batch, photographs_of
from training.voxels.fused.step import PROBE_RAYS, Stepper, Values
from training.voxels.fused.survey import WEIGHT_UNITS
from training.multires.fused.workers import Workers
from training.voxels.saving import save
from training.voxels.settings import Plan, Settings
from training.voxels.smoothness import WINDOW
from training.voxels.sparse_grid import Occupancy
from training.voxels.state import Trainable, VoxelState, ray_ids

SURVEYED_TOGETHER = 16_384  # rays that are looked at together between steps
SMOOTHED = 0.25  # voxels, at most, whose variation is looked at for each sample of a step
RAYS_TOGETHER = 64  # the number of rays of a step is a multiple of this


class FusedState:
    """A VoxelState in the order of the fused loops, which change it in place; made of `plain` when somebody first asks.

    plain: the same as plain arrays, as far as they are known; None once a step has changed something.
    """

    def __init__(self, plain: VoxelState) -> None:
        self.plain: VoxelState | None = plain
        self.updates, self.rays, self.step_voxels = int(plain.updates), plain.rays, plain.step_voxels
        self.closed = plain.closed
        self.gains = None if plain.gains is None else np.array(plain.gains, np.float32)
        self.hits, self.hit_count = np.asarray(plain.hits)[: int(plain.hit_count)], int(plain.hit_count)
        self.stepper: Stepper | None = None

    def unpack(self, settings: Settings, workers: Workers) -> Stepper:
        """Takes the plain arrays over; later calls return the same loops."""
        if self.stepper is None:
            assert self.plain is not None
            layout = self.plain.layout
            grid = grid_of(self.plain.cells, layout.support, layout.dims, layout.origin, layout.voxel)
            parts = [self.plain.second, self.plain.first, self.plain.trainable]
            self.plain = None
            self.values, self.first, self.second = (_values(parts.pop(), grid.order) for _ in range(3))
            self.stepper = Stepper(grid, settings._replace(step_voxels=self.step_voxels), workers)
        return self.stepper

    def sample_finer(self, step_voxels: float, settings: Settings, workers: Workers) -> None:
        """Takes samples so many voxels apart from now on."""
        grid = self.unpack(settings, workers).grid
        self.step_voxels, self.plain = step_voxels, None
        self.stepper = Stepper(grid, settings._replace(step_voxels=step_voxels), workers)

    def move(self, grid: Grid, source: np.ndarray | None, settings: Settings, workers: Workers) -> None:
        """Goes over to another grid. source int [V + 1]: the row of this one that each row of it has, moments included; None
        where values are interpolated and their moments begin anew. Old arrays are given up as new ones take their place."""
        stepper = self.unpack(settings, workers)
        self.plain = None
        rows = stepper.resampled(self.values, grid) if source is None else self.values.rows[source]
        self.values = self.values._replace(rows=rows)
        del stepper
        self.stepper = None
        for name in ("first", "second"):
            moment: Values = getattr(self, name)
            setattr(self, name, moment._replace(rows=np.zeros_like(rows) if source is None else moment.rows[source]))
        self.stepper = Stepper(grid, settings._replace(step_voxels=self.step_voxels), workers)

    def pack(self) -> VoxelState:
        """The state as plain arrays, in the layout's own order."""
        if self.plain is None:
            self.plain = self._packed(dense=True)
        return self.plain

    def to_save(self) -> VoxelState:
        """The same without the dense tables of the layout that a checkpoint does not hold: hundreds of megabytes at 512³."""
        return self.plain or self._packed(dense=False)

    def _packed(self, dense: bool) -> VoxelState:
        assert self.stepper is not None
        grid = self.stepper.grid
        layout, cells = layout_of(grid, dense)
        return VoxelState(
            *(_trainable(part, grid) for part in (self.values, self.first, self.second)),
            updates=jnp.int32(self.updates), layout=layout, cells=cells, hits=jnp.asarray(self.hits),
            hit_count=jnp.int32(self.hit_count), sizes=None, rays=self.rays, step_voxels=self.step_voxels,
            closed=self.closed, gains=self.gains,
        )  # fmt: skip


class FusedEngine:
    """See training.voxels.engine.Engine. threads: None for all cores."""

    def __init__(
        self, dataset: RayDataset, plan: Plan, settings: Settings, seed: int, threads: int | None = None
    ) -> None:
        self.photographs, self.plan, self.settings, self.seed = photographs_of(dataset), plan, settings, seed
        self.workers = Workers(threads)

    def begin(self, state: VoxelState) -> FusedState:
        return FusedState(state)

    def end(self, state: FusedState) -> VoxelState:
        return state.pack()

    def arrays(self, state: FusedState) -> dict[str, np.ndarray]:
        return save(state.to_save())

    def step(self, state: FusedState, step: int, progress: float) -> tuple[FusedState, dict[str, Any]]:
        *_, (_, made) = self.parts(state, step, progress)
        return made

    def parts(self, state: FusedState, step: int, progress: float) -> Iterator[tuple[str, Any]]:
        """A step part by part, in order: after each, its name and what it leaves. The last is ("adam", (state, metrics))."""
        stepper = state.unpack(self.settings, self.workers)
        random = np.random.default_rng((self.seed, step))
        batch = self.draw(state, random, state.rays)
        yield "draw", batch
        picked = windows(random, len(state.values.rows) - 1, self._smoothed(len(state.values.rows)))
        gradient: Any = None
        for name, gradient in stepper.gradient_parts(state.values, batch, picked):
            yield name, gradient
        decay = self.settings.final_rate_factor**progress
        stepper.adam(state.values, state.first, state.second, gradient, state.updates, decay)
        state.updates += 1
        state.plain = None
        yield "adam", (state, gradient.metrics | {"psnr": -10.0 * float(np.log10(max(gradient.metrics["mse"], 1e-12)))})

    def gains(self, state: FusedState) -> np.ndarray | None:
        return state.gains

    def with_gains(self, state: FusedState, gains: np.ndarray) -> FusedState:
        state.gains = gains
        if state.plain is not None:
            state.plain = state.plain._replace(gains=gains)
        return state

    def remember(self, state: FusedState) -> FusedState:
        """As the protocol says; and draws as many rays a step from then on as fill it."""
        stepper = state.unpack(self.settings, self.workers)
        stepper.remember_depths(state.values)
        random = np.random.default_rng((self.seed, state.updates, PROBE_RAYS))
        mean = stepper.mean_samples(state.values, self.draw(state, random, PROBE_RAYS))
        rays = int(np.clip(self.plan.samples / max(mean, 1.0), 256, self.plan.most_rays))
        state.rays = -(-rays // RAYS_TOGETHER) * RAYS_TOGETHER
        state.plain = None
        return state

    def sample_finer(self, state: FusedState, step_voxels: float) -> FusedState:
        state.sample_finer(step_voxels, self.settings, self.workers)
        return state

    def occupancy(self, state: FusedState) -> Occupancy:
        grid = state.unpack(self.settings, self.workers).grid
        return Occupancy(present_of(grid.bricks), grid.origin, grid.voxel)

    def drawn(self, state: FusedState) -> tuple[np.ndarray, int]:
        return state.hits, state.hit_count

    def meeting(self, state: FusedState, ids: np.ndarray) -> np.ndarray:
        stepper = state.unpack(self.settings, self.workers)
        meets = np.zeros(len(ids), bool)
        for low in range(0, len(ids), SURVEYED_TOGETHER):
            some = ids[low : low + SURVEYED_TOGETHER]
            meets[low : low + len(some)] = stepper.meets(self._survey(stepper, some))
        return meets

    def visible_weights(self, state: FusedState, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        stepper = state.unpack(self.settings, self.workers)
        best, total = stepper.blank_weights()
        for low in range(0, len(ids), SURVEYED_TOGETHER):
            batch = self._survey(stepper, ids[low : low + SURVEYED_TOGETHER])
            stepper.weigh(state.values, batch, best, total)
        by_row = np.empty((2, len(stepper.grid.order)), np.float32)
        by_row[:, stepper.grid.order] = best.max(0), total.sum(0) / WEIGHT_UNITS
        return by_row[0], by_row[1]

    def regrid(self, state: FusedState, occupancy: Occupancy, kept: np.ndarray | None) -> FusedState:
        old, grid = state.unpack(self.settings, self.workers).grid, grid_over(occupancy)
        source = None
        if kept is not None:
            row_of_old = np.empty(len(old.order), np.int32)
            row_of_old[old.order] = np.arange(len(old.order), dtype=np.int32)
            source = row_of_old[kept[grid.order]]
        state.move(grid, source, self.settings, self.workers)
        return state

    def draw_from(self, state: FusedState, hits: np.ndarray, hit_count: int) -> FusedState:
        state.hits, state.hit_count, state.plain = np.asarray(hits), hit_count, None
        return state

    def view_mlp(self, state: FusedState) -> ViewMlpParams | None:
        state.unpack(self.settings, self.workers)
        return _view_mlp(state.values.head)

    def query(self, state: FusedState, points: jax.Array | np.ndarray) -> FieldOutput:
        values = state.unpack(self.settings, self.workers).query(state.values, np.asarray(points))
        return FieldOutput(values[:, 0], values[:, 1:4], values[:, 4:])  # type: ignore[arg-type]

    def render(self, state: FusedState, rays: Rays) -> RenderOutput:
        stepper = state.unpack(self.settings, self.workers)
        origins, directions, near, far = (np.asarray(a) for a in (rays.origins, rays.directions, rays.near, rays.far))
        gathered = np.empty((len(near), 9), np.float32)
        for low in range(0, len(near), SURVEYED_TOGETHER):
            some = slice(low, low + SURVEYED_TOGETHER)
            batch = stepper.take(origins[some], directions[some], near[some], far[some])
            gathered[some] = stepper.gather(state.values, batch)
        scale = np.linalg.norm(directions / stepper.grid.voxel, axis=-1)  # voxels per t
        return finished(shade(jnp.asarray(gathered), _view_mlp(state.values.head), rays.viewdirs, self.settings), scale)

    def _survey(self, stepper: Stepper, ids: np.ndarray) -> Batch:
        """Rays that are looked at, but not trained on; their samples as the viewer takes them."""
        return stepper.batch(self.photographs, ids.astype(np.int64), 0.5, None)

    def draw(self, state: FusedState, random: np.random.Generator, rays: int) -> Batch:
        """So many random rays of a state, in its grid's frame."""
        stepper = state.unpack(self.settings, self.workers)
        ids = ray_ids(state.hits, random.integers(0, state.hit_count, rays)).astype(np.int64)
        phase = random.random(rays, np.float32)
        background = random.random((rays, 3), np.float32)
        if not self.settings.random_background:
            background[:] = self.settings.background
        photographs = self.photographs if state.gains is None else self.photographs._replace(gains=state.gains)
        return stepper.batch(photographs, ids, phase, background)

    def _smoothed(self, rows: int) -> float:
        """The share of voxels whose variation is looked at in a step: as set, but never more work than the samples are."""
        return min(self.settings.variation_share, SMOOTHED * self.plan.samples / rows)


def windows(random: np.random.Generator, voxels: int, share: float) -> np.ndarray:
    """int32 [P] rows of random runs of voxels, about `share` of all; as training.voxels.smoothness.windows."""
    count = max(int(voxels * share / WINDOW), 1)
    starts = random.integers(0, voxels, (count, 1))
    return (1 + (starts + np.arange(WINDOW)) % voxels).ravel().astype(np.int32)


def _values(part: Trainable, order: np.ndarray) -> Values:
    """Copies, in the loops' order."""
    head = [np.zeros(0, np.float32)]
    if part.head is not None:
        head = [np.asarray(a, np.float32).ravel() for pair in zip(*part.head, strict=True) for a in pair]
    return Values(np.ascontiguousarray(np.asarray(part.rows, np.float32)[order]), np.concatenate(head))


def _trainable(values: Values, grid: Grid) -> Trainable:
    rows = aligned(values.rows.shape)
    rows[grid.order] = values.rows
    return Trainable(jnp.asarray(rows), _view_mlp(values.head))


def _view_mlp(flat: np.ndarray) -> ViewMlpParams | None:
    if not flat.size:
        return None
    weights, biases, start = [], [], 0
    for rows, columns in ((34, 16), (16, 16), (16, 3)):
        weights.append(jnp.asarray(flat[start : start + rows * columns].reshape(rows, columns)))
        biases.append(jnp.asarray(flat[start + rows * columns : start + (rows + 1) * columns]))
        start += (rows + 1) * columns
    return ViewMlpParams(tuple(weights), tuple(biases))  # type: ignore[arg-type]
