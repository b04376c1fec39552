"""python -m tools.profile_step: the parts of a step add up to it, and profiling is training."""

import dataclasses
import json
from pathlib import Path

import jax
import numpy as np
import pytest

from tools.profile_step import PARTS, main, profile
from training.config import QUICK
from training.dataset import make_dataset
from training.multires.config import MultiresConfig
from training.multires.method import MultiresMethod
from training.scenes import Scene

SMALL = MultiresConfig(resolutions=(8, 16), occupancy=16, samples_per_step=2048, steps_across=(16, 16, 16))
TINY = dataclasses.replace(QUICK, steps=20, multires=SMALL)

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("hardly_optimised")]


@pytest.mark.parametrize("engine", ["fused", "jax"])
def test_profiling_trains_on_with_the_very_steps_of_training(procedural_scene: Scene, engine: str) -> None:
    method = MultiresMethod(dataclasses.replace(TINY, engine=engine), make_dataset(procedural_scene))
    trained, profiled = (method.start(jax.random.PRNGKey(0)) for _ in range(2))
    measured = profile(method, profiled, 0, 2)
    for step in range(3):
        trained, metrics = method.step(trained, step)
    assert set(measured.parts) == set(PARTS[engine]) and measured.facts["rays"] == int(metrics["rays"])
    assert measured.facts["rows"] == len(trained.values.table)
    for ours, theirs in zip(profiled.values, trained.values, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-5)


def test_photographs_become_a_table_and_json(procedural_path, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("training.config.PRESETS", {"quick": TINY})
    words = [str(procedural_path), "--steps", "3", "--rounds", "2"]
    assert main([*words, "--json", str(tmp_path / "p.json"), "--markdown", str(tmp_path / "p.md")]) == 0
    figures = json.loads((tmp_path / "p.json").read_text())
    assert figures["step"] == 3 and figures["step_ms"] > 0 and figures["samples_per_cpu_second"] > 0
    assert set(figures["parts"]) == set(PARTS[figures["engine"]])
    assert capsys.readouterr().out == (tmp_path / "p.md").read_text()


def test_only_runs_of_the_field_can_be_profiled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(Path(__file__).parents[1] / "data" / "runs" / "nerf")]) == 2
    assert "only the multi-resolution field can be profiled" in capsys.readouterr().err
