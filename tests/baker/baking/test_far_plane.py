"""The paper's MLP keeps its opacity when captures are baked: forward-facing ones, up to the far plane, and others."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from baker.baking.bake import bake
from baker.baking.config import BakeConfig
from baker.tuning.joint_loop import shown_psnr
from tests.training.test_captures import circle, forward, write_llff
from training.config import TINY
from training.run import start_run
from training.scenes import SceneOptions

DEPTH = 200.0  # of the wall, a hundred times the nearest depth: at the far plane in NDC
CENTRE, RADIUS = np.array([1.0, -2.0, 0.5]), 1.0  # of the ball that the cameras of circle() look at


def rays_of(pose: np.ndarray) -> np.ndarray:
    """Directions [32, 40, 3], in world axes, of the pixels of write_llff's cameras; 1 along the optical axis."""
    y, x = np.mgrid[0:32, 0:40] + 0.5
    return np.stack([(x - 20) / 50, (16 - y) / 50, -np.ones_like(x)], -1) @ pose[:3, :3].T


def save(path: Path, i: int, colour: np.ndarray) -> None:
    """In place of a photograph of write_llff."""
    Image.fromarray(np.round(255 * colour).astype(np.uint8)).save(path / f"images/img_{i:02d}.png")


def field_and_pack(path: Path, steps: int) -> tuple[float, float]:
    """PSNR (dB) over the training rays of a small MLP that is trained on path / "scene", and of its bake."""
    run = start_run(path / "run", path / "scene", dataclasses.replace(TINY, steps=steps), SceneOptions())
    for step in range(steps):
        run.state, _ = run.method.step(run.state, step)
    ids = jnp.arange(run.dataset.count)
    error = run.method.render(run.state, run.dataset.geometry_at(ids)).rgb - run.dataset.colours_at(ids)
    pack = bake(run, BakeConfig(60, "paper", "draft"))
    return float(-10 * np.log10(np.square(error).mean())), shown_psnr(pack, run.dataset, 0)


def test_a_forward_facing_mlp_loses_nothing_at_the_far_plane_when_it_is_baked(tmp_path: Path) -> None:
    scene, poses = write_llff(tmp_path / "scene", forward()), forward()
    for i, pose in enumerate(poses):  # a wall of coloured waves
        rays = rays_of(pose)
        t = (poses[:, 2, 3].mean() - DEPTH - pose[2, 3]) / rays[..., 2]
        place = pose[:2, 3] + t[..., None] * rays[..., :2]
        save(scene, i, 0.5 + 0.4 * np.sin(12 / DEPTH * place[..., [0, 1, 0]] + [0.0, 1.0, 2.0]))
    of_field, of_pack = field_and_pack(tmp_path, 80)
    assert of_field > 13.5 and of_pack > of_field - 1, "with an endless last interval: 16.9 and 10.9 dB"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*--spherify")
def test_an_mlp_with_samples_even_in_disparity_loses_nothing_when_it_is_baked(tmp_path: Path) -> None:
    scene = write_llff(tmp_path / "scene", circle())
    for i, pose in enumerate(circle()):  # a coloured ball before white
        rays, eye = rays_of(pose), pose[:3, 3] - CENTRE
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        hit = np.square(rays @ eye) - (eye @ eye - RADIUS**2)
        t = -(rays @ eye) - np.sqrt(np.maximum(hit, 0))
        colour = 0.5 + 0.4 * np.sin(2 * (eye + t[..., None] * rays) + [0.0, 1.0, 2.0])
        save(scene, i, np.where(hit[..., None] > 0, colour, 1.0))
    of_field, of_pack = field_and_pack(tmp_path, 120)
    assert of_field > 15 and of_pack > of_field - 1, "one colour everywhere: 10.9 dB"
