"""Training on photographs whose exposures differ: both engines see alike, learn the average look, and go on where they were."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from console import UserError
from tests.training.test_captures import circle, write_transforms
from training.config import CPU, PRESETS, TrainConfig, from_json, to_json
from training.dataset import RayDataset, make_dataset
from training.exposure import FITTED_FROM
from training.methods import make_method
from training.metrics import psnr
from training.scenes import load_scene
from training.scenes.pictures import over_background
from training.scenes.procedural import write_procedural_scene
from training.voxels.config import VoxelConfig
from training.voxels.holes import _walled
from training.voxels.method import VoxelMethod
from training.voxels.settings import plan_of

pytest.importorskip("numba", reason="the fused engine needs Numba: pip install 'snerg[train]'")

from training.multires.fused.rays import empty_batch, fill_batch, photographs_of

ENGINES = ("fused", "jax")
VOXELS = VoxelConfig(resolutions=(20, 40), stage_starts=(0.0, 0.3), prunings=(0.1, 0.5), samples_per_step=6144)
CONFIG = dataclasses.replace(CPU, steps=600, batch_size=1024, voxels=VOXELS)


@pytest.fixture(scope="module")
def steady(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of one exposure, 24 + 4 views of 40 x 40 pixels."""
    return write_procedural_scene(tmp_path_factory.mktemp("steady") / "scene", size=40, views=24, subpixels=2)


@pytest.fixture(scope="module")
def flickering(steady: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same; its training photographs are brighter, darker and tinted by turns, those held out are as before."""
    folder = tmp_path_factory.mktemp("flickering") / "scene"
    shutil.copytree(steady, folder)
    frames = json.loads((folder / "transforms_train.json").read_text())["frames"]
    for frame, gain in zip(frames, flicker(len(frames)), strict=True):
        file = folder / f"{frame['file_path']}.png"
        with Image.open(file) as opened:
            rgba = np.asarray(opened.convert("RGBA"), np.float32)
        rgba = np.concatenate([np.clip(rgba[..., :3] * gain, 0, 255), rgba[..., 3:]], -1)
        Image.fromarray(np.rint(rgba).astype(np.uint8)).save(file)
    return folder


def flicker(views: int) -> np.ndarray:
    """Gains [V, 3] of ±25 % in all and ±5 % of each channel, whose mean logarithm is 0."""
    rng = np.random.default_rng(3)
    logs = np.log(rng.uniform(0.75, 1.25, (views, 1)) * rng.uniform(0.95, 1.05, (views, 3)))
    return np.exp(logs - logs.mean(0))


@pytest.fixture
def dataset(flickering: Path) -> RayDataset:
    return make_dataset(load_scene(flickering))


def test_corrected_colours_are_those_of_the_dataset_in_the_fused_loops_too(dataset: RayDataset) -> None:
    corrected = dataset.in_average_look(flicker(dataset.views).astype(np.float32))
    ids = np.random.default_rng(0).integers(0, dataset.count, 500)
    batch = empty_batch(len(ids))
    batch.background[:] = np.random.default_rng(1).random((500, 3))
    low, high = (np.asarray(v, np.float64) for v in dataset.aabb)
    photographs = photographs_of(dataset)._replace(gains=np.array(corrected.gains))
    fill_batch(photographs, ids, low, (high - low) / 8, np.full(3, 8), batch, 0, len(ids))
    expected = np.asarray(corrected.colours_over(jnp.asarray(ids, jnp.int32), jnp.asarray(batch.background)))
    np.testing.assert_allclose(batch.target, expected, atol=1e-5)
    assert (
        np.abs(expected - dataset.colours_over(jnp.asarray(ids, jnp.int32), jnp.asarray(batch.background))).max() > 0.1
    )
    pixels = np.asarray(dataset.pixels_at(jnp.asarray(ids, jnp.int32)))
    clear, clipped = pixels[:, 3] == 0, (pixels[:, :3] == 255) & (pixels[:, 3:] == 255)
    assert clear.any() and clipped.any()
    np.testing.assert_allclose(expected[clear], batch.background[clear], atol=1e-6, err_msg="no photograph shows it")
    np.testing.assert_allclose(expected[clipped], 1.0, atol=1e-6, err_msg="what is clipped stays white")


def trained(path: Path, config: TrainConfig) -> tuple[float, VoxelMethod, Any]:
    """PSNR (dB) of the held-out views, the method and its last state."""
    scene = load_scene(path)
    dataset = make_dataset(scene)
    method = VoxelMethod(config, dataset)
    state = method.start(jax.random.key(0))
    for step in range(config.steps):
        state, _ = method.step(state, step)
    scores = []
    for view in scene.splits["test"]:
        truth = over_background(view.load(), scene.background)
        rgb = np.asarray(method.render(state, dataset.view_rays(view.camera)).rgb)
        scores.append(psnr(np.clip(rgb, 0, 1).reshape(truth.shape), truth))
    return float(np.mean(scores)), method, state


def test_most_of_what_different_exposures_cost_is_won_back(steady: Path, flickering: Path) -> None:
    off, on = (dataclasses.replace(CONFIG, engine="fused", exposure=choice) for choice in ("off", "on"))
    best, worst = trained(steady, off)[0], trained(flickering, off)[0]
    corrected, method, state = trained(flickering, on)
    assert best - worst > 0.5, "exposures cost something"
    assert corrected - worst > 0.6 * (best - worst), "3 in 4 dB, as measured"
    gains = method.gains(state)
    assert gains is not None
    np.testing.assert_allclose(np.log(gains).mean(0), 0.0, atol=1e-4)
    right = np.log(flicker(len(gains)))
    assert np.corrcoef(right.ravel(), np.log(gains).ravel())[0, 1] > 0.9


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_with_gains_goes_on_to_the_byte(dataset: RayDataset, engine: str) -> None:
    voxels = dataclasses.replace(VOXELS, resolutions=(16,), stage_starts=(0.0,), prunings=(), samples_per_step=2048)
    method = VoxelMethod(
        dataclasses.replace(CONFIG, exposure="on", engine=engine, batch_size=256, voxels=voxels), dataset
    )
    state = method.engine.with_gains(method.start(jax.random.key(0)), flicker(dataset.views).astype(np.float32))
    for step in range(3):
        state, _ = method.step(state, step)
    saved = {name: array.copy() for name, array in method.save(state).items()}
    np.testing.assert_array_equal(saved["gains"], flicker(dataset.views).astype(np.float32))
    again = method.restore(saved)
    for step in range(FITTED_FROM - 1, FITTED_FROM + 2):
        state, _ = method.step(state, step)
        again, _ = method.step(again, step)
    assert all(np.array_equal(method.save(again)[name], array) for name, array in method.save(state).items())
    assert (method.save(state)["gains"] != saved["gains"]).any()


@pytest.mark.parametrize("engine", ENGINES)
def test_gains_stay_where_the_grid_is_another_and_holes_are_closed(dataset: RayDataset, engine: str) -> None:
    voxels = dataclasses.replace(VOXELS, resolutions=(12, 24), samples_per_step=2048)
    method = VoxelMethod(dataclasses.replace(CONFIG, exposure="on", engine=engine, voxels=voxels), dataset)
    gains = flicker(dataset.views).astype(np.float32)
    state = method.engine.with_gains(method.start(jax.random.key(0)), gains)
    occupancy = method.engine.occupancy(state)
    kept = np.arange(np.count_nonzero(occupancy.present) + 1)
    state = method.engine.regrid(state, occupancy, kept)
    state = method.engine.draw_from(state, *method.engine.drawn(state))
    np.testing.assert_array_equal(np.asarray(method.gains(state)), gains)
    walls = np.zeros_like(occupancy.present)
    walls[:2] = True
    walled = _walled(method.engine.end(state), occupancy, walls, method.settings)
    np.testing.assert_array_equal(np.asarray(walled.gains), gains)


def test_a_checkpoint_without_gains_begins_with_none_and_damaged_ones_are_refused(dataset: RayDataset) -> None:
    on, off = (VoxelMethod(dataclasses.replace(CONFIG, exposure=word), dataset) for word in ("on", "off"))
    without, with_some = off.save(off.start(jax.random.key(0))), on.save(on.start(jax.random.key(0)))
    assert "gains" not in without
    np.testing.assert_array_equal(on.gains(on.restore(without)), np.ones((dataset.views, 3), np.float32))
    assert off.gains(off.restore(without)) is None
    for values in (with_some["gains"][:-1], 1e3 * with_some["gains"], np.nan * with_some["gains"]):
        with pytest.raises(UserError, match='"gains" does not fit'):
            on.restore({**with_some, "gains": values})
    with pytest.raises(UserError, match="exposures are not fitted"):
        off.restore(with_some)


def test_exposures_are_fitted_of_what_cameras_took_unless_told_otherwise(flickering: Path, tmp_path: Path) -> None:
    rendered = make_dataset(load_scene(flickering))
    taken = make_dataset(load_scene(write_transforms(tmp_path / "capture", circle())))
    for word, expected in (("auto", (False, True)), ("on", (True, True)), ("off", (False, False))):
        config = dataclasses.replace(CONFIG, exposure=word)
        assert tuple(plan_of(config, dataset).gains for dataset in (rendered, taken)) == expected
    assert CONFIG.exposure == "auto"
    older = {name: value for name, value in to_json(CONFIG).items() if name != "exposure"}
    assert from_json(type(CONFIG), older, "config.json").exposure == "off", "an older run goes on as it began"
    with pytest.raises(UserError, match="voxels"):
        make_method(dataclasses.replace(PRESETS["tiny"], exposure="on"), rendered)
