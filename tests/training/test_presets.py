"""Presets: one table of names, which commands, trainer and viewer share; and settings that make no sense."""

import dataclasses
from typing import get_args

import pytest

from baker.commands import make
from console import UserError
from training.commands import train
from training.config import PRESETS as CONFIGS
from training.config import TINY, from_json
from training.scenes.presets import PRESETS, BakeablePreset, PresetName, voxels_for
from training.speed import whole_runs


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
    help_text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for name in get_args(kind):
        assert f"{name} ({PRESETS[name].about})" in help_text


def test_packs_are_about_as_fine_as_photographs_and_twice_as_fine_where_half_a_side_is_the_surroundings() -> None:
    assert [voxels_for(pixels) for pixels in (200, 400, 504, 640, 800, 4000)] == [512, 512, 630, 800, 1000, 1000]
    assert [voxels_for(pixels, contracted=True) for pixels in (128, 256, 512)] == [512, 640, 1000]


def test_larger_photographs_take_more_of_both_until_the_field_is_as_fine_as_it_gets() -> None:
    runs = whole_runs([100, 250, 800, 1600])["quick"]
    for key in ("samples", "disk"):
        assert runs[100][key] <= runs[250][key] < runs[800][key] == runs[1600][key]
    assert runs[100]["disk"] < runs[250]["disk"]


@pytest.mark.parametrize(
    ("name", "value"),
    [("batch_size", -1), ("log_every", 0), ("seed", 10**20), ("steps", -5), ("minutes", float("nan")), ("nerf.width", 0),
     ("multires.occupancy", 0), ("multires.view_octaves", -1), ("multires.steps_from", [0.1, float("nan")]),
     ("nerf.first_rate", -1.0), ("checkpoint_every", 0), ("nerf.depth", 2.5), ("method", "magic")],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused_by_name(name: str, value: object) -> None:
    document = dataclasses.asdict(TINY)
    inner = document
    for part in name.split(".")[:-1]:
        inner = inner[part]
    inner[name.split(".")[-1]] = value
    with pytest.raises(UserError, match=name.split(".")[-1].replace("_", ".")):
        from_json(type(TINY), document, "config.json")
