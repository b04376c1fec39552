"""What a run takes is counted as the run itself counts it."""

from __future__ import annotations

import dataclasses

import pytest

from training.config import PRESETS as CONFIGS
from training.dataset import make_dataset
from training.scenes import Scene
from training.speed import PRESETS, whole_runs
from training.voxels.settings import plan_of


@pytest.mark.parametrize("preset", PRESETS)
def test_samples_are_those_of_the_plan(preset: str, procedural_scene: Scene) -> None:
    config, dataset = CONFIGS[preset], make_dataset(procedural_scene)
    camera = procedural_scene.splits["train"][0].camera
    side = max(camera.width, camera.height)
    plan = plan_of(config, dataset)
    assert whole_runs([side], False)[preset][side]["samples"] == config.steps * plan.samples
    same = dataclasses.replace(
        config, voxels=dataclasses.replace(config.voxels, resolutions=config.voxels.ndc_resolutions)
    )
    forward = plan_of(same, dataset)  # whose grids have another size whatever the photographs'
    assert preset == "fast" or whole_runs([side], True)[preset][side]["samples"] == config.steps * forward.samples


def test_larger_photographs_take_more_of_both_until_the_grid_is_as_fine_as_it_gets() -> None:
    runs = whole_runs([100, 300, 800, 1600], False)["cpu"]
    for key in ("samples", "disk"):
        assert runs[100][key] <= runs[300][key] < runs[800][key] == runs[1600][key]
    assert runs[100]["disk"] < runs[300]["disk"]
