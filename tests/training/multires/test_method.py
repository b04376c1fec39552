"""The field in training: it learns, repeats itself, goes on from a checkpoint to the byte, and grows by levels."""

import copy
import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import distance_transform_cdt

from console import UserError
from scenepack.contraction import uncontract
from tests.training.reconstructions import ndc_points
from tests.training.test_captures import circle, forward, write_llff, write_transforms
from training.config import QUICK
from training.dataset import RayDataset, make_dataset
from training.exposure import FITTED_FROM
from training.multires.config import MultiresConfig
from training.multires.fused.compiled import Workers
from training.multires.levels import ROWS_OF_BRICK, decay_of_blocks, make_levels
from training.multires.method import SPECKS_EVERY, MultiresMethod, _average
from training.multires.occupancy import INITIAL as INITIAL_CODE
from training.multires.occupancy import LONGEST, NEVER, _in_panorama, box_around, hull_codes, is_on
from training.multires.settings import DEEPEST, FEWEST_RAYS, PARALLAX, SHALLOWEST, ndc_depth
from training.scenes import Scene, load_scene
from training.scenes.scene import pixels_of

SMALL = MultiresConfig(
    resolutions=(8, 16, 128, 256), occupancy=32, samples_per_step=4096, steps_across=(16, 48, 64), steps_from=(0.25, 0.85),
    finest_from=0.2,
)  # fmt: skip
CONFIG = dataclasses.replace(QUICK, engine="fused", steps=300, multires=SMALL)
SAVED, LAST = 250, 255  # steps: cells have been visited by then, and all levels have joined


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


def test_the_end_of_a_run_is_averaged(learnt: Learnt) -> None:
    state, shown = learnt.state, jax.tree.leaves(learnt.method.view_mlp(learnt.state))
    assert state.averaged == 5 and np.isin(shown[-1], state.mean.parameters).all()  # from step 240 on, every third
    sixth = (5 * state.mean.parameters + state.values.parameters) / 6
    _average(state := copy.deepcopy(state), 0.86)
    np.testing.assert_allclose(state.mean.parameters, sixth, rtol=1e-4, atol=1e-6)


def test_a_restored_run_goes_on_to_the_last_bit(learnt: Learnt, dataset: RayDataset) -> None:
    method = MultiresMethod(CONFIG, dataset)
    state = method.restore(learnt.saved)
    for step in range(SAVED, LAST):
        state, _ = method.step(state, step)
    np.testing.assert_equal(method.save(state), method.save(learnt.state))


def test_decay_is_the_gradient_of_the_mean_square_of_each_level(learnt: Learnt) -> None:
    levels, table = make_levels(learnt.method.settings.resolutions, learnt.state.bricks), learnt.state.values.table
    slopes = np.repeat(decay_of_blocks(levels, 0.3), ROWS_OF_BRICK)[:, None] * table
    for first, rows in zip(levels.offset, levels.rows, strict=True):
        some = slice(first, first + rows)
        expected = jax.grad(lambda features: 0.3 * jnp.square(features).mean())(jnp.asarray(table[some]))
        np.testing.assert_allclose(slopes[some], expected, rtol=1e-5)
        assert np.abs(expected).max() > 0


def test_what_may_hold_density_is_where_queries_find_it(learnt: Learnt, dataset: RayDataset) -> None:
    low, high = dataset.aabb
    points = (low + np.random.default_rng(0).random((3000, 3)) * (high - low)).astype(np.float32)
    density = np.asarray(learnt.method.query(learnt.state, jnp.asarray(points)).density)
    held = learnt.method.may_hold(learnt.state, points - 1e-4, points + 1e-4)
    assert held[density > 0].all() and (density > 0).any() and not held.all()
    assert (learnt.method.grain(learnt.state) > 0).all()


def test_nothing_can_be_where_alpha_leaves_nothing(scene: Scene, learnt: Learnt) -> None:
    """A cell of the hull shows itself, or something around it, in every photograph that it lies in wholly."""
    state, camera = learnt.state, scene.splits["train"][0].camera
    alpha = scene.splits["train"][0].load()[..., 3] > 0
    z, y, x = np.nonzero(state.codes != NEVER)
    centres = state.box.origin + (np.stack([x, y, z], -1) + 0.5) * state.box.cell
    px, py = np.floor(pixels_of(camera, centres)[0]).astype(int).T
    depths = (camera.world_T_camera[:3, 3] - centres) @ camera.world_T_camera[:3, 2]
    reach = int(np.ceil(camera.fx * 2 * state.box.cell.max() / depths.min()))
    grown = np.array([
        alpha[max(b - reach, 0) : b + reach + 1, max(a - reach, 0) : a + reach + 1].any() for a, b in zip(px, py, strict=True)
    ])  # fmt: skip
    inside = (px > reach) & (py > reach) & (px < camera.width - reach) & (py < camera.height - reach)
    assert inside.sum() > 100 and grown[inside].all() and (state.codes == NEVER).mean() > 0.3


def test_the_wrong_mask_of_a_photograph_takes_nothing_away(dataset: RayDataset) -> None:
    dataset = dataclasses.replace(dataset, facts=dataset.facts._replace(rendered=False))
    box, workers = box_around(dataset, 32, 1.0, Workers(1)), Workers(1)
    blank = np.asarray(dataset.pixels).copy()
    blank[: len(blank) // dataset.views, -1] = 0
    right = hull_codes(dataset, box, 32, 1, workers) != NEVER
    wrong = hull_codes(dataclasses.replace(dataset, pixels=blank), box, 32, 1, workers) != NEVER
    assert 0.8 * right.sum() < (right & wrong).sum() <= right.sum() < 0.7 * right.size


@pytest.mark.parametrize("cut_out", [False, True])
def test_specks_are_removed_from_what_masks_cut_out(learnt: Learnt, dataset: RayDataset, cut_out: bool) -> None:
    method = MultiresMethod(CONFIG, dataclasses.replace(dataset, facts=dataset.facts._replace(cut_out=cut_out)))
    state = method.restore(learnt.saved)
    on = is_on(state.codes)
    speck = tuple(np.argwhere(np.asarray(distance_transform_cdt(~on)) > 2)[0])
    codes = state.codes.copy()
    codes[speck] = LONGEST
    state.codes = codes
    state, _ = method.step(state, SPECKS_EVERY, progress=0.9)
    after = is_on(state.codes)
    assert after[speck] != cut_out and after[on].mean() > 0.9


def test_cells_of_ndc_are_as_deep_as_the_photographs_can_tell(tmp_path: Path) -> None:
    scene = load_scene(write_llff(tmp_path, forward()))
    dataset, finest = make_dataset(scene), 128
    depth = ndc_depth(dataset, finest)
    assert 1 < depth < DEEPEST
    places = np.array([p.camera.world_T_camera[:2, 3] for p in scene.splits["train"]])
    spread = np.sqrt(((places - places.mean(0)) ** 2).sum(1).mean())
    near, far = np.array([0.0, 0.0, -3.0]), np.array([0.0, 0.0, -3.5])  # in front of the middle of the cameras
    assert scene.ndc_camera is not None
    apart = ndc_points(np.stack([near, far]), *scene.ndc_camera)[:, 2]
    cells = np.ptp(apart) / (depth * np.ptp(scene.aabb[:, :2], axis=0).max() / finest)
    parallax = scene.splits["train"][0].camera.fx * spread * abs(1 / near[2] - 1 / far[2])
    assert parallax / cells == pytest.approx(PARALLAX, rel=1e-3)
    assert ndc_depth(dataset, 16) == SHALLOWEST and ndc_depth(dataset, 4096) == DEEPEST


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["fused", "jax"])
def test_gains_are_fitted_and_go_on_from_a_checkpoint(dataset: RayDataset, engine: str) -> None:
    multires = dataclasses.replace(SMALL, resolutions=(16,))
    method = MultiresMethod(dataclasses.replace(CONFIG, exposure="on", engine=engine, multires=multires), dataset)
    state = method.start(jax.random.key(0))
    state.gains = np.exp(np.random.default_rng(0).normal(0, 0.1, (dataset.views, 3))).astype(np.float32)
    saved = {name: array.copy() for name, array in method.save(state).items()}
    again = method.restore(saved)
    for step in range(FITTED_FROM - 1, FITTED_FROM + 2):
        state, _ = method.step(state, step)
        again, _ = method.step(again, step)
    assert (method.save(state)["gains"] != saved["gains"]).any()
    assert state.next_ray >= saved["next_ray"] + 3 * FEWEST_RAYS  # the next step draws other pixels
    np.testing.assert_equal(method.save(again), method.save(state))
    with pytest.raises(UserError, match='"gains" does not fit'):
        method.restore({**saved, "gains": 1e3 * saved["gains"]})


@pytest.mark.slow
def test_contracted_space_is_empty_before_cameras_and_between_the_sides_of_the_inner_cube(tmp_path: Path) -> None:
    scene = load_scene(write_transforms(tmp_path / "scene", circle()))
    dataset = make_dataset(scene, contracted=True)
    inner = dataset.facts.contraction
    assert dataset.kind == "unbounded" and inner is not None
    method = MultiresMethod(CONFIG, dataset)
    state = method.start(jax.random.key(0))
    z, y, x = np.nonzero(is_on(state.codes))
    places = (state.box.origin + (np.stack([x, y, z], -1) + 0.5) * state.box.cell) / inner
    assert (np.abs(places) > 1).any() and (np.abs(places) > 1).sum(1).max() == 1
    eyes = np.asarray(dataset.world_T_camera)[:, :, 3]
    distances = np.linalg.norm(inner * uncontract(places)[:, None] - eyes, axis=-1)
    assert dataset.facts.near <= distances.min() < 2 * dataset.facts.near
    state.codes[:] = INITIAL_CODE
    within, beyond = inner * np.array([[1.5, 1 - 1e-6, 0.2]]), inner * np.array([[1.5, 1.02, 0.2]])
    for found, expected in zip(*(method.query(state, jnp.asarray(p)) for p in (beyond, within)), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_a_panorama_shows_a_ball_wherever_one_of_its_pixels_does_and_hardly_elsewhere() -> None:
    """At the poles too, and across the picture's left and right edges."""
    width, rows = 90, 45
    across, down = width / (2 * np.pi), rows / np.pi
    random = np.random.default_rng(0)
    shown = near = 0
    for _ in range(2000):
        x, y = random.integers(width), random.integers(rows)
        table = np.zeros((rows + 1, width + 1), np.int32)
        table[y + 1 :, x + 1 :] = 1
        longitude, latitude = random.uniform(-np.pi, np.pi), np.arcsin(random.uniform(-1, 1))
        angle = random.uniform(0.02, 0.5)
        u, v = across * longitude + width / 2, down * latitude + rows / 2
        found = _in_panorama(table, u, v, latitude, angle, across, down)
        within = np.linspace(0, 1, 9)
        a, b = np.meshgrid((x + within - width / 2) / across, (y + within - rows / 2) / down)
        cosines = np.sin(b) * np.sin(latitude) + np.cos(b) * np.cos(latitude) * np.cos(a - longitude)
        meets = np.arccos(np.clip(cosines, -1, 1)).min() < angle - 1e-6
        assert found or not meets
        shown, near = shown + found, near + meets
    assert 30 < near <= shown < 1.5 * near
