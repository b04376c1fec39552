"""python -m training.profile_step: the parts of a step add up to it, and profiling is training."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import jax
import numpy as np
import pytest

from training import profile_step
from training.config import CPU
from training.dataset import make_dataset
from training.methods import make_method
from training.profile_step import PARTS, Profile, main, profile
from training.scenes import Scene

SMALL = dataclasses.replace(CPU.voxels, resolutions=(24, 32, 48), samples_per_step=4096)
TINY = dataclasses.replace(CPU, steps=20, batch_size=256, voxels=SMALL)


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("compiled_quickly")]


@pytest.fixture
def tiny_cpu(monkeypatch) -> None:
    """The preset cpu, as small as can be."""
    monkeypatch.setattr("training.config.PRESETS", {"cpu": TINY})


def test_each_part_is_what_its_program_takes_longer_than_the_one_before():
    ends = (1, 4, 5, 6, 9, 20, 22, 32)  # of the programs up to draw ... variation, and of the whole step
    names = [*list(PARTS)[:7], "step"]
    rounds = {name: np.array([end, 2.0 * end]) for name, end in zip(names, ends, strict=True)}
    rounds["remember"] = np.array([50.0, 100.0])
    parts = profile_step._differences(rounds, 50)
    assert dict(zip(PARTS, (1, 3, 1, 1, 3, 11, 2, 10, 1), strict=True)) == pytest.approx(
        {name: ms / 1.5 for name, ms in parts.items()}
    )
    shares = Profile({**parts, "march": -1.0}, 48.0, {}).shares
    assert shares["march"] == 0 and sum(shares.values()) == pytest.approx(1) and set(shares) == set(PARTS)


def test_profiling_trains_on_with_the_very_steps_of_training(procedural_scene: Scene):
    method = make_method(TINY, make_dataset(procedural_scene))
    trained, profiled = (method.start(jax.random.PRNGKey(0)) for _ in range(2))
    kept: list[np.ndarray] = []

    def keep(share: float) -> None:
        kept.append(share)

    measured = profile(method, profiled, 0, 2, keep)
    for step in range(3):
        trained, metrics = method.step(trained, step)
    assert measured.facts["samples"] == int(metrics["samples"]) and measured.facts["rays"] == trained.rays
    assert kept[-1] == 1.0 and measured.facts["voxels"] == len(trained.trainable.rows) - 1


def test_the_program_up_to_the_gradient_has_the_steps_own_gradient(procedural_scene: Scene):
    method = make_method(TINY, make_dataset(procedural_scene))
    state = method.start(jax.random.PRNGKey(0))
    gradient, loss, _ = profile_step._programs(method.engine, state)["variation"](state, 0)
    gradient = np.asarray(gradient.rows)
    after, metrics = method.step(state, 0)
    assert float(loss) == pytest.approx(float(metrics["loss"]), rel=1e-5)
    moved = np.asarray(after.first.rows)  # Adam's first moment: a tenth of the gradient, where density has one
    seen = (gradient[:, :1] != 0) & (np.arange(len(gradient)) > 0)[:, None]
    np.testing.assert_allclose(moved, 0.1 * gradient * seen, rtol=1e-4, atol=1e-6 * np.abs(moved).max())


def test_photographs_become_a_table_and_json(procedural_path: Path, tmp_path: Path, capsys, tiny_cpu):
    words = [str(procedural_path), "--steps", "3", "--rounds", "2"]
    assert main([*words, "--json", str(tmp_path / "p.json"), "--markdown", str(tmp_path / "p.md")]) == 0
    figures = json.loads((tmp_path / "p.json").read_text())
    assert set(figures["parts"]) == set(PARTS) and figures["step"] == 3 and figures["step_ms"] > 0
    assert sum(part["share"] for part in figures["parts"].values()) == pytest.approx(1, abs=1e-3)
    table = (tmp_path / "p.md").read_text()
    assert capsys.readouterr().out == table and all(f"| {name} |" in table for name in PARTS)


def test_what_cannot_be_profiled_gets_one_line(procedural_path: Path, tmp_path: Path, capsys):
    assert main([str(procedural_path), "--rounds", "0"]) == 2
    assert "--rounds" in capsys.readouterr().err
    (tmp_path / "config.json").write_text(
        json.dumps({"format": 1, "scene": "s", "scene_options": {}, "config": {"method": "nerf"}})
    )
    assert main([str(tmp_path)]) == 2
    assert "voxel method" in capsys.readouterr().err
