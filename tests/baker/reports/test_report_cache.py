"""The packs behind a report: none is baked twice, and none stands for another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from baker.baking.config import BakeConfig
from baker.reports import paper_figures
from baker.reports.options import ReportOptions
from baker.reports.paper_figures import GPU_GB, MILLISECONDS, QUALITY, RELEASE, SCENES, SPEED, Kind
from baker.reports.report import open_study
from baker.reports.report_cache import Study
from scenepack import save_pack
from tests.scenepack.random_packs import random_pack
from training.run import Run

DATA = Path(__file__).parents[2] / "data/runs"


@pytest.fixture
def bakes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was baked so far."""
    made: list[str] = []

    def bake_to(run: Run, config: BakeConfig, out: Path) -> dict[str, float]:
        made.append(f"{config.preset} {config.quality} {config.seed}")
        save_pack(random_pack(np.random.default_rng(0)), out)
        return {"writing": float(len(made))}

    monkeypatch.setattr("baker.reports.report_cache.bake_to", bake_to)
    return made


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return open_study(DATA / "multires", ReportOptions(tmp_path / "out", DATA / "scene", resolution=46))


def test_each_pack_is_baked_once_and_none_stands_for_one_of_other_options(study: Study, bakes: list[str]) -> None:
    full = study.baked("snerg")
    compact = study.baked("snerg", quality="compact")
    assert study.baked("snerg", quality="full") == full and study.baked("snerg", quality="compact") == compact
    assert full.path != compact.path
    study.baked("paper")
    assert study.baked("snerg", seed=7).key != full.key
    assert bakes == ["snerg full 0", "snerg compact 0", "paper full 0", "snerg full 7"]


# The paper's figures stand here once; its means over scenes, which it prints as well, say whether they were typed right


@pytest.mark.parametrize("kind", list(QUALITY))
def test_the_printed_means_are_the_means_of_the_printed_scenes(kind: Kind) -> None:
    for metric, rows in QUALITY[kind].items():
        for row, (mean, *scenes) in rows.items():
            assert len(scenes) == len(SCENES[kind]), row
            if None not in scenes:
                allowed = 0.011 if metric == "psnr" else 0.0011
                if (kind, row) == ("forward", "DeRF"):
                    allowed *= 2  # as printed
                assert np.mean(np.array(scenes, float)) == pytest.approx(mean, abs=allowed), (metric, row)
    for rows in (MILLISECONDS, GPU_GB):
        for row, (mean, *scenes) in rows.items():
            known = [value for value in scenes if value is not None]
            assert np.mean(known) == pytest.approx(mean, abs=0.06), row
    for row, (mean, *scenes) in RELEASE["synthetic"].items():
        assert np.mean(np.array(scenes, float)) == pytest.approx(mean, abs=0.01), row
    for row, (watts, fps, each) in SPEED[kind].items():
        if fps >= 0.3:
            assert each == pytest.approx(fps / watts, rel=0.02), row


def test_a_scene_of_the_papers_gets_its_own_figures_and_others_the_mean_of_their_kind() -> None:
    assert paper_figures.quality("synthetic", "Lego", "snerg") == {"psnr": 33.82, "ssim": 0.973, "lpips": 0.022}
    assert paper_figures.quality("synthetic", "jewels", "snerg") == {"psnr": 30.38, "ssim": 0.950, "lpips": 0.050}
    assert paper_figures.quality("real360", "mary_rose", "tinyview") is None
    assert paper_figures.release("forward", "fern", "snerg") == 24.93
    assert paper_figures.performance("real360", "pine_cone", "ours") == {"fps": 39.5}
    assert paper_figures.performance("synthetic", "ficus", "no-sparsity") == {"ms": None, "gpu_gb": 7.57}
    assert "lego" in paper_figures.whose("synthetic", "lego") and "mean" in paper_figures.whose("synthetic", "jewels")
