"""Baking loses little of captures: of forward-facing ones up to the far plane, of those seen from all around, and of unbounded
scenes, which are one grid over all of contracted space, or a plain pack of a box in its inner cube.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from baker.baking.bake import bake
from baker.baking.config import BakeConfig
from baker.tuning.joint_tuning import shown_psnr
from console import UserError
from tests.training.test_captures import circle, forward, write_llff, write_transforms
from training.config import QUICK, TINY, TrainConfig
from training.multires.config import MultiresConfig
from training.run import Run, start_run
from training.scenes import SceneOptions

DEPTH = 200.0  # of the wall, a hundred times the nearest depth: at the far plane in NDC
CENTRE, RADIUS = np.array([1.0, -2.0, 0.5]), 1.0  # of the ball that the cameras of circle() look at
SMALL = MultiresConfig(
    resolutions=(16, 32, 64, 128), occupancy=32, samples_per_step=8192, steps_across=(32, 64, 96), steps_from=(0.25, 0.85)
)  # fmt: skip
LLFF = 40, 32, 50.0, 50.0, 20.0, 16.0  # width, height, fx, fy, cx, cy of the photographs, px
TRANSFORMS = 30, 20, 33.0, 34.0, 14.0, 11.0


def paint(scene: Path, poses: np.ndarray, lens: tuple[float, ...], colour_of: Callable[..., np.ndarray]) -> None:
    """Puts pictures in place of the scene's. colour_of: by pose [4, 4] and directions [h, w, 3] in world axes, 0 … 1."""
    width, height, fx, fy, cx, cy = lens
    y, x = np.mgrid[0:height, 0:width] + 0.5
    rays = np.stack([(x - cx) / fx, (cy - y) / fy, -np.ones_like(x)], -1)
    for file, pose in zip(sorted((scene / "images").iterdir()), poses, strict=True):
        colour = colour_of(pose, rays @ pose[:3, :3].T)
        Image.fromarray(np.round(255 * colour).astype(np.uint8)).save(file)


def waves(places: np.ndarray) -> np.ndarray:
    return 0.5 + 0.4 * np.sin(places + np.arange(3))


def trained(folder: Path, config: TrainConfig) -> Run:
    """A run on folder / "scene"."""
    run = start_run(folder / "run", folder / "scene", config, SceneOptions())
    for step in range(config.steps):
        run.state, _ = run.method.step(run.state, step)
    run.step = config.steps
    return run


def field_psnr(run: Run) -> float:
    """dB over the training rays."""
    ids = jnp.arange(run.dataset.count)
    error = run.method.render(run.state, run.dataset.geometry_at(ids)).rgb - run.dataset.colours_at(ids)
    return float(-10 * np.log10(np.square(error).mean()))


def field_and_pack(folder: Path, steps: int) -> tuple[float, float]:
    """PSNR (dB) of a small MLP, and of its bake."""
    run = trained(folder, replace(TINY, steps=steps))
    return field_psnr(run), shown_psnr(bake(run, BakeConfig(45, "paper", "draft")), run.dataset, 0)


@pytest.mark.slow
def test_a_forward_facing_mlp_loses_nothing_at_the_far_plane_when_it_is_baked(tmp_path: Path) -> None:
    poses = forward()
    wall = poses[:, 2, 3].mean() - DEPTH

    def colour(pose: np.ndarray, rays: np.ndarray) -> np.ndarray:
        place = pose[:2, 3] + ((wall - pose[2, 3]) / rays[..., 2])[..., None] * rays[..., :2]
        return waves(12 / DEPTH * place[..., [0, 1, 0]])

    paint(write_llff(tmp_path / "scene", poses), poses, LLFF, colour)
    of_field, of_pack = field_and_pack(tmp_path, 80)
    assert of_field > 13.5 and of_pack > of_field - 1, "with an endless last interval: 16.9 and 10.9 dB"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*--spherify")
def test_an_mlp_with_samples_even_in_disparity_loses_nothing_when_it_is_baked(tmp_path: Path) -> None:
    def colour(pose: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """A coloured ball before white."""
        eye, rays = pose[:3, 3] - CENTRE, rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        hit = np.square(rays @ eye) - (eye @ eye - RADIUS**2)
        t = -(rays @ eye) - np.sqrt(np.maximum(hit, 0))
        return np.where(hit[..., None] > 0, waves(2 * (eye + t[..., None] * rays)), 1.0)

    paint(write_llff(tmp_path / "scene", circle()), circle(), LLFF, colour)
    of_field, of_pack = field_and_pack(tmp_path, 120)
    assert of_field > 15 and of_pack > of_field - 1, "one colour everywhere: 10.9 dB"


@pytest.fixture(scope="module")
def unbounded(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run on waves of colour infinitely far away."""
    folder = tmp_path_factory.mktemp("unbounded")
    scene = write_transforms(folder / "scene", circle())
    paint(scene, circle(), TRANSFORMS, lambda _, rays: waves(4 * rays / np.linalg.norm(rays, axis=-1, keepdims=True)))
    return trained(folder, replace(QUICK, steps=60, multires=SMALL))


def test_what_is_infinitely_far_away_is_in_the_pack(unbounded: Run) -> None:
    pack, of_field = bake(unbounded, BakeConfig(resolution=90, quality="draft")), field_psnr(unbounded)
    assert pack.contraction == unbounded.dataset.facts.contraction is not None
    of_pack = shown_psnr(pack, unbounded.dataset, 0)
    assert of_field > 12.5, "more than one grey: 11 dB"
    assert of_pack > of_field - 0.5, (of_field, of_pack)


def test_a_box_is_baked_without_contraction(unbounded: Run) -> None:
    inner = unbounded.dataset.facts.contraction
    assert inner is not None
    half = 0.5 * inner
    pack = bake(unbounded, BakeConfig(resolution=40, quality="draft", aabb=(-half, -half, -half, half, half, half)))
    assert pack.contraction is None
    assert pack.voxel_size == pytest.approx(inner / 40)
    with pytest.raises(UserError, match="no photograph sees this box"):
        bake(unbounded, BakeConfig(resolution=60, aabb=(5.0, 5.0, 5.0, 6.0, 6.0, 6.0)))
