"""Presets: one table of names, which commands, trainer and viewer share."""

from __future__ import annotations

from typing import get_args

import pytest

from baker.commands import make
from training.commands import train
from training.config import PRESETS as CONFIGS
from training.scenes.presets import PRESETS, BakeablePreset, PresetName
from viewer.app import survey


def test_every_name_has_settings_and_says_what_it_is_for() -> None:
    assert set(get_args(PresetName)) == set(PRESETS) == set(CONFIGS)
    assert all(preset.about for preset in PRESETS.values())


def test_those_that_snerg_make_offers_are_those_that_a_pack_can_hold() -> None:
    bakeable = {
        n for n, config in CONFIGS.items() if config.method == "multires" or config.nerf.view in ("deferred", "none")
    }
    assert set(get_args(BakeablePreset)) == bakeable


@pytest.mark.parametrize(("command", "kind"), [(make, BakeablePreset), (train, PresetName)])
def test_help_explains_every_preset(command, kind, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    assert command.main(["--help"]) == 0
    told = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for name in get_args(kind):
        assert f"{name} ({PRESETS[name].about})" in told


def test_the_viewer_offers_the_presets_that_have_a_title() -> None:
    assert list(survey.OFFERED) == ["quick", "normal", "full", "paper"]
    assert all(preset.advice for preset in survey.OFFERED.values())


def test_photographs_that_are_not_shrunk_are_baked_as_finely_as_they_show() -> None:
    quick, full, paper, tiny = (PRESETS[name] for name in ("quick", "full", "paper", "tiny"))
    assert [quick.resolution_for(pixels) for pixels in (200, 256, 400, 640, 800, 4000)] == [
        512,
        512,
        512,
        800,
        1000,
        1000,
    ]
    assert [full.resolution_for(pixels) for pixels in (200, 504, 1008)] == [512, 630, 1000]
    assert paper.resolution_for(100) == paper.resolution_for(4000) == 1000 and tiny.resolution_for(800) == 96
