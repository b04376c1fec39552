"""The passes over a bake's voxels: what each is given, and what it leaves to the next."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from baker.baking import bake as baking
from baker.baking import passes
from baker.baking.config import BakeConfig, BakePreset, Quality
from baker.baking.passes import COMPACT, Voxels, passes_of
from scenepack import Pack
from scenepack.blocks import dense_from_pack
from scenepack.codecs.quantisation import EXACT, Steps
from tests.scenepack.random_packs import random_pack
from training.dataset import RayDataset
from training.run import load_run
from training.scenes import Scene

STORED = Path(__file__).parents[2] / "data/runs"
BAR: Any = SimpleNamespace(update=lambda *_: None)


class HandedOver(Exception):
    """What a bake has come to."""


@pytest.mark.parametrize("preset", ["snerg", "paper"])
def test_what_tunes_compares_with_photographs_in_the_look_of_the_field(
    scene: Scene, dataset: RayDataset, monkeypatch: pytest.MonkeyPatch, preset: BakePreset
) -> None:
    gains = np.ones((dataset.views, 3), np.float32)
    gains[:, 0] = np.linspace(0.5, 1.5, dataset.views)
    seen: list[RayDataset] = []

    def tune(pack: Any, photographs: RayDataset, *_: Any, **__: Any) -> Any:
        seen.append(photographs)
        raise HandedOver

    method = SimpleNamespace(gains=lambda state: gains)
    run: Any = SimpleNamespace(method=method, dataset=dataset, scene=scene, state=0)
    monkeypatch.setattr(baking, "check_bake", lambda *_: None)
    monkeypatch.setattr(baking, "culled_grid", lambda *_: (None, None))
    monkeypatch.setattr(baking, "supersampled", lambda *_: random_pack(np.random.default_rng(0)))
    monkeypatch.setattr(passes, "arriving_transmittance", lambda *_: None)
    monkeypatch.setattr(passes, "fine_tune", tune)
    monkeypatch.setattr(passes, "joint_tune", tune)
    with pytest.raises(HandedOver):
        baking.bake(run, BakeConfig(preset=preset))
    ids = np.arange(0, dataset.count, 7, dtype=np.int32)
    shown = np.asarray(dataset.in_average_look(gains).colours_at(ids))
    assert np.abs(shown - np.asarray(dataset.colours_at(ids))).max() > 0.1
    assert len(seen) == 1 and np.array_equal(np.asarray(seen[0].colours_at(ids)), shown)


def voxels_of(quality: Quality = "full", **more: Any) -> Voxels:
    return Voxels(random_pack(np.random.default_rng(0)), None, BakeConfig(quality=quality, seed=7), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(("quality", "steps"), [("compact", COMPACT), ("full", EXACT)])
def test_a_pack_is_compact_where_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, quality: Quality, steps: Steps
) -> None:
    asked: list[Any] = []

    def tune(pack: Any, dataset: Any, config: Any, on_share: Any, by_opacity: bool) -> Any:
        asked.append(config)
        return replace(pack, params={"tuned": True}), {"passes": 1.0}

    monkeypatch.setattr(passes, "joint_tune", tune)
    made = passes.tuned(voxels_of(quality), BAR)
    (config,) = asked
    assert config.steps == steps and config.seed == 7 and config.held_out > 0
    assert made.pack.params == {"tuned": True} and made.steps == steps
    assert made.notes == {"fine_tuning": {"quality": quality, "passes": 1.0}}


def voxels_in(pack: Pack) -> int:
    return int(np.count_nonzero(dense_from_pack(pack)[0][..., 3]))


def test_a_bake_says_how_it_was_made_and_of_the_papers_nothing_is_emptied(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passes, "MOST_LOST_PRUNED", 3.0)  # so coarse a grid of mist would keep all
    loaded = load_run(STORED / "multires", scene_path=STORED / "scene")
    ours, papers = (
        baking.bake(loaded, BakeConfig(resolution=31, preset=preset, quality="draft")) for preset in ("snerg", "paper")
    )
    made, literal = ours.metadata["provenance"], papers.metadata["provenance"]
    assert (made["preset"], made["quality"], literal["preset"]) == ("snerg", "draft", "paper")
    assert made["voxels"]["after"] == voxels_in(ours) < made["voxels"]["before"] and made["voxels"]["tau_weight"] > 0
    assert made["macroblocks"]["kept"] == np.count_nonzero(ours.occupied)
    assert "voxels" not in literal and "fine_tuning" not in made
    assert passes_of(BakeConfig(preset="paper", quality="draft"))[-1][0] == "padding"
