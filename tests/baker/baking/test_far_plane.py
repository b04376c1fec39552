"""The paper's MLP keeps its opacity when a forward-facing scene is baked, up to the far plane (SNeRG section 5.3)."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from baker.baking.bake import bake
from baker.baking.config import BakeConfig
from baker.tuning.joint_loop import shown_psnr
from tests.training.test_captures import forward, write_llff
from training.config import TINY
from training.run import start_run
from training.scenes import SceneOptions

pytestmark = pytest.mark.slow

DEPTH, STEPS = 200.0, 80  # of the wall, a hundred times the nearest depth: at the far plane in NDC


def paint_wall(path: Path, poses: np.ndarray) -> None:
    """Photographs of a wall of coloured waves, in place of those in images/."""
    y, x = np.mgrid[0:32, 0:40] + 0.5
    rays = np.stack([(x - 20) / 50, (16 - y) / 50, -np.ones_like(x)], -1)
    for i, pose in enumerate(poses):
        directions = rays @ pose[:3, :3].T
        t = (poses[:, 2, 3].mean() - DEPTH - pose[2, 3]) / directions[..., 2]
        place = pose[:2, 3] + t[..., None] * directions[..., :2]
        colour = 0.5 + 0.4 * np.sin(12 / DEPTH * place[..., [0, 1, 0]] + [0.0, 1.0, 2.0])
        Image.fromarray(np.round(255 * colour).astype(np.uint8)).save(path / f"images/img_{i:02d}.png")


def test_a_forward_facing_mlp_loses_nothing_at_the_far_plane_when_it_is_baked(tmp_path: Path) -> None:
    paint_wall(write_llff(tmp_path / "scene", forward()), forward())
    run = start_run(tmp_path / "run", tmp_path / "scene", dataclasses.replace(TINY, steps=STEPS), SceneOptions())
    for step in range(STEPS):
        run.state, _ = run.method.step(run.state, step)
    ids = jnp.arange(run.dataset.count)
    error = run.method.render(run.state, run.dataset.geometry_at(ids)).rgb - run.dataset.colours_at(ids)
    of_field = -10 * np.log10(np.square(error).mean())
    of_pack = shown_psnr(bake(run, BakeConfig(60, "paper", "draft")), run.dataset, 0)
    assert of_field > 13.5 and of_pack > of_field - 1, "with an endless last interval: 16.9 and 10.9 dB"
