"""training.multires.method.Engine in JAX: the definition of training.multires.field as a program for any devices.

Samples are spread over the devices of the dataset's mesh. Lists have a fixed length, so that a program is compiled once for each
size: sizes are rounded up, and looked at again where the occupancy grid changes.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding

from training.dataset import RayDataset, evenly_spread
from training.devices import WHOLE, agree, here, put_whole, split
from training.marching import (
    COARSE,
    Cells,
    GridBox,
    MarchSizes,
    Samples,
    coarse_occupancy,
    dilate,
    march,
    occupied_segments,
    segments_across,
    to_grid,
)
from training.method import Rays, RenderOutput
from training.multires import field
from training.multires.levels import FEATURES, ROWS_OF_BRICK, decay_of_blocks, make_levels
from training.multires.occupancy import is_on, neighbouring_points
from training.multires.settings import ADAM_BETAS, ADAM_EPSILON, Settings
from training.multires.state import PARTS, State, Trainable
from training.rendering import psnr_of

LISTED = 2  # capacity of the lists, in samples of a step: what lies behind a surface is listed, too
PROBE_RAYS = 4096  # whose sample counts set the sizes of lists
HEADROOM = 1.15  # lists are this much longer than the mean asks for
RENDER_RAYS, RENDER_SAMPLES = 4096, 262_144
POINTS = 131_072  # that are queried together


class Constants(NamedTuple):
    """What a program is compiled for."""

    levels: tuple[field.Level, ...]
    sizes: MarchSizes
    rays: int  # that fill these lists
    step_cells: float
    settings: Settings


def cells_of(state: State, contraction: float | None = None) -> Cells:
    """The occupancy grid of a state. contraction: see training.marching.GridBox."""
    occupied = is_on(state.codes).astype(np.uint8)
    side = occupied.shape[0]
    # a run of COARSE steps is tested at its middle: steps of up to two cells reach two cells further
    near = dilate(dilate(occupied)) if state.step_cells > 1 else occupied
    coarse = coarse_occupancy(near)
    origin, cell = (jnp.asarray(lengths, jnp.float32) for lengths in (state.box.origin, state.box.cell))
    inner = None if contraction is None else jnp.float32(contraction)
    return Cells(
        GridBox(origin, cell, jnp.asarray(state.box.dims), inner), jnp.asarray(occupied.ravel()), jnp.int32(side),
        jnp.asarray(coarse.ravel()), jnp.asarray(coarse.shape[::-1], jnp.int32),
    )  # fmt: skip


Optimised = tuple[Trainable, Trainable, Trainable]  # values, and Adam's first and second moments of them


def update(
    optimised: Optimised, cells: Cells, maps: jax.Array, decay: jax.Array, pairs: jax.Array, ids: jax.Array, dataset: RayDataset,
    key: jax.Array, rates: jax.Array, *, constants: Constants,
) -> tuple[Optimised, dict[str, jax.Array]]:  # fmt: skip
    """One step, on training rays int32 [R]. decay: see training.multires.levels.decay_of_blocks. pairs [M, 2, 3]: of points that
    the smoothness loss compares. rates [3]: Adam's, of table, decoder and view MLP."""
    samples, target = draw(cells, dataset, ids, key, constants)
    samples, pairs = split((samples, pairs), dataset.mesh)
    gradient, metrics = loss_and_gradient(optimised[0], maps, samples, target, pairs, constants)
    return adam(optimised, gradient, decay, rates, constants), metrics


def draw(
    cells: Cells, dataset: RayDataset, ids: jax.Array, key: jax.Array, constants: Constants
) -> tuple[Samples, field.Target]:  # fmt: skip
    """Samples of training rays int32 [R], and what these should show."""
    settings, rays = constants.settings, constants.rays
    phase_key, colour_key = jax.random.split(key)
    background = jax.random.uniform(colour_key, (rays, 3))
    if not settings.random_background:
        background = jnp.broadcast_to(jnp.asarray(settings.background), (rays, 3))
    seen, colours = split((dataset.geometry_at(ids), dataset.colours_at(ids, background)), dataset.mesh)
    return sampled(cells, seen, colours, background, jax.random.uniform(phase_key, (rays,)), constants)


def sampled(
    cells: Cells, rays: Rays, colours: jax.Array, background: jax.Array, phase: jax.Array, constants: Constants
) -> tuple[Samples, field.Target]:  # fmt: skip
    """Samples of rays [N], with a phase [N] in steps, and their target."""
    in_grid = to_grid(cells.box, rays)
    samples = march(cells, in_grid, phase, constants.sizes, constants.step_cells)
    side = cells.box.voxel[0] * constants.settings.resolution
    step_lengths = constants.step_cells * in_grid.length / side
    shares = gradient_shares(samples, in_grid.length, constants.settings)
    return samples, field.Target(rays.viewdirs, colours, background, step_lengths, side, shares)


def gradient_shares(samples: Samples, lengths: jax.Array, settings: Settings) -> jax.Array:
    """How much of its gradient each sample keeps, float32 [S]: see Settings. lengths [N]: world units per voxel."""
    if settings.whole_from == 0:
        return jnp.ones(len(samples.t))
    away = settings.near + samples.t * lengths[samples.ray]
    return jnp.square(jnp.minimum(away / settings.whole_from, 1.0))


def loss_and_gradient(
    values: Trainable, maps: jax.Array, samples: Samples, target: field.Target, pairs: jax.Array, constants: Constants
) -> tuple[Trainable, dict[str, jax.Array]]:  # fmt: skip
    """The gradient of a batch's loss, and its metrics; jittable."""

    def loss_of(values: Trainable) -> tuple[jax.Array, dict[str, jax.Array]]:
        return field.loss(
            *values, constants.levels, maps, samples, target, pairs, jnp.float32(constants.step_cells),
            constants.sizes, constants.settings,
        )  # fmt: skip

    (value, metrics), gradient = jax.value_and_grad(loss_of, has_aux=True)(values)
    return gradient, metrics | {"loss": value, "psnr": psnr_of(metrics["mse"])}


def adam(
    optimised: Optimised, gradient: Trainable, decay: jax.Array, rates: jax.Array, constants: Constants
) -> Optimised:  # fmt: skip
    """Adam; a feature without a gradient is left alone, moments included (DVGO's masked Adam). Features decay only in blocks of
    rows that a sample of the step meets. decay: see update."""
    (values, first, second), (keep1, keep2) = optimised, ADAM_BETAS
    decoder = field.decoder_size(field.inputs_of(len(constants.levels)))
    of_parameters = jnp.where(jnp.arange(gradient.parameters.size) < decoder, rates[1], rates[2])
    unseen = np.zeros(gradient.parameters.size, bool)  # weights of inputs that the view MLP does not have
    unseen[decoder : decoder + 34 * 16] = np.repeat(~field.seen_inputs(constants.settings.by_kind.view_octaves), 16)

    def move(value, slope, one, two, rate, seen):
        new_one = jnp.where(seen, one + (1 - keep1) * (slope - one), one)
        new_two = jnp.where(seen, two + (1 - keep2) * (jnp.square(slope) - two), two)
        return jnp.where(seen, value - rate * new_one / (jnp.sqrt(new_two) + ADAM_EPSILON), value), new_one, new_two

    slopes, blocks, of_block = gradient.table, (-1, ROWS_OF_BRICK * FEATURES), decay[:, None]
    met = (of_block >= 0) & (slopes.reshape(blocks) != 0).any(1, keepdims=True)
    slopes = jnp.where(met, slopes.reshape(blocks) + of_block * values.table.reshape(blocks), 0.0).reshape(slopes.shape)
    tables = move(values.table, slopes, first.table, second.table, rates[0], slopes != 0)
    slope = jnp.where(unseen, 0.0, gradient.parameters)
    parameters = move(values.parameters, slope, first.parameters, second.parameters, of_parameters, ~unseen)
    return tuple(map(Trainable, tables, parameters))  # type: ignore[return-value]


class JaxEngine:
    """See training.multires.method.Engine."""

    def __init__(self, dataset: RayDataset, settings: Settings, seed: int) -> None:
        self.dataset, self.settings, self.seed, self.key = dataset, settings, seed, jax.random.key(seed)
        # the trainable values and their moments are given away
        whole = NamedSharding(dataset.mesh, WHOLE)
        self._update: Any = jax.jit(update, static_argnames="constants", donate_argnums=0, out_shardings=whole)
        self.geometry = dataset.local()  # what happens between steps needs no pixels, and each process does it alike

    def adopt(self, state: State) -> State:
        for name in PARTS:
            arrays = (jnp.asarray(a) for a in getattr(state, name))
            setattr(state, name, put_whole(Trainable(*arrays), self.dataset.mesh))
        state.kept = {}
        return state

    def step(self, state: State, step: int, progress: float) -> dict[str, Any]:
        mesh, (cells, maps, decay, *_) = self.dataset.mesh, self._derived(state)
        decay = decay * np.float32(self.settings.decay_left(progress))
        dataset = self.dataset.in_average_look(state.gains)
        rates = np.array(self.settings.rates_at(state.updates, progress), np.float32)
        constants, key = self._constants(state), jax.random.fold_in(self.key, step)
        ids = evenly_spread(state.next_ray, constants.rays, dataset.count)
        optimised, metrics = self._update(
            (state.values, state.first, state.second), *put_whole((cells, maps, decay, self.pairs(state, step), ids), mesh),
            dataset, key, rates, constants=constants,
        )  # fmt: skip
        state.values, state.first, state.second = optimised
        state.updates += 1
        state.next_ray += constants.rays
        return metrics

    def pairs(self, state: State, step: int) -> jax.Array:
        """The pairs of points of a step's smoothness loss; the same in every process."""
        if not any(self.settings.smoothness):
            return jnp.zeros((0, 2, 3))
        random = np.random.default_rng((self.seed, step, 3))
        return jnp.asarray(neighbouring_points(self._derived(state)[-1], self.settings, random))

    def values_at(self, state: State, points: np.ndarray) -> np.ndarray:
        _, maps, _, levels, _ = self._derived(state)
        values, padded = np.empty((len(points), 8), np.float32), np.zeros((POINTS, 3), np.float32)
        trained = here(state.values)
        for low in range(0, len(points), POINTS):
            some = points[low : low + POINTS]
            padded[: len(some)] = some
            values[low : low + POINTS] = _values_at(*trained, maps, jnp.asarray(padded), levels)[: len(some)]
        return values

    def render(self, state: State, rays: Rays) -> RenderOutput:
        cells, maps, _, levels, _ = self._derived(state)
        segments = segments_across(state.box.dims, state.step_cells)
        sizes = MarchSizes(segments, RENDER_SAMPLES, RENDER_SAMPLES, segments * COARSE)
        constants = Constants(levels, sizes, RENDER_RAYS, state.step_cells, self.settings)
        trained, host = here(state.values), [np.asarray(array) for array in rays]
        parts, start, count = [], 0, len(host[0])
        while start < count:
            places = np.minimum(np.arange(start, start + RENDER_RAYS), count - 1)
            some = Rays(*(jnp.asarray(array[places]) for array in host))
            output, complete = _render_chunk(trained, cells, maps, some, constants)
            whole = np.asarray(complete)
            # what follows the first ray whose samples did not fit is rendered again; a ray that never fits is passed over
            ready = RENDER_RAYS if whole.all() else max(int(whole.argmin()), 1)
            parts.append([array[: min(ready, count - start)] for array in output])
            start += ready
        return RenderOutput(*(jnp.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    def _derived(self, state: State) -> tuple[Cells, jax.Array, jax.Array, tuple[field.Level, ...], np.ndarray]:
        """Occupancy grid, maps, decay by block and levels of a state, and which of its cells are on."""
        if state.kept.get("of") != (id(state.codes), id(state.bricks)):
            levels = make_levels(self.settings.resolutions, state.bricks)
            decay = jnp.asarray(decay_of_blocks(levels, self.settings.by_kind.feature_decay))
            arrays = cells_of(state, self.dataset.facts.contraction), jnp.asarray(levels.maps), decay
            columns = levels.resolution.tolist(), levels.offset.tolist(), levels.place.tolist()
            constant = tuple(field.Level(*row) for row in zip(*columns, strict=True))  # hashable
            derived = *arrays, constant, np.flatnonzero(is_on(state.codes))
            state.kept = {"of": (id(state.codes), id(state.bricks)), "derived": derived}
        return state.kept["derived"]

    def _constants(self, state: State) -> Constants:
        """What a step is compiled for. Sizes of lists are rounded up to powers of √2, so that programs are compiled seldom."""
        cells, _, _, levels, _ = self._derived(state)
        if (step := state.step_cells) not in state.kept:
            segments = segments_across(state.box.dims, step)
            ids = jnp.asarray(np.random.default_rng(0).integers(0, self.dataset.count, PROBE_RAYS).astype(np.int32))
            coarse, fine = (agree(np.asarray(a)) for a in _count(cells, self.geometry, ids, segments, step))
            capacity = LISTED * self.settings.samples
            rays = int(np.clip(capacity / max(fine.mean() * HEADROOM, 1.0), 256, 131_072))
            rays = int(2 ** (np.floor(2 * np.log2(rays)) / 2)) // 256 * 256
            listed = _rounded(rays * coarse.mean() * HEADROOM + 4096)
            sizes = MarchSizes(segments, listed, capacity, _rounded(fine.max() * HEADROOM + 8))
            state.kept[step] = Constants(levels, sizes, rays, step, self.settings)
        return state.kept[step]


def _rounded(size: float) -> int:
    return int(np.ceil(2 ** (np.ceil(2 * np.log2(size)) / 2)))


@partial(jax.jit, static_argnames="levels")
def _values_at(
    table: jax.Array, parameters: jax.Array, maps: jax.Array, points: jax.Array, levels: tuple[field.Level, ...]
) -> jax.Array:  # fmt: skip
    density, values = field.activate(field.decode(parameters, field.encode(table, levels, maps, points)))
    return jnp.concatenate([density[:, None], values], axis=-1)


@partial(jax.jit, static_argnames="constants")
def _render_chunk(
    trained: Trainable, cells: Cells, maps: jax.Array, rays: Rays, constants: Constants
) -> tuple[RenderOutput, jax.Array]:  # fmt: skip
    count, settings, background = rays.near.shape[0], constants.settings, jnp.asarray(constants.settings.background)
    blank = jnp.zeros((count, 3))
    samples, target = sampled(cells, rays, blank, blank, jnp.full(count, 0.5), constants)
    x = field.encode(trained.table, constants.levels, maps, samples.g / settings.resolution)
    density, values = field.activate(field.decode(trained.parameters, x))
    gathered, *_ = field.composite(density, values, samples, target.step_lengths, count, constants.sizes.per_ray)
    output = field.shade(gathered, field.view_mlp_of(trained.parameters, settings), rays.viewdirs, background)
    return output._replace(rgb=jnp.clip(output.rgb, 0, 1)), samples.complete


@partial(jax.jit, static_argnames=("segments", "step"))
def _count(
    cells: Cells, geometry: RayDataset, ids: jax.Array, segments: int, step: float
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """Coarse segments and samples, both [N], of training rays int32 [N]."""
    rays = to_grid(cells.box, geometry.geometry_at(ids))
    coarse = occupied_segments(cells, rays, jnp.zeros_like(rays.start), segments, step).sum(-1)

    def add(k: jax.Array, total: jax.Array) -> jax.Array:
        t = rays.start + k * step
        return total + ((t < rays.end) & cells.has_support(rays.points(jnp.arange(len(t)), t)))

    return coarse, jax.lax.fori_loop(0, segments * COARSE, add, jnp.zeros_like(coarse))
