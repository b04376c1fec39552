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
from training.profile_report import (
    FUSED_PARTS,
    JAX_PARTS,
    EngineProfile,
    Profile,
    Stopwatch,
    Times,
    fused_profile,
    jax_profile,
)
from training.profile_step import main, profile
from training.scenes import Scene

SMALL = dataclasses.replace(CPU.voxels, resolutions=(24, 32, 48), samples_per_step=4096)
TINY = dataclasses.replace(CPU, steps=20, batch_size=256, voxels=SMALL)


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("hardly_optimised")]


@pytest.fixture
def tiny_cpu(monkeypatch) -> None:
    """The preset cpu, as small as can be."""
    monkeypatch.setattr("training.config.PRESETS", {"cpu": TINY})


def laps(ends: dict[str, float]) -> dict[str, np.ndarray]:
    """Two rounds, the second on a machine half as fast, of wall time and of twice as much CPU time."""
    return {name: np.array([[end, 2 * end], [2 * end, 4 * end]]) for name, end in ends.items()}


def test_each_part_is_what_its_program_takes_longer_than_the_one_before():
    ends = (1, 4, 5, 6, 9, 20, 22, 32)  # of the programs up to draw ... variation, and of the whole step
    names = [*list(JAX_PARTS)[:7], "step"]
    made = jax_profile(laps({**dict(zip(names, ends, strict=True)), "remember": 50.0}), 50, 640.0, 2, True)
    parts = dict(zip(JAX_PARTS, (1, 3, 1, 1, 3, 11, 2, 10, 1), strict=True))
    assert {name: times.wall / 1.5 for name, times in made.parts.items()} == pytest.approx(parts)
    assert made.step == pytest.approx((48.0, 96.0)) and made.samples_per_cpu_second == pytest.approx(640 / 0.096)
    assert made.shares["backward"] == pytest.approx(11 / 33)
    shares = EngineProfile({**made.parts, "march": Times(-1.0, -1.0)}, made.step, 1.0, 2).shares
    assert shares["march"] == 0 and sum(shares.values()) == pytest.approx(1) and set(shares) == set(JAX_PARTS)


def test_the_fused_step_is_the_sum_of_its_laps_and_a_chunk_is_taken_apart_by_shorter_passes():
    told = {"draw": 1, "render": 12, "variation": 1, "scatter": 4, "adam": 3, "remember": 100}
    passes = {"up to march": 5, "up to fetch": 9, "up to forward": 10}
    made = fused_profile(laps({**told, **passes}), 50, 2100.0, 2)
    parts = dict(zip(FUSED_PARTS, (1, 5, 4, 1, 2, 1, 4, 3, 2), strict=True))
    assert {name: times.wall / 1.5 for name, times in made.parts.items()} == pytest.approx(parts)
    assert made.step.wall == pytest.approx(1.5 * 21)
    slow = dataclasses.replace(made, step=Times(4 * made.step.wall, 2 * made.step.cpu))
    assert Profile(slow, made, {}).ratios() == {"ratio": 4.0, "cpu_ratio": 2.0}


def test_a_step_by_parts_is_a_step(procedural_scene: Scene):
    pytest.importorskip("numba", reason="pip install 'snerg[train]'")
    method = make_method(dataclasses.replace(TINY, engine="fused"), make_dataset(procedural_scene))
    whole, apart = (method.engine.remember(method.start(jax.random.PRNGKey(0))) for _ in range(2))
    whole, metrics = method.engine.step(whole, 0, 0.0)
    watch = Stopwatch()
    samples = profile_step._fused_round(method.engine, apart, 0, 0.0, watch)
    assert samples == metrics["samples"] and np.array_equal(whole.values.rows, apart.values.rows)
    assert set(watch.rounds()) == {"draw", "render", "variation", "scatter", "adam", "remember",
                                   "up to march", "up to fetch", "up to forward"}  # fmt: skip


def test_profiling_trains_on_with_the_very_steps_of_training(procedural_scene: Scene):
    method = make_method(TINY, make_dataset(procedural_scene))
    trained, profiled = (method.start(jax.random.PRNGKey(0)) for _ in range(2))
    kept: list[np.ndarray] = []

    def keep(share: float) -> None:
        kept.append(share)

    measured = profile(method, profiled, 0, 2, keep)
    for step in range(3):
        trained, metrics = method.step(trained, step)
    assert measured.jax.samples == int(metrics["samples"]) and measured.facts["rays"] == trained.rays
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
    assert figures["step"] == 3 and figures["step_ms"] > 0
    table = (tmp_path / "p.md").read_text()
    assert capsys.readouterr().out == table
    for found, parts in ((figures, JAX_PARTS), (figures.get("fused"), FUSED_PARTS)):
        if found is None:
            continue  # without Numba
        assert set(found["parts"]) == set(parts) and found["threads"] >= 1 and found["samples_per_cpu_second"] > 0
        assert sum(part["share"] for part in found["parts"].values()) == pytest.approx(1, abs=1e-3)
        assert all(f"| {name} | {what} |" in table for name, what in parts.items())
    assert "fused" not in figures or figures["fused"]["cpu_ratio"] > 0


def test_what_cannot_be_profiled_gets_one_line(procedural_path: Path, tmp_path: Path, capsys):
    assert main([str(procedural_path), "--rounds", "0"]) == 2
    assert "--rounds" in capsys.readouterr().err
    (tmp_path / "config.json").write_text(
        json.dumps({"format": 1, "scene": "s", "scene_options": {}, "config": {"method": "nerf"}})
    )
    assert main([str(tmp_path)]) == 2
    assert "voxel method" in capsys.readouterr().err
