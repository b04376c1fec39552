"""Scenes written otherwise have the same rays; `python -m tests.fuzz.spellings` tries more."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.fuzz.spellings import differs, trial, true_cameras, write_scene
from training.scenes import load_scene


@pytest.mark.filterwarnings("ignore::console.Notice")
def test_a_scene_has_the_same_rays_however_it_is_written(tmp_path: Path):
    assert {seed: found for seed in range(30) if (found := trial(seed, tmp_path / str(seed)))} == {}


@pytest.mark.filterwarnings("ignore::console.Notice")
def test_a_camera_that_changed_is_noticed(tmp_path: Path):
    random = Random(3)
    cameras = true_cameras(random)
    scene, stems = tmp_path / "scene", write_scene(tmp_path / "scene", cameras, random)
    moved = cameras[1].world_T_camera.copy()
    moved[0, 3] += 1e-3 * np.linalg.norm(moved[:3, 3])
    changes = (
        {"fx": cameras[1].fx * 1.001},
        {"cy": cameras[1].cy + 0.01},
        {"distortion": (0.2, 0, 0, 0)},
        {"world_T_camera": moved},
    )
    for change in changes:
        assert differs(load_scene(scene), [cameras[0], replace(cameras[1], **change), *cameras[2:]], stems)
