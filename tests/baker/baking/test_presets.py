"""snerg-bake --preset paper: what the paper writes (sections 5.3 to 5.5 and 6), setting by setting."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from baker.baking.config import MOST_MACROBLOCKS, UNLIMITED, BakeConfig, BakePreset, Quality
from baker.baking.grid import make_grid
from baker.baking.passes import passes_of
from baker.baking.supersample import SAMPLES, Sampler
from baker.commands.bake import main as snerg_bake
from baker.commands.make import main as snerg_make
from baker.tuning import fine_tune as tuning
from baker.tuning.fine_tune import shaded_pixels
from tests.baker.analytic import ball, culled
from tests.scenepack.random_packs import BLENDER_FRAME, random_pack


def note_bakes(monkeypatch: pytest.MonkeyPatch, configs: list[BakeConfig]) -> None:
    """Adds how a run would be baked to `configs`, in place of baking it."""

    def bake_to(run: Any, config: BakeConfig, *_: Any, **__: Any) -> None:
        configs.append(replace(config, resolution=config.resolution_of(run)))

    monkeypatch.setattr("baker.baking.to_pack.bake_to", bake_to)


def test_the_preset_paper_takes_the_papers_resolution_and_no_limit_and_single_options_change_it(tmp_path, monkeypatch):
    configs: list[BakeConfig] = []
    note_bakes(monkeypatch, configs)
    photograph = SimpleNamespace(camera=SimpleNamespace(width=400, height=300))
    run = SimpleNamespace(scene=None, dataset=SimpleNamespace(facts=SimpleNamespace(contraction=None)))
    monkeypatch.setattr("training.run.load_run", lambda *_, **__: run)

    def asked(words: str, kind: str = "blender") -> BakeConfig:
        run.scene = SimpleNamespace(kind=kind, splits={"train": (photograph,)})
        assert snerg_bake(["run", "--out", str(tmp_path / "pack"), *words.split()]) == 0
        return configs[-1]

    paper = asked("--preset paper")
    assert (paper.preset, paper.resolution, paper.block_limit) == ("paper", 1000, UNLIMITED)
    assert asked("--preset paper", "llff").resolution == 1300
    assert asked("--preset=paper --resolution 64 --seed 3") == replace(paper, resolution=64, seed=3)
    assert asked("--preset paper --most-macroblocks 9").block_limit == 9
    assert asked("") == BakeConfig(512) == asked("--preset snerg") and BakeConfig().block_limit == MOST_MACROBLOCKS


def test_snerg_make_bakes_presets_as_the_paper_or_our_way(scene, procedural_path, tmp_path, monkeypatch) -> None:
    configs: list[BakeConfig] = []
    trained = SimpleNamespace(scene=scene, dataset=SimpleNamespace(facts=SimpleNamespace(contraction=None)))
    monkeypatch.setattr("training.loop.train", lambda *_, **__: trained)
    note_bakes(monkeypatch, configs)
    papers = ("--preset paper", "--preset deferred", "--preset paper --resolution 64")
    for words in (*papers, "--preset normal --quality compact", "--preset small"):
        assert snerg_make([str(procedural_path), "--out", str(tmp_path / "out"), "--no-view", *words.split()]) == 0
    fine = BakeConfig(1000, "paper")
    ours = BakeConfig(512, "snerg", "compact")
    assert configs == [fine, fine, replace(fine, resolution=64), ours, replace(ours, quality="full")]
    trained.scene = SimpleNamespace(kind="llff")
    assert snerg_make([str(procedural_path), "--out", str(tmp_path / "out"), "--no-view", "--preset", "paper"]) == 0
    assert configs[-1] == BakeConfig(1300, "paper"), "photographs"


def test_each_preset_and_quality_has_its_passes_in_the_papers_order() -> None:
    def names(preset: BakePreset, quality: Quality) -> list[str]:
        return [name for name, _ in passes_of(BakeConfig(preset=preset, quality=quality))]

    ours = ["padding", "pruning", "feature scale", "tuning", "hidden voxels"]
    assert names("snerg", "compact") == names("snerg", "full") == ours and names("snerg", "draft") == ours[:2]
    assert names("paper", "compact") == names("paper", "full") == ["padding", "view MLP"]
    assert names("paper", "draft") == ["padding"], "the paper's row of 8 bits: nothing is emptied, nothing tuned"


def test_the_paper_takes_16_gaussian_samples_of_any_field_and_averages_colours_and_densities_apart(dataset):
    grid = make_grid(np.full(3, -0.9), np.full(3, 0.9), 30, 30, BLENDER_FRAME)
    kept, asked = culled(ball, grid, dataset), []

    def field(points: np.ndarray):
        asked.append(points)
        return ball(points)._replace(diffuse=0.5 + 0.5 * np.sin(40 * points))  # also where it is empty

    grain = np.full(3, grid.voxel_size)  # of a field that our own bake asks once a voxel
    sampler = Sampler(field, grid, kept, grain, as_paper=True)
    with ThreadPoolExecutor(1) as pool:
        places, values = sampler.content(np.argwhere(kept.kept)[:1], pool)
    points = np.concatenate(asked).reshape(len(places), SAMPLES, 3)
    spread = (points - points.mean(1, keepdims=True)).std() * np.sqrt(SAMPLES / (SAMPLES - 1)) / grid.voxel_size
    assert spread == pytest.approx(1 / np.sqrt(12), rel=0.02)
    seen = field(points.reshape(-1, 3))
    alpha = 1 - np.exp(-seen.density.reshape(-1, SAMPLES).mean(1) * grid.voxel_size)
    np.testing.assert_allclose(values[:, 3], alpha, atol=1e-5)
    colour = np.asarray(seen.diffuse).reshape(-1, SAMPLES, 3).mean(1)
    np.testing.assert_allclose(values[:, :3], colour * alpha[:, None], atol=1e-5)
    assert ((alpha > 0.02) & (alpha < 0.9)).any(), "some voxels lie across the border"


def test_the_paper_tunes_the_view_mlp_on_all_pixels_a_photographs_worth_a_step(dataset, monkeypatch):
    pack = random_pack(np.random.default_rng(7), block_size=14, grid_blocks=(3, 3, 3))
    monkeypatch.setattr(tuning, "MARCHED_AT_ONCE", dataset.count // 3 + 1)
    every = shaded_pixels(pack, dataset)
    monkeypatch.setattr(tuning, "MARCHED_AT_ONCE", dataset.count)
    at_once = shaded_pixels(pack, dataset)
    assert every is not None and at_once is not None
    for a, b in zip(every, at_once, strict=True):
        np.testing.assert_allclose(np.sort(np.asarray(a), axis=0), np.sort(np.asarray(b), axis=0), atol=1e-6)

    taken: list[tuple[np.ndarray, int]] = []

    def epoch(params: Any, moments: Any, pixels: Any, order: Any, batch: int, optimiser: Any) -> Any:
        taken.append((np.asarray(order), batch))
        return real(params, moments, pixels, order, batch, optimiser)

    real = tuning._epoch
    monkeypatch.setattr(tuning, "_epoch", epoch)
    tuned, before, after = tuning.fine_tune(pack, dataset, epochs=2)
    assert after > before and tuned.view_mlp is not pack.view_mlp and tuned.atlas_rgba is pack.atlas_rgba
    diffuse = replace(pack, view_mlp=None, atlas_features=None)
    assert tuning.fine_tune(diffuse, dataset, epochs=3)[0] is diffuse, "which has nothing to tune"
    count = len(every.diffuse)
    for order, batch in taken:
        assert batch == -(-count // dataset.views) and sorted(order) == list(range(-(-count // batch))), "each pixel"
    assert not np.array_equal(taken[0][0], taken[1][0])
