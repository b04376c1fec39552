"""The field in training: it learns, repeats itself, goes on from a checkpoint to the byte, and grows by levels."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from console import UserError
from scenepack.contraction import uncontract
from tests.training.test_captures import circle, write_transforms
from training.config import PRESETS, QUICK
from training.dataset import RayDataset, make_dataset
from training.exposure import FITTED_FROM
from training.methods import make_method, settled
from training.multires import engines
from training.multires.config import MultiresConfig
from training.multires.engines import chosen_engine
from training.multires.levels import INITIAL, make_levels
from training.multires.method import MultiresMethod
from training.multires.occupancy import INITIAL as INITIAL_CODE
from training.multires.occupancy import NEVER, code_of, is_on, neighbouring_points, visited
from training.multires.settings import plan_of
from training.scenes import Scene, load_scene

SMALL = MultiresConfig(
    resolutions=(8, 16, 128, 256), occupancy=32, samples_per_step=4096, steps_across=(16, 48, 64), finest_from=0.2
)
CONFIG = dataclasses.replace(QUICK, engine="fused", steps=300, multires=SMALL)
SAVED, LAST = 250, 255  # steps: cells have been visited by then, and all levels have joined
ENGINES = ("fused", "jax")


@pytest.fixture(scope="module")
def dataset(procedural_scene: Scene) -> RayDataset:
    return make_dataset(procedural_scene)


@dataclasses.dataclass
class Learnt:
    """A training until step LAST. saved: its state before step SAVED."""

    method: MultiresMethod
    state: Any
    psnr: list[float]
    saved: dict[str, np.ndarray]


@pytest.fixture(scope="module")
def learnt(dataset: RayDataset) -> Learnt:
    method = MultiresMethod(CONFIG, dataset)
    found = Learnt(method, method.start(jax.random.key(0)), [], {})
    for step in range(LAST):
        if step == SAVED:
            found.saved = {name: array.copy() for name, array in method.save(found.state).items()}
        found.state, metrics = method.step(found.state, step)
        found.psnr.append(metrics["psnr"])
    return found


def test_training_learns_and_tells_air_from_content(learnt: Learnt) -> None:
    assert np.mean(learnt.psnr[-20:]) > np.mean(learnt.psnr[:20]) + 6
    on = learnt.state.codes[is_on(learnt.state.codes)]
    assert (on < INITIAL_CODE).mean() > 0.3 and (on > INITIAL_CODE).mean() > 0.05


def test_a_restored_run_goes_on_to_the_last_bit(learnt: Learnt, dataset: RayDataset) -> None:
    method = MultiresMethod(CONFIG, dataset)
    state = method.restore(learnt.saved)
    for step in range(SAVED, LAST):
        state, _ = method.step(state, step)
    for name, array in method.save(learnt.state).items():
        np.testing.assert_array_equal(method.save(state)[name], array, err_msg=name)


def test_a_level_joins_with_new_rows_and_leaves_the_others_as_they_are(dataset: RayDataset) -> None:
    method = MultiresMethod(CONFIG, dataset)
    state = method.start(jax.random.key(0))
    assert state.bricks[-1] is None and state.bricks[-2] is not None
    rows = int(make_levels(method.plan.resolutions, state.bricks).offset[2])
    state.values.table[:] += 1.0
    before = state.values.table.copy()
    state = method._with_levels(state, 60, 0.2)
    levels = make_levels(method.plan.resolutions, state.bricks)
    assert len(state.values.table) == levels.total > len(before) and levels.offset[3] > 0
    np.testing.assert_array_equal(state.values.table[:rows], before[:rows])
    new = state.values.table[levels.offset[3] + 64 :]
    assert 0 < np.abs(new).max() <= INITIAL and not state.values.table[levels.offset[3] : levels.offset[3] + 64].any()


def test_what_may_hold_density_is_where_queries_find_it(learnt: Learnt, dataset: RayDataset) -> None:
    low, high = dataset.aabb
    points = (low + np.random.default_rng(0).random((3000, 3)) * (high - low)).astype(np.float32)
    density = np.asarray(learnt.method.query(learnt.state, jnp.asarray(points)).density)
    held = learnt.method.may_hold(learnt.state, points - 1e-4, points + 1e-4)
    assert held[density > 0].all() and (density > 0).any() and not held.all()
    assert (learnt.method.grain(learnt.state) > 0).all()


def test_weights_of_octaves_that_the_view_mlp_does_not_see_are_zero(learnt: Learnt) -> None:
    view_mlp = learnt.method.view_mlp(learnt.state)
    assert view_mlp is not None
    first = np.asarray(view_mlp.weights[0])
    unseen = [*range(6, 15), *range(18, 27)]  # of one octave, three sines and three cosines are used
    assert not first[unseen].any() and (first[[i for i in range(34) if i not in unseen]] != 0).all()


def test_cells_stay_on_as_long_as_their_density_says_and_those_outside_the_hull_never_are() -> None:
    assert list(code_of(np.array([0.0, 5.0, 5.2, 100.0, 1e9], np.float32), 0.01)) == [0, 0, 1, 14, 40]
    codes = np.full((8, 8, 8), NEVER, np.uint8)
    codes[:4] = 2
    for visits_left in (1, 0, 0):
        codes = visited(codes, lambda points: np.zeros(len(points)), np.random.default_rng(0), 0.01, whole=True)
        assert (codes[:4] == visits_left).all() and (codes[4:] == NEVER).all()
    codes = visited(codes, lambda points: 100.0 * (points[:, 0] > 0.5), np.random.default_rng(0), 0.01, whole=True)
    assert (codes[:4, :, 4:] == 14).all() and not codes[:4, :, :4].any()


def test_nothing_can_be_where_alpha_leaves_nothing(procedural_scene: Scene, learnt: Learnt) -> None:
    """A cell of the hull shows itself, or something around it, in every photograph that it lies in wholly."""
    state, camera = learnt.state, procedural_scene.splits["train"][0].camera
    alpha = procedural_scene.splits["train"][0].load()[..., 3] > 0
    z, y, x = np.nonzero(state.codes != NEVER)
    centres = state.box.origin + (np.stack([x, y, z], -1) + 0.5) * state.box.cell
    local = (centres - camera.world_T_camera[:3, 3]) @ camera.world_T_camera[:3, :3]
    px = np.rint(camera.fx * local[:, 0] / -local[:, 2] + camera.cx - 0.5).astype(int)
    py = np.rint(camera.fy * -local[:, 1] / -local[:, 2] + camera.cy - 0.5).astype(int)
    reach = int(np.ceil(camera.fx * 2 * state.box.cell.max() / -local[:, 2].max()))
    grown = np.array([
        alpha[max(b - reach, 0) : b + reach + 1, max(a - reach, 0) : a + reach + 1].any() for a, b in zip(px, py, strict=True)
    ])  # fmt: skip
    inside = (px > reach) & (py > reach) & (px < camera.width - reach) & (py < camera.height - reach)
    assert inside.sum() > 100 and grown[inside].all() and (state.codes == NEVER).mean() > 0.3


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("bricks.128", lambda a: a[::-1]),
        ("bricks.256", lambda a: a + 10**6),
        ("values.table", lambda a: a[:-64]),
        ("second.parameters", lambda a: a * np.nan),
        ("dims", lambda a: a * 0),
        ("codes", lambda a: a[:-1]),
        ("samples_per_ray", lambda a: a * 1e30),
        ("step_cells", lambda a: a * 0),
        ("cell", lambda a: -a),
    ],
)
def test_arrays_that_do_not_fit_are_refused_by_name(learnt: Learnt, name: str, spoil: Any) -> None:
    with pytest.raises(UserError, match=f'"{name}" does not fit'):
        learnt.method.restore({**learnt.saved, name: spoil(learnt.saved[name])})
    with pytest.raises(KeyError, match="codes"):
        learnt.method.restore({key: array for key, array in learnt.saved.items() if key != "codes"})


@pytest.mark.parametrize("engine", ENGINES)
def test_gains_are_fitted_and_go_on_from_a_checkpoint(dataset: RayDataset, engine: str) -> None:
    config = dataclasses.replace(
        CONFIG, exposure="on", engine=engine, multires=dataclasses.replace(SMALL, resolutions=(16,))
    )
    method = MultiresMethod(config, dataset)
    state = method.start(jax.random.key(0))
    state.gains = np.exp(np.random.default_rng(0).normal(0, 0.1, (dataset.views, 3))).astype(np.float32)
    saved = {name: array.copy() for name, array in method.save(state).items()}
    again = method.restore(saved)
    for step in range(FITTED_FROM - 1, FITTED_FROM + 2):
        state, _ = method.step(state, step)
        again, _ = method.step(again, step)
    assert (method.save(state)["gains"] != saved["gains"]).any()
    for name, array in method.save(state).items():
        np.testing.assert_array_equal(method.save(again)[name], array, err_msg=name)
    with pytest.raises(UserError, match='"gains" does not fit'):
        method.restore({**saved, "gains": 1e3 * saved["gains"]})


def test_a_run_keeps_the_engine_that_suits_the_machine_it_began_on(
    dataset: RayDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert chosen_engine("auto") == "fused" and settled(PRESETS["normal"]).engine == "fused"
    assert settled(dataclasses.replace(QUICK, engine="jax")).engine == "jax" == settled(PRESETS["tiny"]).engine
    monkeypatch.setattr(engines, "_problem_of_fused", lambda: ("JAX has an accelerator", "begin another run"))
    assert chosen_engine("auto") == "jax"
    method = MultiresMethod(CONFIG, dataset)
    state = method.start(jax.random.key(0))
    assert np.isfinite(np.asarray(method.query(state, jnp.zeros((4, 3))).density)).all()
    with pytest.raises(UserError, match="fused engine"):
        method.step(state, 0)


def test_exposures_are_fitted_by_this_method_alone(dataset: RayDataset) -> None:
    assert plan_of(dataclasses.replace(CONFIG, exposure="on"), dataset).gains and not plan_of(CONFIG, dataset).gains
    with pytest.raises(UserError, match="multires"):
        make_method(dataclasses.replace(PRESETS["tiny"], exposure="on"), dataset)


@pytest.mark.parametrize(
    ("settings", "option"),
    [
        ({"occupancy": 20}, "occupancy"),
        ({"view_octaves": 5}, "view-octaves"),
        ({"resolutions": (2, 16)}, "resolutions"),
        ({"steps_across": (32, 64)}, "steps-across"),
        ({"steps_across": (8, 32, 64)}, "steps-across"),
    ],
)
def test_settings_that_do_not_fit_together_are_refused_by_name(dataset: RayDataset, settings: Any, option: str) -> None:
    config = dataclasses.replace(CONFIG, multires=dataclasses.replace(SMALL, **settings))
    with pytest.raises(UserError, match=f"--multires.{option}"):
        plan_of(config, dataset)


def test_contracted_space_is_empty_before_cameras_and_between_the_sides_of_the_inner_cube(tmp_path: Path) -> None:
    scene = load_scene(write_transforms(tmp_path / "scene", circle()))
    dataset = make_dataset(scene, contracted=True)
    inner = dataset.facts.contraction
    assert dataset.kind == "unbounded" and inner is not None
    method = MultiresMethod(dataclasses.replace(CONFIG, multires=dataclasses.replace(SMALL, least_views=1)), dataset)
    state = method.start(jax.random.key(0))
    z, y, x = np.nonzero(is_on(state.codes))
    places = (state.box.origin + (np.stack([x, y, z], -1) + 0.5) * state.box.cell) / inner
    assert (np.abs(places) > 1).any() and (np.abs(places) > 1).sum(1).max() == 1
    eyes = np.asarray(dataset.world_T_camera)[:, :, 3]
    distances = np.linalg.norm(inner * uncontract(places)[:, None] - eyes, axis=-1)
    assert dataset.near <= distances.min() < 2 * dataset.near
    state.codes[:] = INITIAL_CODE
    within, beyond = inner * np.array([[1.5, 1 - 1e-6, 0.2]]), inner * np.array([[1.5, 1.02, 0.2]])
    for found, expected in zip(*(method.query(state, jnp.asarray(p)) for p in (beyond, within)), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_pairs_begin_in_the_cells_and_lie_one_step_apart_along_an_axis() -> None:
    cells, side = np.array([0, 5 + 8 * (2 + 8 * 7)]), 8
    pairs = neighbouring_points(cells, side, 1 / 64, 500, np.random.default_rng(0))
    x, y, z = np.floor(pairs[:, 0] * side).astype(int).T
    assert set((z * side + y) * side + x) == set(cells)
    apart = np.sort(pairs[:, 1] - pairs[:, 0], axis=1)
    np.testing.assert_array_equal(apart[:, :2], 0)
    assert apart[:, 2].max() == pytest.approx(1 / 64, rel=1e-4) and np.median(apart[:, 2]) > 0.9 / 64
    assert (pairs < 1).all()
    assert neighbouring_points(cells[:0], side, 1 / 64, 500, np.random.default_rng(0)).shape == (0, 2, 3)
