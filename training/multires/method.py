"""The multi-resolution field as a training.method.Method.

field      the definition, in JAX              levels     rows of the feature table
state      what is trained, and checkpoints    occupancy  where samples are taken
settings   what a config means for a dataset   hull       where anything can be, by the photographs
jax_engine, fused   the two engines, which compute the steps of the field and evaluate it; their interface is here
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from console import UserError
from training import exposure
from training.config import EngineName, TrainConfig
from training.dataset import RayDataset
from training.devices import agree, here
from training.method import FieldOutput, Rays, RenderOutput, ViewMlpParams
from training.multires import levels
from training.multires.field import initial_parameters, view_mlp_of
from training.multires.fused.compiled import Workers
from training.multires.jax_engine import JaxEngine
from training.multires.occupancy import box_around, boxes_meeting, hull_codes, is_on, located, visited, without_specks
from training.multires.settings import settings_of
from training.multires.state import AVERAGES, PARTS, State, Trainable, restored, saved
from training.rendering import init_view_mlp

VISITS_FROM, VISIT_EVERY, SETTLED = 200, (50, 100), 1000  # steps: the second interval once settled
WHOLE_EVERY = 100  # steps, before it settles, between visits to every cell
SPECKS_EVERY = 1000  # steps after which specks are removed from what masks cut out
AVERAGED_FROM = 0.8  # of all steps
PIECE = 1 << 20  # rows
VIEW_BIAS = -2.0  # the view MLP starts near zero, so that diffuse colour settles first
SAMPLES_AT_FIRST = 64.0  # a ray, until a step has counted them


class MultiresMethod:
    """The multi-resolution field behind training.method.Method."""

    def __init__(self, config: TrainConfig, dataset: RayDataset) -> None:
        self.config, self.dataset = config, dataset
        self.settings = settings_of(config, dataset)
        # Without the fused engine, a run of it is rendered, scored and baked, but not trained.
        self._problem = None if config.engine == "jax" else _problem_of_fused()
        engine = JaxEngine
        if config.engine != "jax" and self._problem is None:
            from training.multires.fused.engine import FusedEngine as engine  # its import compiles the loops
        self.engine: Engine = engine(dataset, self.settings, config.seed)

    def start(self, key: jax.Array) -> State:
        settings, workers = self.settings, Workers()
        box = box_around(self.dataset, settings.resolution, settings.ndc_depth, workers)
        codes = hull_codes(self.dataset, box, settings.resolution, settings.least_views, workers)
        view_mlp = init_view_mlp(key)
        view_mlp = view_mlp._replace(biases=(*view_mlp.biases[:2], view_mlp.biases[2] + VIEW_BIAS))
        random = np.random.default_rng((self.config.seed, 0))
        parameters = initial_parameters(len(settings.resolutions), view_mlp, random, settings.by_kind.view_octaves)
        begin = [parameters, np.zeros_like(parameters), np.zeros_like(parameters)]
        values, first, second = (Trainable(np.zeros((0, 4), np.float32), array) for array in begin)
        state = State(
            box=box, bricks=(None,) * len(settings.resolutions), codes=codes, values=values, first=first, second=second,
            updates=0, next_ray=int(random.integers(self.dataset.count)), samples_per_ray=SAMPLES_AT_FIRST,
            step_cells=settings.step_cells(0.0),
            gains=np.ones((self.dataset.views, 3), np.float32) if settings.gains else None,
        )  # fmt: skip
        return self._with_levels(state, 0, 0.0)

    def step(self, state: State, step: int, progress: float | None = None) -> tuple[State, dict[str, Any]]:
        if self._problem is not None:
            found, remedy = self._problem
            what = "this run trains by the fused engine, which cannot be had here"
            raise UserError(what, where="--engine fused", found=found, remedy=remedy)
        if progress is None:
            progress = step / max(self.config.steps, 1)
        if step > 0:
            self._visit(state, step)
            state = self._with_levels(state, step, progress)
        state.step_cells = self.settings.step_cells(progress)
        if self.settings.gains and step >= exposure.FITTED_FROM and step % exposure.FIT_EVERY == 0:
            state.gains = self._fitted_gains(state, step)
        metrics = self.engine.step(state, step, progress)
        _average(state, progress)
        return state, metrics

    def render(self, state: State, rays: Rays) -> RenderOutput:
        return self.engine.render(_shown(state), rays)

    def query(self, state: State, points: jax.Array | np.ndarray) -> FieldOutput:
        """The field at points [N, 3] in NumPy; see training.method.Method. Density is 0 where the occupancy grid is off."""
        box, inner = state.box, self.dataset.facts.contraction or 0.0
        per_cell, asked = (1 / box.cell).astype(np.float32), np.asarray(points, np.float32)
        places, on = located(asked, box.origin.astype(np.float32), per_cell, box.dims, inner, state.codes)
        values = np.zeros((len(places), 8), np.float32)
        values[on] = self.engine.values_at(_shown(state), places[on])
        density = values[:, 0] / np.float32(box.cell[0] * self.settings.resolution)
        return FieldOutput(density, values[:, 1:4], values[:, 4:])  # type: ignore[arg-type]

    def may_hold(self, state: State, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Whether the boxes meet a cell that is on; see training.method.Method."""
        box = state.box
        return boxes_meeting(is_on(state.codes), (low - box.origin) / box.cell, (high - box.origin) / box.cell)

    def grain(self, state: State) -> np.ndarray:
        """The sides of a cell of the finest level; see training.method.Method."""
        return state.box.cell * (self.settings.resolution / self.settings.resolutions[-1])

    def view_mlp(self, state: State) -> ViewMlpParams | None:
        return view_mlp_of(jnp.asarray(here(_shown(state).values.parameters)), self.settings)

    def gains(self, state: State) -> np.ndarray | None:
        return state.gains

    def save(self, state: State) -> dict[str, np.ndarray]:
        return saved(state, self.settings.resolutions)

    def restore(self, arrays: Mapping[str, np.ndarray]) -> State:
        views = self.dataset.views if self.settings.gains else None
        return self.engine.adopt(restored(arrays, self.settings.resolutions, self.settings.resolution, views))

    def _visit(self, state: State, step: int) -> None:
        """Renews the occupancy grid where it is due before a step."""
        if step < VISITS_FROM or step % VISIT_EVERY[step >= SETTLED]:
            return
        whole = step < SETTLED and step % WHOLE_EVERY == 0
        random = np.random.default_rng((self.config.seed, step, 1))

        def density_at(points: np.ndarray) -> np.ndarray:
            return self.engine.values_at(state, points)[:, 0]

        threshold = self.settings.own.occupancy_threshold
        codes = visited(state.codes, density_at, random, threshold, whole)
        if self.dataset.facts.cut_out and step % SPECKS_EVERY == 0:
            codes = without_specks(codes)
        state.codes = agree(codes)

    def _with_levels(self, state: State, step: int, progress: float) -> State:
        """The state with rows for the levels that have joined. When one joins, sparse levels keep bricks near content only."""
        resolutions = self.settings.resolutions
        due = [progress >= join for join in self.settings.joins]
        if all(had is not None or not now for had, now in zip(state.bricks, due, strict=True)):
            return state
        occupied = is_on(state.codes)
        contracted = self.dataset.facts.contraction is not None

        def bricks_of(resolution: int) -> np.ndarray:
            hashed = contracted and resolution > levels.HASHED_FROM
            return levels.ALL_HASHED if hashed else levels.bricks_near(occupied, resolution)

        bricks = tuple(bricks_of(resolution) if now else None for resolution, now in zip(resolutions, due, strict=True))
        before, after = levels.make_levels(resolutions, state.bricks), levels.make_levels(resolutions, bricks)
        source = levels.moved_rows(before, after, state.bricks, bricks)
        new = source < 0
        random = np.random.default_rng((self.config.seed, step, 2))
        for name in PARTS:
            part: Trainable = getattr(state, name)
            table = np.asarray(here(part.table))[source] if len(part.table) else np.zeros((len(source), 4), np.float32)
            table[new] = 0.0
            if name == "values":
                table[new] = random.uniform(-levels.INITIAL, levels.INITIAL, (int(new.sum()), 4))
                for rows in levels.absent_rows(after):
                    table[rows] = 0.0
            setattr(state, name, part._replace(table=table))
        state.bricks, state.mean, state.averaged = bricks, None, 0
        return self.engine.adopt(state)

    def _fitted_gains(self, state: State, step: int) -> np.ndarray:
        """The photographs' gains [V, 3] by what the field shows of some of their rays now; the same in every process."""
        gains, dataset = state.gains, self.dataset
        assert gains is not None
        drawn = exposure.drawn(np.asarray(here(dataset.first)), dataset.count, (self.config.seed, step))
        ids = drawn.ravel().astype(np.int32)
        shown = self.engine.render(state, dataset.local().geometry_at(jnp.asarray(ids)))
        opacity = np.asarray(shown.alpha)[:, None]
        look = np.asarray(shown.rgb) - (1.0 - opacity) * np.asarray(dataset.background, np.float32)
        pixels = dataset.pixels_here(ids)
        found = exposure.fitted(
            gains, look.reshape(*drawn.shape, 3), opacity.reshape(drawn.shape), pixels.reshape(*drawn.shape, -1),
            auto=self.config.exposure == "auto",
        )  # fmt: skip
        return np.asarray(agree(found))


def _shown(state: State) -> State:
    return state if state.mean is None else replace(state, values=state.mean)


def _average(state: State, progress: float) -> None:
    """Takes the values into the mean where one is due. Steps stay large to the end of a run, and a mean of what they lead to lies
    nearer to the best than small steps do (Izmailov et al. 2018)."""
    share = (progress - AVERAGED_FROM) / (1 - AVERAGED_FROM)
    due = 0 if share < 0 else min(int(share * AVERAGES) + 1, AVERAGES)
    if state.averaged > due:  # a run that goes on for longer than it was meant to
        state.mean, state.averaged = None, 0
    if state.averaged == due:
        return
    state.averaged += 1
    if state.mean is None:
        state.mean = Trainable(*(array.copy() for array in state.values))
        return
    state.mean = Trainable(*map(partial(_moved, count=state.averaged), state.mean, state.values))


def _moved(mean: Any, value: Any, count: int) -> Any:
    """A mean with one more value; of NumPy's arrays in place, and by pieces, for tables are large."""
    if not isinstance(mean, np.ndarray):
        return mean + (value - mean) / count
    for low in range(0, len(mean), PIECE):
        piece = mean[low : low + PIECE]
        piece += (value[low : low + PIECE] - piece) / np.float32(count)
    return mean


class Engine(Protocol):
    """Agrees with training.multires.field to rounding; gradients may agree on average only.

    A step draws pixels from state.next_ray on. What is random about it comes from the seed and the step alone; two engines may
    draw it differently. An engine may keep what it derives from a state in state.kept.
    """

    def adopt(self, state: State) -> State:
        """The state with arrays as the engine needs them."""
        ...

    def step(self, state: State, step: int, progress: float) -> dict[str, Any]:
        """One update of the state, in place, and its metrics (see training.method.Method.step)."""
        ...

    def values_at(self, state: State, points: np.ndarray) -> np.ndarray:
        """float32 [N, 8] at points float32 [N, 3] of the unit cube: density per side of the cube, colours, features."""
        ...

    def render(self, state: State, rays: Rays) -> RenderOutput:
        """See training.method.Method.render."""
        ...


def chosen_engine(name: EngineName) -> EngineName:
    """What "auto" means on this machine, for a run that begins: the fused loops on a processor, JAX elsewhere."""
    if name != "auto":
        return name
    return "fused" if _problem_of_fused() is None else "jax"


def _problem_of_fused() -> tuple[str, str] | None:
    """Why the fused engine cannot be had, and what helps."""
    if jax.default_backend() != "cpu":
        found = f"JAX has an accelerator, {jax.devices()[0].device_kind}"
        return found, "train on a processor (JAX_PLATFORMS=cpu), or begin another run"
    if jax.device_count() > 1 or jax.process_count() > 1:
        found = f"{jax.device_count()} devices that train together"
        return found, "train in one process on one device, or begin another run"
    return None
