"""snerg-bake --preset paper: what the paper writes (sections 5.4 to 5.6), setting by setting."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from baker.baking.config import BakeConfig
from baker.baking.culling import cull
from baker.baking.grid import make_grid
from baker.baking.presets import CHANGES
from baker.baking.supersample import SAMPLES, Sampler
from baker.commands.bake import main as snerg_bake
from baker.tuning import fine_tune as tuning
from baker.tuning.fine_tune import shaded_pixels
from tests.baker.analytic import ball
from tests.scenepack.random_packs import BLENDER_FRAME, random_pack
from training.dataset import RayDataset


def config_of(words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str = "blender") -> BakeConfig:
    """What snerg-bake would bake with."""
    configs: list[BakeConfig] = []
    monkeypatch.setattr(
        "training.run.load_run", lambda path, scene_path: SimpleNamespace(scene=SimpleNamespace(kind=kind))
    )
    monkeypatch.setattr("baker.baking.to_pack.bake_to", lambda run, config, *_, **__: configs.append(config))
    assert snerg_bake(["run", "--out", str(tmp_path / "pack"), *words.split()]) == 0
    return configs[0]


def test_the_preset_paper_is_the_papers_and_single_options_change_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(words: str, kind: str = "blender") -> dict[str, Any]:
        return vars(config_of(words, tmp_path, monkeypatch, kind))

    paper = asked("--preset paper")
    told = {"resolution": 1000, "tau_alpha": 0.005, "tau_vis": 0.01, "tau_weight": 0, "fine_tune": "view-mlp",
            "fine_tune_epochs": 100, "fine_tune_pixels": 0, "supersampling": "paper"}  # fmt: skip
    assert {name: paper[name] for name in told} == told
    assert asked("--preset paper", "llff")["resolution"] == 1300
    assert asked("--preset=paper --resolution 64 --tau-vis 0.02") == {**paper, "resolution": 64, "tau_vis": 0.02}
    assert asked("") == vars(BakeConfig()) == asked("--preset snerg")
    assert set(CHANGES["paper"]) <= set(vars(BakeConfig()))


def test_a_preset_that_is_none_is_told_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert snerg_bake(["run", "--out", str(tmp_path / "pack"), "--preset", "best"]) == 2
    assert "best" in capsys.readouterr().err


def test_the_paper_takes_16_gaussian_samples_of_any_field_and_averages_colours_and_densities_apart(
    dataset: RayDataset,
) -> None:
    grid = make_grid(np.full(3, -0.9), np.full(3, 0.9), 30, 30, BLENDER_FRAME)
    culling, asked = cull(ball, grid, dataset), []

    def field(points: np.ndarray):
        asked.append(points)
        return ball(points)._replace(diffuse=0.5 + 0.5 * np.sin(40 * points))  # also where it is empty

    grain = np.full(3, grid.voxel_size)  # of a field that "grain" asks once a voxel
    sampler = Sampler.of(field, grid, culling, grain, "paper", 0)
    with ThreadPoolExecutor(1) as pool:
        places, values = sampler.content(np.argwhere(culling.kept)[:1], pool)
    points = np.concatenate(asked).reshape(len(places), SAMPLES, 3)
    spread = (points - points.mean(1, keepdims=True)).std() * np.sqrt(SAMPLES / (SAMPLES - 1)) / grid.voxel_size
    assert spread == pytest.approx(1 / np.sqrt(12), rel=0.02)
    seen = field(points.reshape(-1, 3))
    alpha = 1 - np.exp(-seen.density.reshape(-1, SAMPLES).mean(1) * grid.voxel_size)
    np.testing.assert_allclose(values[:, 3], alpha, atol=1e-5)
    colour = np.asarray(seen.diffuse).reshape(-1, SAMPLES, 3).mean(1)
    np.testing.assert_allclose(values[:, :3], colour * alpha[:, None], atol=1e-5)
    assert ((alpha > 0.02) & (alpha < 0.9)).any(), "some voxels lie across the border"


def test_the_paper_tunes_the_view_mlp_on_all_pixels_a_photographs_worth_a_step(
    dataset: RayDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    pack = random_pack(np.random.default_rng(7), block_size=14, grid_blocks=(3, 3, 3))
    monkeypatch.setattr(tuning, "MARCHED_AT_ONCE", dataset.count // 3 + 1)
    every, some = (shaded_pixels(pack, dataset, most, 0, None) for most in (0, 1000))
    assert every is not None and some is not None
    assert len(some.diffuse) <= 1000 < len(every.diffuse)
    monkeypatch.setattr(tuning, "MARCHED_AT_ONCE", dataset.count)
    at_once = shaded_pixels(pack, dataset, dataset.count, 0, None)
    assert at_once is not None
    for a, b in zip(every, at_once, strict=True):
        np.testing.assert_allclose(np.sort(np.asarray(a), axis=0), np.sort(np.asarray(b), axis=0), atol=1e-6)

    orders: list[np.ndarray] = []

    def order(*args: Any, **options: Any) -> Any:
        orders.append(np.asarray(real(*args, **options)))
        return orders[-1]

    real = tuning._order
    monkeypatch.setattr(tuning, "_order", order)
    tuned, before, after = tuning.fine_tune(pack, dataset, epochs=2, most_pixels=0)
    assert after > before and tuned.view_mlp is not pack.view_mlp
    count = len(every.diffuse)
    for one in orders:
        assert one.shape == (dataset.views, -(-count // dataset.views))
        assert set(one.ravel().tolist()) == set(range(count)), "each pixel in each epoch"
    assert not np.array_equal(orders[0], orders[1])
