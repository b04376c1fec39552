"""The fused step against the field's definition in JAX and against finite differences, for every kind of scene."""

import copy
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.training.test_captures import circle, forward, write_llff, write_transforms
from training.config import TrainConfig
from training.dataset import make_dataset
from training.marching import GridRays, MarchSizes, march
from training.multires import jax_engine
from training.multires.config import MultiresConfig
from training.multires.field import Target, decoder_size, inputs_of, seen_inputs
from training.multires.fused.engine import FusedEngine
from training.multires.fused.rays import Batch
from training.multires.jax_engine import Constants, JaxEngine, adam, cells_of, gradient_shares, loss_and_gradient
from training.multires.levels import ROWS_OF_BRICK, decay_of_blocks, make_levels
from training.multires.method import MultiresMethod
from training.multires.state import State, Trainable
from training.scenes import load_scene

SMALL = MultiresConfig(
    resolutions=(16, 32, 128), occupancy=32, samples_per_step=4096, steps_across=(20, 64, 96), steps_from=(0.25, 0.85),
    density_smoothness=0.05, colour_smoothness=0.1, feature_decay=0.1,
)  # fmt: skip
HASHED = dataclasses.replace(SMALL, resolutions=(16, 64, 256))
CONFIG = TrainConfig(method="multires", engine="fused", steps=40, multires=SMALL)
TRAINED = 12  # steps: enough for mist of all densities, and for rays that end
ROOM = 1 << 17  # samples of the JAX lists: for everything


@dataclasses.dataclass
class Trained:
    """A trained state of a scene, and a batch of its rays."""

    method: MultiresMethod
    state: State
    batch: Batch

    @property
    def engine(self) -> FusedEngine:
        return self.method.engine  # type: ignore[return-value]

    def fused(self) -> tuple[float, dict[str, float], Trainable]:
        """Loss, metrics, and the gradient of the mean over rays."""
        output = self.engine.differentiate(self.state, self.batch)
        table, marks = self.engine.scatter(self.state, output)
        metrics = self.engine.metrics(self.state, output)
        rays = np.float32(metrics["rays"])
        gradient = Trainable(table / rays, self.engine.parameter_gradient(output) / rays)
        table[:], marks[:] = 0.0, 0
        return metrics["loss"], metrics, gradient

    def jax(self) -> tuple[Constants, dict[str, Any], Trainable]:
        b, state = self.batch, self.state
        engine = JaxEngine(self.method.dataset, self.method.settings, 0)
        cells, maps, decay, levels, _ = engine._derived(dataclasses.replace(state, kept={}))
        arrays = b.origins, b.directions, b.begins, b.start, b.end, b.length, b.length
        rays = GridRays._make([*map(jnp.asarray, arrays), None])
        segments = 4 * state.codes.shape[0]
        sizes = MarchSizes(segments, ROOM, ROOM, segments * 4)
        samples = march(cells, rays, jnp.asarray(b.phase), sizes, state.step_cells)  # type: ignore[arg-type]
        assert np.asarray(samples.complete).all()
        constants = Constants(levels, sizes, len(b.phase), state.step_cells, self.method.settings)
        reference = np.float32(state.box.cell[0] * self.method.settings.resolution)
        lengths = b.length * np.float32(state.step_cells) / reference
        shares = gradient_shares(samples, jnp.asarray(b.length), self.engine.settings)
        # the cameras' surroundings count
        assert bool((shares < 1).any()) == (self.method.dataset.kind == "unbounded")
        target = Target(*(jnp.asarray(a) for a in (b.viewdirs, b.target, b.background, lengths, reference, shares)))
        compiled = jax.jit(loss_and_gradient, static_argnames="constants")
        values = Trainable(*(jnp.asarray(a) for a in state.values))
        gradient, metrics = compiled(values, maps, samples, target, jnp.asarray(b.pairs), constants=constants)
        used = np.ones(gradient.parameters.shape, bool)  # by Adam: see training.multires.jax_engine.adam
        decoder = decoder_size(inputs_of(len(levels)))
        used[decoder : decoder + 34 * 16] = np.repeat(seen_inputs(self.method.settings.by_kind.view_octaves), 16)
        learn = jnp.repeat(decay >= 0, ROWS_OF_BRICK)[:, None]
        gradient = Trainable(jnp.where(learn, gradient.table, 0.0), jnp.where(used, gradient.parameters, 0.0))
        return constants, metrics, gradient


KINDS = ["object", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("surroundings", "unbounded", "forward"))]


@pytest.fixture(scope="module", params=KINDS)
def trained(request: pytest.FixtureRequest, procedural_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """object: cut out by alpha; surroundings, unbounded: opaque, through a lens that distorts; forward: in NDC."""
    path = procedural_path
    if request.param == "forward":
        path = write_llff(tmp_path_factory.mktemp("forward") / "scene", forward())
    elif request.param != "object":
        lens: Any = {"k1": 0.05, "k2": -0.01, "p1": 0.002, "p2": -0.003}
        path = write_transforms(tmp_path_factory.mktemp(request.param) / "scene", circle(), **lens)
    unbounded = request.param == "unbounded"
    config = dataclasses.replace(CONFIG, multires=HASHED) if unbounded else CONFIG
    method = MultiresMethod(config, make_dataset(load_scene(path), contracted=unbounded))
    assert method.dataset.kind == request.param
    state = method.start(jax.random.key(0))
    for step in range(TRAINED):
        state, _ = method.step(state, step)
    method.engine.sampled_below = 0.0  # type: ignore[attr-defined]  # below, gradients are exact
    return Trained(method, state, method.engine.draw(state, 99))  # type: ignore[attr-defined]


def test_losses_and_gradients_are_those_of_the_definition(trained: Trained) -> None:
    loss, metrics, gradient = trained.fused()
    _, expected, expected_gradient = trained.jax()
    assert metrics["rays"] == int(expected["rays"])
    assert loss == pytest.approx(float(expected["loss"]), rel=1e-4)
    for name in ("mse", "distortion", "sparsity", "smoothness"):
        assert metrics[name] == pytest.approx(float(expected[name]), rel=1e-3, abs=1e-9)
    assert float(expected["distortion"]) > 0 and float(expected["smoothness"]) > 0
    for ours, theirs in zip(gradient, expected_gradient, strict=True):
        theirs = np.asarray(theirs)
        np.testing.assert_allclose(ours, theirs, rtol=2e-2, atol=2e-3 * np.abs(theirs).max())
        assert np.abs(theirs).max() > 0


def test_gradients_by_some_of_the_samples_are_right_on_average(trained: Trained) -> None:
    engine, state = trained.engine, trained.state
    some = FusedEngine(trained.method.dataset, trained.method.settings, 0)
    exact, sampled, left = [], [], np.zeros(2)
    for step in range(100, 160):
        batch = engine.draw(state, step)
        outputs = engine.differentiate(state, batch), some.differentiate(state, batch)
        left += [output.counts.sum() for output in outputs]
        exact.append(engine.parameter_gradient(outputs[0]))
        sampled.append(some.parameter_gradient(outputs[1]))
    apart = np.subtract(sampled, exact)
    assert np.linalg.norm(apart.mean(0)) < 0.1 * np.linalg.norm(np.mean(exact, 0))
    error = apart.std(0).max() / np.sqrt(len(apart))
    assert np.abs(apart.mean(0)).max() < 5 * error
    assert left[1] < 0.7 * left[0]


@pytest.mark.slow
def test_adam_moves_as_the_definition_does(trained: Trained) -> None:
    constants, *_ = trained.jax()
    _, metrics, gradient = trained.fused()
    state = copy.deepcopy(trained.state)
    before = trained.state.values, trained.state.first, trained.state.second
    rates = np.array(trained.method.settings.rates_at(state.updates, 0.3), np.float32)
    settings = trained.method.settings
    levels = trained.engine._derived(state)[1]
    decay = settings.decay_left(0.3) * decay_of_blocks(levels, settings.by_kind.feature_decay)
    expected = adam(before, gradient, jnp.asarray(decay), jnp.asarray(rates), constants)
    summed, marks = trained.engine._accumulators(state)
    rays = np.float32(metrics["rays"])
    summed[:] = gradient.table * rays
    marks[:] = (summed.reshape(len(marks), -1) != 0).any(1)
    trained.engine._adam(state, summed, marks, gradient.parameters * rays, metrics["rays"], 0.3)
    for ours, theirs in zip((state.values, state.first, state.second), expected, strict=True):
        for one, other in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-7)
    assert not summed.any() and not marks.any()
    assert (np.asarray(expected[0].table) != before[0].table).any()


def parts_of(trained: Trained) -> Iterator[tuple[str, Trainable]]:
    """Masks of what is trained, part by part: the levels' rows, the decoder's layers, the view MLP."""
    table, parameters = (np.zeros_like(a) for a in trained.state.values)
    levels = make_levels(trained.method.settings.resolutions, trained.state.bricks)
    for resolution, offset, rows in zip(levels.resolution, levels.offset, levels.rows, strict=True):
        mask = table.copy()
        mask[offset : offset + rows] = 1.0
        yield f"level {resolution}", Trainable(mask, parameters)
    inputs = inputs_of(len(levels.resolution))
    bounds = {"first layer": (0, inputs * 64 + 64), "second layer": (inputs * 64 + 64, decoder_size(inputs)),
              "view MLP": (decoder_size(inputs), len(parameters))}  # fmt: skip
    for name, (low, high) in bounds.items():
        mask = parameters.copy()
        mask[low:high] = 1.0
        yield name, Trainable(table, mask)


@pytest.mark.slow
def test_gradients_are_what_finite_differences_say(trained: Trained, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trained.engine, "settings", trained.engine.settings._replace(whole_from=0.0))
    _, _, gradient = trained.fused()
    values = trained.state.values
    for name, mask in parts_of(trained):
        direction = Trainable(*(g * m for g, m in zip(gradient, mask, strict=True)))
        norm = float(np.sqrt(sum(np.square(d, dtype=np.float64).sum() for d in direction)))
        assert norm > 0, name
        distance = 3e-3 / max(float(np.abs(d).max() / norm) for d in direction if d.any())
        losses = []
        for sign in (1, -1):
            moved = (v + np.float32(sign * distance / norm) * d for v, d in zip(values, direction, strict=True))
            trained.state.values = Trainable(*moved)
            losses.append(trained.fused()[0])
        trained.state.values = values
        assert (losses[0] - losses[1]) / (2 * distance) == pytest.approx(norm, rel=0.03), name


@pytest.mark.slow
@pytest.mark.parametrize("extreme", [1e3, -1e3, 1e6])
def test_no_value_however_extreme_makes_a_gradient_that_is_not_finite(trained: Trained, extreme: float) -> None:
    wild = copy.deepcopy(trained.state)
    wild.values.table[64:] += np.float32(extreme) * np.sign(wild.values.table[64:])
    loss, _, gradient = dataclasses.replace(trained, state=wild).fused()
    assert np.isfinite(loss)
    assert all(np.isfinite(part).all() for part in gradient)


def test_pictures_and_points_are_those_of_the_other_engine(trained: Trained) -> None:
    engine, state, dataset = trained.engine, trained.state, trained.method.dataset
    other = JaxEngine(dataset, trained.method.settings, 0)
    copied = dataclasses.replace(state, kept={})
    points = np.random.default_rng(0).random((500, 3), np.float32)
    np.testing.assert_allclose(engine.values_at(state, points), other.values_at(copied, points), rtol=2e-4, atol=1e-5)
    rays = dataset.geometry_at(jnp.arange(0, dataset.count, 37))
    ours, theirs = engine.render(state, rays), other.render(copied, rays)
    for name in ("rgb", "alpha"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=2e-3)
    assert cells_of(state).occupied.sum() > 0


@pytest.mark.parametrize("trained", ["object"], indirect=True)
def test_pictures_of_a_list_that_few_rays_fit_into_are_the_same(trained, monkeypatch):
    dataset, state = trained.method.dataset, dataclasses.replace(trained.state, kept={})
    engine, rays = JaxEngine(dataset, trained.method.settings, 0), dataset.geometry_at(jnp.arange(0, dataset.count, 37))
    expected = engine.render(state, rays)
    monkeypatch.setattr(jax_engine, "RENDER_SAMPLES", 2048)
    found = engine.render(state, rays)
    for name in ("rgb", "alpha"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 3])
def test_a_run_repeats_itself_to_the_last_bit_whatever_the_number_of_threads(trained, threads):
    method = MultiresMethod(trained.method.config, trained.method.dataset)
    method.engine = FusedEngine(method.dataset, method.settings, CONFIG.seed, threads)
    state = method.start(jax.random.key(0))
    for step in range(TRAINED):
        state, _ = method.step(state, step)
    np.testing.assert_equal(method.save(state), method.save(trained.state))
