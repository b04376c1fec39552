"""What a run takes is counted as the run itself counts it."""

from __future__ import annotations

import pytest

from training.config import PRESETS as CONFIGS
from training.dataset import make_dataset
from training.multires.settings import plan_of
from training.scenes import Scene
from training.scenes.presets import PresetName
from training.speed import PRESETS, whole_runs


@pytest.mark.parametrize("preset", PRESETS)
def test_samples_are_those_of_the_plan(preset: PresetName, procedural_scene: Scene) -> None:
    config, dataset = CONFIGS[preset], make_dataset(procedural_scene)
    camera = procedural_scene.splits["train"][0].camera
    side = max(camera.width, camera.height)
    assert whole_runs([side])[preset][side]["samples"] == config.steps * plan_of(config, dataset).samples


def test_larger_photographs_take_more_of_both_until_the_field_is_as_fine_as_it_gets() -> None:
    runs = whole_runs([100, 250, 800, 1600])["quick"]
    for key in ("samples", "disk"):
        assert runs[100][key] <= runs[250][key] < runs[800][key] == runs[1600][key]
    assert runs[100]["disk"] < runs[250]["disk"]
