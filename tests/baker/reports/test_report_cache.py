"""The packs behind a report: none is baked twice, and none stands for another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from baker.baking.config import BakeConfig
from baker.reports.report import Sources, open_study
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
    return open_study(Sources(DATA / "multires", tmp_path / "out", DATA / "scene", resolution=46))


def test_each_pack_is_baked_once_and_none_stands_for_one_of_other_options(study: Study, bakes: list[str]) -> None:
    compact = study.baked("snerg")
    full = study.baked("snerg", quality="full")
    assert study.baked("snerg", quality="compact") == compact and study.baked("snerg", quality="full") == full
    assert full.path != compact.path
    study.baked("paper")
    assert study.baked("snerg", seed=7).key != compact.key
    assert bakes == ["snerg compact 0", "snerg full 0", "paper compact 0", "snerg compact 7"]
