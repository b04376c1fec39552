"""The fused step of processors against the JAX step: same rays, same losses, same gradients, for every kind of scene."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.training.test_captures import circle, forward, write_llff, write_transforms
from training.config import CPU, TrainConfig
from training.dataset import make_dataset
from training.marching.rays import to_grid
from training.scenes import load_scene
from training.voxels.config import VoxelConfig
from training.voxels.field import render_samples
from training.voxels.method import VoxelMethod
from training.voxels.saving import save
from training.voxels.smoothness import WINDOW
from training.voxels.sparse_grid import (
    Occupancy,
    build_layout,
    interpolate,
    occupancy_of,
    present_voxels,
    voxel_centres,
)
from training.voxels.state import Trainable, VoxelState, state_over
from training.voxels.step import adam, draw, loss_and_gradient, marched_batch

pytest.importorskip("numba", reason="the fused engine needs Numba: pip install 'snerg[train]'")

from training.voxels.fused import engine as fused_engine
from training.voxels.fused import step as fused_step
from training.voxels.fused.bricks import build_bricks, support_of
from training.voxels.fused.engine import FusedEngine, FusedState
from training.voxels.fused.grid import grid_of
from training.multires.fused.rays import Batch, empty_batch, photographs_of

pytestmark = pytest.mark.slow

VOXELS = VoxelConfig(resolutions=(24,), ndc_resolutions=(24,), stage_starts=(0.0,), prunings=(), samples_per_step=8192)
CONFIG = dataclasses.replace(CPU, steps=40, batch_size=64, voxels=VOXELS, engine="fused")
TRAINED = 12  # steps: enough for mist of all densities, and for remembered depths that end rays


def scene_path(kind: str, procedural_path: Path, folder: Path) -> Path:
    """object: cut out by alpha; surroundings: opaque, through a lens that distorts; forward: in NDC."""
    if kind == "object":
        return procedural_path
    if kind == "forward":
        return write_llff(folder, forward())
    return write_transforms(folder, circle(), k1=0.05, k2=-0.01, p1=0.002, p2=-0.003)


class Both:
    """One trained state of a scene, for both engines."""

    def __init__(self, path: Path, voxels: VoxelConfig = VOXELS) -> None:
        self.config = dataclasses.replace(CONFIG, voxels=voxels)
        dataset = make_dataset(load_scene(path))
        self.method = VoxelMethod(self.config, dataset)
        self.jax_method = VoxelMethod(dataclasses.replace(self.config, engine="jax"), dataset)
        state = self.method.start(jax.random.key(0))
        for step in range(TRAINED):
            state, _ = self.method.step(state, step)
        self.fused: FusedState = self.method.engine.remember(state)
        self.plain = self.method.engine.end(self.fused)
        # lists with room for everything: what does not fit the JAX step's is left out there
        fitting = self.jax_method.engine.begin(self.plain).sizes
        longest = fitting.per_ray * 8
        sizes = fitting._replace(coarse=1 << 16, samples=1 << 17, per_ray=longest)
        self.state: VoxelState = self.plain._replace(sizes=sizes)

    def jax_says(self):
        settings, mesh = self.method.settings, self.method.dataset.mesh
        batch = jax.jit(draw, static_argnames=("rays", "settings"))(
            self.state.stage, self.method.dataset, jax.random.key(5), np.int32(3), 256, settings
        )
        marched = jax.jit(marched_batch, static_argnums=(2, 3, 4))(
            batch, self.state.stage, self.state.sizes, settings, mesh
        )
        assert np.asarray(marched.samples.complete).all()
        said = jax.jit(loss_and_gradient, static_argnames=("mesh", "sizes", "settings"))(
            self.state.trainable, self.state.stage, batch, mesh, sizes=self.state.sizes, settings=settings
        )
        return batch, said

    def fused_batch(self, batch) -> Batch:
        rays = to_grid(self.state.layout, batch.rays)
        arrays = (rays.origins, rays.directions, rays.start, rays.end, rays.length, batch.rays.viewdirs, batch.target,
                  batch.background, batch.phase)  # fmt: skip
        return Batch(*(np.ascontiguousarray(np.asarray(a, np.float32)) for a in arrays))


@pytest.fixture(scope="module", params=["object", "surroundings", "forward"])
def both(request: pytest.FixtureRequest, procedural_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Both:
    return Both(scene_path(request.param, procedural_path, tmp_path_factory.mktemp(request.param) / "scene"))


def flat_head(head) -> np.ndarray:
    return np.concatenate([np.asarray(a).ravel() for pair in zip(*head, strict=True) for a in pair])


def test_every_loss_and_every_gradient_is_that_of_the_jax_step(both: Both) -> None:
    agreed(both)


def test_distortion_measures_lengths_whatever_the_distance_between_samples(procedural_path: Path) -> None:
    half = Both(procedural_path, dataclasses.replace(VOXELS, step_voxels=0.5))
    terms = agreed(half)
    batch, _ = half.jax_says()
    state, settings = half.state, half.method.settings
    marched = marched_batch(batch, state.stage, state.sizes, settings, half.method.dataset.mesh)
    rays, samples = marched
    raw = interpolate(state.trainable.rows, state.layout, samples.g)
    _, _, weights = render_samples(
        raw, state.trainable.head, samples, rays.length, batch.rays.viewdirs, state.sizes, settings, batch.background
    )
    voxel, total = float(np.asarray(state.layout.voxel).max()), 0.0
    for ray in range(len(batch.phase)):
        of_ray = np.asarray(samples.valid & (samples.ray == ray))
        w, t = np.asarray(weights, np.float64)[of_ray], np.asarray(samples.t, np.float64)[of_ray] * voxel
        total += (np.outer(w, w) * np.abs(t[:, None] - t)).sum() + (w * w).sum() * 0.5 * voxel / 3
    total *= settings.distortion_weight / settings.distortion_spread / float(terms["rays"])
    assert float(terms["distortion"]) == pytest.approx(total, rel=1e-3) and total > 0


def agreed(both: Both) -> dict:
    """The terms of a batch's loss, after asserting that both engines say the same of it."""
    batch, (gradient, loss, terms) = both.jax_says()
    stepper = both.fused.stepper
    assert stepper is not None
    order = stepper.grid.order
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    ours = stepper.differentiate(both.fused.values, both.fused_batch(batch), place[np.asarray(batch.picked)])
    slopes = stepper.slopes / np.float32(ours.rays)
    stepper.slopes[:], stepper.marks[:] = 0, 0
    assert ours.metrics["samples"] == float(terms["samples"]) > 1000 and ours.rays == float(terms["rays"])
    for name, value in {**terms, "loss": loss}.items():
        assert ours.metrics[name] == pytest.approx(float(value), rel=2e-4, abs=1e-9), name
    if both.method.settings.distortion_weight:
        assert ours.metrics["distortion"] > 0
    expected = np.asarray(gradient.rows)[order]
    expected[0] = 0.0
    for channel in range(8):
        scale = np.abs(expected[:, channel]).max()
        assert scale > 0, f"the test needs a gradient of channel {channel}"
        np.testing.assert_allclose(slopes[:, channel], expected[:, channel], rtol=1e-3, atol=2e-4 * scale)
    theirs = flat_head(gradient.head)
    np.testing.assert_allclose(ours.head / ours.rays, theirs, rtol=1e-3, atol=2e-4 * np.abs(theirs).max())
    return terms


def test_adam_moves_values_and_moments_as_the_jax_step_does(both: Both) -> None:
    batch, (gradient, _, _) = both.jax_says()
    expected = adam(both.state.optimised, gradient, np.float32(0.3), both.method.settings)
    state = FusedState(both.plain)
    stepper = state.unpack(both.method.settings, both.method.engine.workers)
    place = np.empty_like(stepper.grid.order)
    place[stepper.grid.order] = np.arange(len(place))
    found = stepper.differentiate(state.values, both.fused_batch(batch), place[np.asarray(batch.picked)])
    decay = both.method.settings.final_rate_factor**0.3
    stepper.adam(state.values, state.first, state.second, found, int(both.plain.updates), decay)
    state.plain, state.updates = None, state.updates + 1
    packed = state.pack()
    assert not stepper.slopes.any() and not stepper.marks.any(), "ready for the next step"
    assert int(packed.updates) == int(expected.updates)
    largest = max(both.method.settings.rates)
    for name, close in (("trainable", 0.02 * largest), ("first", 1e-6), ("second", 1e-8)):
        ours, theirs = getattr(packed, name), getattr(expected, name)
        # a slope near zero may have either sign in the last bit, and Adam moves by the sign: a few rows may differ
        apart = np.abs(np.asarray(ours.rows) - np.asarray(theirs.rows)) > close + 2e-3 * np.abs(np.asarray(theirs.rows))
        assert apart.mean() < 2e-4, name
        np.testing.assert_allclose(flat_head(ours.head), flat_head(theirs.head), rtol=2e-3, atol=close)


def test_rays_and_their_pixels_are_those_of_the_dataset(both: Both) -> None:
    dataset, stepper = both.method.dataset, both.fused.stepper
    ids = np.random.default_rng(0).integers(0, dataset.count, 500)
    background = np.random.default_rng(1).random((500, 3), np.float32)
    ours = stepper.batch(photographs_of(dataset), ids, np.zeros(500, np.float32), background)
    rays = dataset.geometry_at(ids.astype(np.int32))
    there = to_grid(both.plain.layout, rays)
    size = float(np.asarray(both.plain.layout.dims).max())
    for name, found, expected in (
        ("origins", ours.origins, there.origins), ("directions", ours.directions, there.directions),
        ("length", ours.length, there.length), ("viewdirs", ours.viewdirs, rays.viewdirs),
    ):  # fmt: skip
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=2e-5 * size, err_msg=name)
    meets = np.asarray(there.end) > np.asarray(there.start) + 0.1
    assert meets.any()
    np.testing.assert_allclose(ours.start[meets], np.asarray(there.start)[meets], rtol=1e-4, atol=2e-4 * size)
    np.testing.assert_allclose(ours.end[meets], np.asarray(there.end)[meets], rtol=1e-4, atol=2e-4 * size)
    np.testing.assert_allclose(ours.target, dataset.colours_over(ids.astype(np.int32), background), atol=1e-6)


def test_bricks_know_every_row_and_every_cell_of_the_layout(both: Both) -> None:
    layout = both.plain.layout
    cells = np.asarray(both.plain.cells)
    bricks, order = build_bricks(cells[1:], np.asarray(layout.support), np.asarray(layout.dims))
    np.testing.assert_array_equal(support_of(bricks), np.asarray(layout.support))
    assert sorted(order) == list(range(len(cells))), "each row has its place"
    width, height = np.asarray(layout.dims)[:2] + 2
    x, y, z = bricks.coordinates[1:].T
    np.testing.assert_array_equal((z * height + y) * width + x, cells[order][1:])


def test_remembered_depths_are_those_of_the_jax_engine(both: Both) -> None:
    theirs = np.asarray(both.jax_method.engine.remember(both.jax_method.engine.begin(both.plain)).layout.support)
    ours = np.asarray(both.plain.layout.support)
    assert (ours > 0).sum() == (theirs > 0).sum() > 0
    off = np.abs(ours.astype(int) - theirs)
    assert off.max() <= 1 and (off > 0).mean() < 1e-3, "codes round apart in the last bit, if at all"


def run(config: TrainConfig, path: Path, steps: int, threads: int | None = None) -> tuple[dict, list[float]]:
    method = VoxelMethod(config, make_dataset(load_scene(path)))
    if threads:
        method.engine = FusedEngine(method.dataset, method.plan, method.settings, config.seed, threads)
    state, losses = method.start(jax.random.key(config.seed)), []
    for step in range(steps):
        state, metrics = method.step(state, step)
        losses.append(float(metrics["loss"]))
    return method.save(state), losses


PRUNED = dataclasses.replace(VOXELS, resolutions=(16, 24), stage_starts=(0.0, 0.5), prunings=(0.75,))


@pytest.mark.parametrize("threads", [2, 3])
def test_the_number_of_threads_changes_no_bit(procedural_path: Path, threads: int) -> None:
    config = dataclasses.replace(CONFIG, voxels=VOXELS)
    alone, together = run(config, procedural_path, 8, 1), run(config, procedural_path, 8, threads)
    assert alone[1] == together[1]
    assert all(np.array_equal(alone[0][name], together[0][name]) for name in alone[0])


def test_the_room_for_samples_changes_no_bit(procedural_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wide = run(CONFIG, procedural_path, 4, 2)
    monkeypatch.setattr(fused_step, "ROOM", 1)  # samples a ray: every chunk is full again and again
    narrow = run(CONFIG, procedural_path, 4, 2)
    assert wide[1] == narrow[1]
    assert all(np.array_equal(wide[0][name], narrow[0][name]) for name in wide[0])


def test_a_step_asks_for_no_more_memory_than_its_samples_may_take(both: Both) -> None:
    dims = np.array([1000, 1000, 3])
    cells, support = np.array([0, 1_500_000]), np.zeros(int(np.prod(dims + 2)), np.uint8)
    support[1_500_000] = 1
    grid = grid_of(cells, support, dims, np.zeros(3), np.ones(3))
    stepper = fused_step.Stepper(grid, both.method.settings, both.method.engine.workers)
    rays = empty_batch(32_768)
    for array in rays:
        array[:] = 0.0
    assert stepper.mean_samples(both.fused.values, rays) == 0.0
    asked = sum(array.nbytes for part in [stepper._work, *stepper.scratch] for array in part)
    assert asked < 1e9, "untouched memory is refused, too, where a system does not overcommit"


@pytest.mark.parametrize("share", [0.05, 0.5])
def test_a_step_looks_at_the_variation_of_a_share_of_the_voxels_but_of_few_for_its_samples(
    procedural_path: Path, monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    few = dataclasses.replace(VOXELS, samples_per_step=4096, variation_share=share)
    method = VoxelMethod(dataclasses.replace(CONFIG, voxels=few), make_dataset(load_scene(procedural_path)))
    state = method.start(jax.random.key(0))
    asked, most = share * present_voxels(method.engine.end(state).layout).sum(), 4096 / 4
    assert (asked > most) == (share == 0.5), "one is bounded by the samples, the other is not"
    picked, windows = [], fused_engine.windows
    monkeypatch.setattr(fused_engine, "windows", lambda *given: picked.append(windows(*given)) or picked[-1])
    method.step(state, 0)
    assert min(asked, most) - WINDOW <= len(picked[0]) <= min(asked, most)


def test_dense_tables_are_given_up_while_steps_are_made(both: Both) -> None:
    state = FusedState(both.plain)
    state.unpack(both.method.settings, both.method.engine.workers)
    assert state.plain is None
    saved, again = both.method.engine.arrays(state), state.pack()
    assert all(np.array_equal(saved[name], array) for name, array in save(again).items()), "saved without them"
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(both.plain), strict=True):
        np.testing.assert_array_equal(np.asarray(ours), np.asarray(theirs))


@pytest.mark.parametrize("finer", [0.2, 0.4])
def test_a_restored_state_goes_on_to_the_byte(procedural_path: Path, finer: float) -> None:
    voxels = dataclasses.replace(PRUNED, stage_starts=(0.0, 0.45), finer_samples_from=finer)
    config = dataclasses.replace(CONFIG, steps=200, voxels=voxels)
    unbroken, _ = run(config, procedural_path, 104)
    halfway, _ = run(config, procedural_path, 57)
    method = VoxelMethod(config, make_dataset(load_scene(procedural_path)))
    state = method.restore(halfway)
    for step in range(57, 104):
        state, _ = method.step(state, step)
    again = method.save(state)
    assert halfway["step_voxels"] == (0.5 if finer == 0.2 else 1.0) and again["step_voxels"] == 0.5
    assert set(again) == set(unbroken)
    assert all(np.array_equal(again[name], unbroken[name]) for name in again), "refined and pruned between"


def test_a_diffuse_model_has_no_head_to_learn(procedural_path: Path) -> None:
    diffuse = Both(procedural_path, dataclasses.replace(VOXELS, view_dependence=False))
    assert diffuse.plain.trainable.head is None
    batch, (_, loss, _) = diffuse.jax_says()
    stepper = diffuse.fused.stepper
    found = stepper.differentiate(diffuse.fused.values, diffuse.fused_batch(batch), np.zeros(0, np.int32))
    rough = diffuse.method.settings.variation
    assert found.metrics["loss"] <= float(loss) and rough[0] > 0


def foggy(both: Both) -> VoxelState:
    """Fog with denser parts, in half of the box: something of every weight, and rays that meet nothing."""
    random, layout = np.random.default_rng(0), both.plain.layout
    present = present_voxels(layout) & (np.arange(int(layout.dims[2])) < int(layout.dims[2]) // 2)[:, None, None]
    layout = build_layout(present, np.asarray(layout.origin), np.asarray(layout.voxel))
    shape = present.sum() + 1, 8
    rows, first, second = (random.normal(0.0, 2.0, shape).astype(np.float32) for _ in range(3))
    rows[:, 0] += 6.0
    rows[0] = first[0] = second[0] = 0.0
    heads = (part.head for part in (both.plain.trainable, both.plain.first, both.plain.second))
    parts = tuple(Trainable(jnp.asarray(part), head) for part, head in zip((rows, first, second), heads, strict=True))
    return state_over(layout, parts, both.plain.updates, both.method.dataset.count)


def test_what_happens_between_steps_is_asked_of_either_engine_alike(both: Both) -> None:
    ours, theirs, dataset = both.method.engine, both.jax_method.engine, both.method.dataset
    ids, plain = np.arange(0, dataset.count, 7, dtype=np.int32), foggy(both)
    state, jax_state = ours.remember(ours.begin(plain)), theirs.remember(theirs.begin(plain))

    (weights, total), (expected, sums) = ours.visible_weights(state, ids), theirs.visible_weights(jax_state, ids)
    assert expected.max() > 0.1
    off = np.abs(weights - expected) > 2e-3
    assert off.mean() < 2e-3, "a sample on the border of two voxels may count for either"
    assert total.sum() == pytest.approx(sums.sum(), rel=1e-3) and np.corrcoef(total, sums)[0, 1] > 0.999
    centres = voxel_centres(*occupancy_of(plain.layout))
    jitter = np.random.default_rng(0).uniform(-1, 1, centres.shape) * np.asarray(plain.layout.voxel)
    beyond = (centres + jitter).astype(np.float32) * np.float32(1.2)  # some without support, some outside the box
    for name, values in theirs.query(jax_state, jnp.asarray(beyond))._asdict().items():
        np.testing.assert_allclose(
            getattr(ours.query(state, beyond), name), values, rtol=2e-3, atol=1e-3 * np.abs(values).max(), err_msg=name
        )
    meets, may = ours.meeting(state, ids), theirs.meeting(jax_state, ids)
    assert not (meets & ~may).any() and meets.sum() > 0.6 * may.sum(), "the reference asks coarser cells"
    assert not meets.all()

    rays = dataset.geometry_at(ids[::3])
    ours, theirs = ours.render(state, rays), theirs.render(jax_state, rays)
    assert np.asarray(theirs.alpha).max() > 0.6 > np.asarray(theirs.alpha).min()
    for name, picture in theirs._asdict().items():
        off = np.abs(np.asarray(getattr(ours, name)) - picture) > 2e-3 * max(np.abs(picture).max(), 1.0)
        assert off.mean() < 2e-3, f"{name}: but for rays that begin a step apart by rounding"


@pytest.mark.parametrize("finer", [False, True])
def test_a_state_moves_to_another_grid_alike_in_either_engine(both: Both, finer: bool) -> None:
    ours, theirs, plain = both.method.engine, both.jax_method.engine, foggy(both)
    present, origin, voxel = occupancy_of(plain.layout)
    keep = present & (np.random.default_rng(1).random(present.shape) < 0.3)
    kept = None if finer else np.concatenate([[0], 1 + np.flatnonzero(keep[present])])
    there = Occupancy(keep, origin + 0.4 * voxel, 0.8 * voxel) if finer else Occupancy(keep, origin, voxel)
    hits = np.arange(3, 500, 5, dtype=np.int32)
    moved = []
    for engine in (ours, theirs):
        state = engine.draw_from(engine.regrid(engine.begin(plain), there, kept), hits, len(hits))
        where, (drawn, count) = engine.occupancy(state), engine.drawn(state)
        np.testing.assert_array_equal(where.present, keep)
        np.testing.assert_allclose((where.origin, where.voxel), (there.origin, there.voxel), rtol=1e-6)
        assert count == len(hits) and np.array_equal(drawn, hits)
        moved.append(engine.end(state))
    for name in ("trainable", "first", "second"):
        found, known = (np.asarray(getattr(state, name).rows) for state in moved)
        np.testing.assert_allclose(found, known, rtol=1e-3, atol=1e-3, err_msg=name)
        assert known.any() == (name == "trainable" or not finer), "moments begin anew where voxels do"
        assert not known[0].any()
    for name in ("lookup", "coarse", "dims"):
        np.testing.assert_array_equal(getattr(moved[0].layout, name), getattr(moved[1].layout, name), err_msg=name)
    np.testing.assert_array_equal(moved[0].layout.support > 0, moved[1].layout.support > 0)
