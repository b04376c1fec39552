"""A bake of an unbounded scene: one grid over all of contracted space, or a plain pack of a box in its inner cube."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from baker.baking.bake import bake
from baker.baking.config import BakeConfig
from baker.tuning.joint_loop import shown_psnr
from console import UserError
from tests.training.test_captures import circle, write_transforms
from training.config import QUICK
from training.multires.config import MultiresConfig
from training.run import Run, start_run
from training.scenes import SceneOptions

SMALL = MultiresConfig(resolutions=(16, 32, 64, 128), occupancy=32, samples_per_step=8192, steps_across=(32, 64, 96))
STEPS = 60


def paint_sky(path: Path, poses: np.ndarray) -> None:
    """Photographs of waves of colour infinitely far away, in place of those in images/."""
    y, x = np.mgrid[0:20, 0:30] + 0.5
    rays = np.stack([(x - 14) / 33, (11 - y) / 34, -np.ones_like(x)], -1)
    for i, pose in enumerate(poses):
        directions = rays @ pose[:3, :3].T
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        colour = 0.5 + 0.4 * np.sin(4 * directions + [0.0, 1.0, 2.0])
        Image.fromarray(np.round(255 * colour).astype(np.uint8)).save(path / f"images/{i:03d}.png")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("unbounded")
    paint_sky(write_transforms(folder / "scene", circle()), circle())
    config = dataclasses.replace(QUICK, steps=STEPS, multires=SMALL)
    run = start_run(folder / "run", folder / "scene", config, SceneOptions())
    for step in range(STEPS):
        run.state, _ = run.method.step(run.state, step)
    run.step = STEPS
    return run


def test_what_is_infinitely_far_away_is_in_the_pack(run: Run) -> None:
    ids = jnp.arange(run.dataset.count)
    error = run.method.render(run.state, run.dataset.geometry_at(ids)).rgb - run.dataset.colours_at(ids)
    of_field = -10 * np.log10(np.square(error).mean())
    pack = bake(run, BakeConfig(resolution=90, quality="draft"))
    assert pack.contraction == run.dataset.facts.contraction is not None
    of_pack = shown_psnr(pack, run.dataset, 0)
    assert of_field > 12.5, "more than one grey: 11 dB"
    assert of_pack > of_field - 0.5, (of_field, of_pack)


def test_a_box_is_baked_without_contraction(run: Run) -> None:
    inner = run.dataset.facts.contraction
    assert inner is not None
    half = 0.5 * inner
    pack = bake(run, BakeConfig(resolution=60, quality="draft", aabb=(-half, -half, -half, half, half, half)))
    assert pack.contraction is None
    assert pack.voxel_size == pytest.approx(inner / 60)
    with pytest.raises(UserError, match="no photograph sees this box"):
        bake(run, BakeConfig(resolution=60, aabb=(5.0, 5.0, 5.0, 6.0, 6.0, 6.0)))
