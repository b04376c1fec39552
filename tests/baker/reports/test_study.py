"""The packs behind a report: none is baked twice, and none stands for another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from baker.baking.config import BakeConfig
from baker.reports.report import Sources, open_study
from baker.reports.study import Study
from scenepack import save_pack
from tests.scenepack.random_packs import random_pack
from training.run import Run

DATA = Path(__file__).parents[2] / "data/older"


@pytest.fixture
def bakes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was baked so far; tuning by `auto` always comes to `all`."""
    made: list[str] = []

    def bake_to(run: Run, config: BakeConfig, out: Path) -> dict[str, float]:
        made.append(config.fine_tune)
        came_to = "all" if config.fine_tune == "auto" else config.fine_tune
        pack = random_pack(np.random.default_rng(0))
        save_pack(pack.with_metadata(provenance={"fine_tuning": {"of": came_to}}), out)
        return {"writing": float(len(made))}

    monkeypatch.setattr("baker.reports.study.bake_to", bake_to)
    return made


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return open_study(Sources(DATA / "multires", tmp_path / "out", DATA / "scene", resolution=46))


def test_what_auto_came_to_is_not_baked_again(study: Study, bakes: list[str]) -> None:
    auto = study.baked("snerg", fine_tune="auto")
    assert study.baked("snerg", fine_tune="all") == auto
    assert study.baked("snerg", fine_tune="auto") == auto
    assert bakes == ["auto"]


def test_what_auto_did_not_come_to_is_baked(study: Study, bakes: list[str]) -> None:
    auto = study.baked("snerg", fine_tune="auto")
    compact = study.baked("snerg", fine_tune="compact")
    assert bakes == ["auto", "compact"]
    assert compact.path != auto.path


def test_a_pack_of_auto_with_other_options_does_not_stand_for_all(study: Study, bakes: list[str]) -> None:
    study.baked("snerg", fine_tune="auto", tau_weight=0.1)
    study.baked("snerg", fine_tune="all")
    assert bakes == ["auto", "all"]
