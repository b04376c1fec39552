"""The two engines from the first step on: given the same rays they end at the same quality.

With rays of their own, their luck is worth 0.1 to 0.3 dB here.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from tests.training.voxels.test_fused import CONFIG, VOXELS
from training.dataset import RayDataset, make_dataset
from training.marching.rays import to_grid
from training.metrics import psnr
from training.scenes import load_pixels, load_scene
from training.scenes.pictures import over_background
from training.scenes.scene import Scene
from training.voxels.fused import engine as fused_engine
from training.multires.fused.rays import Batch
from training.voxels.lists import rays_with_content
from training.voxels.method import VoxelMethod
from training.voxels.step import draw

pytestmark = pytest.mark.slow

# Refined, pruned, and sampled finer. A step has room for more samples than its rays have: what does not fit the lists of the JAX
# step is left out there, and of few rays that is a share which counts.
PASSING_ALL = dataclasses.replace(
    VOXELS, resolutions=(24, 48), stage_starts=(0.0, 0.5), prunings=(0.75,), samples_per_step=32_768
)
STEPS = 300
drawn_by_jax = jax.jit(draw, static_argnames=("rays", "settings"))


class Twin:
    """A fused method that draws as the JAX engine does: the same rays, backgrounds, phases and windows, as many."""

    def __init__(self, method: VoxelMethod, rays: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
        self.method, self.engine, self.rays = method, method.engine, rays
        self.key, self.picked = jax.random.key(method.config.seed), np.zeros(0, np.int32)
        monkeypatch.setattr(self.engine, "meeting", self.meeting)
        monkeypatch.setattr(self.engine, "draw", self.draw)
        monkeypatch.setattr(fused_engine, "windows", lambda *_: self.picked)

    def meeting(self, state: Any, ids: np.ndarray) -> np.ndarray:
        return rays_with_content(self.method.dataset, self.engine.end(state).layout, ids, state.step_voxels)

    def draw(self, state: Any, random: np.random.Generator, rays: int) -> Batch:
        stepper, plain = state.unpack(self.engine.settings, self.engine.workers), self.engine.end(state)
        step = min(state.updates, STEPS - 1)
        drawn = drawn_by_jax(
            plain.stage, self.method.dataset, self.key, np.int32(step), self.rays[step], self.engine.settings
        )
        row_of = np.empty(len(stepper.grid.order), np.int32)
        row_of[stepper.grid.order] = np.arange(len(row_of), dtype=np.int32)
        self.picked = row_of[np.asarray(drawn.picked)]
        grid = to_grid(plain.layout, drawn.rays)
        arrays = (grid.origins, grid.directions, grid.start, grid.end, grid.length, drawn.rays.viewdirs, drawn.target,
                  drawn.background, drawn.phase)  # fmt: skip
        return Batch(*(np.ascontiguousarray(np.asarray(a, np.float32)) for a in arrays))


def reached(method: VoxelMethod, scene: Scene, dataset: RayDataset) -> tuple[float, list[int], int]:
    """PSNR of the test views after STEPS steps, the rays of each step, and the voxels that are left."""
    state, rays, found = method.start(jax.random.key(0)), [], []
    for step in range(STEPS):
        state, _ = method.step(state, step)
        rays.append(state.rays)
    for view in scene.splits["test"]:
        camera = view.camera
        pixels = load_pixels([view]).reshape(camera.height, camera.width, 4) / np.float32(255)
        picture = np.asarray(method.render(state, dataset.view_rays(camera)).rgb).reshape(*pixels.shape[:2], 3)
        found.append(psnr(picture, over_background(pixels, scene.background)))
    return float(np.mean(found)), rays, len(method.save(state)["cells"]) - 1


def test_both_engines_end_at_the_same_quality(procedural_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = dataclasses.replace(CONFIG, steps=STEPS, voxels=PASSING_ALL)
    scene = load_scene(procedural_path)
    dataset = make_dataset(scene)
    known, rays, voxels = reached(VoxelMethod(dataclasses.replace(config, engine="jax"), dataset), scene, dataset)
    twin = Twin(VoxelMethod(config, dataset), rays, monkeypatch)
    same, _, kept = reached(twin.method, scene, dataset)
    assert known > 19 and voxels < 0.6 * 48**3, "something was learnt, and pruned"
    assert abs(same - known) < 0.02 and abs(kept - voxels) < 0.01 * voxels
