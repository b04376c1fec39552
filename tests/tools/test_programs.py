"""Programs for makers of the project: the report of a card, the profile of a step, procedural scenes."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenepack import Pack, save_pack
from tests.messages import without_progress
from tests.stored_runs import STORED
from tools.card import __main__ as card_report
from tools.card.parts import Budget, Skipped
from tools.procedural.__main__ import procedural
from tools.profile_step import PARTS
from tools.profile_step import main as profile_step
from training.config import QUICK
from training.multires.config import MultiresConfig
from training.scenes import load_scene

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("hardly_optimised")]
SHORT = ["--size", "48x36", "--frames", "3", "--views", "2", "--power-seconds", "0.05"]


@pytest.fixture
def folder(tmp_path: Path, shapes: Pack) -> Path:
    path = tmp_path / "packs" / "shapes"
    save_pack(shapes, path)
    return path


def test_one_command_measures_what_can_be_measured_here_and_says_what_cannot(folder, ndc_shapes, tmp_path):
    out, other = tmp_path / "card", tmp_path / "packs" / "fern" / "pack"
    save_pack(ndc_shapes, other)
    words = ["--out", str(out), "--only", "--pack", str(folder), str(other), *SHORT, "--train-minutes", "0.1"]
    assert card_report.main(words) == 0
    parts = json.loads((out / "report.json").read_text())["parts"]
    assert {name: facts["status"] for name, facts in parts.items()} == {
        "device": "done",
        "golden pictures": "done",
        "pack shapes": "done",
        "pack fern-pack": "done",
        "jax": "skipped",  # it sees processors alone
        "curve of full": "skipped",
        "step of paper": "skipped",
        "step of full, in parts": "skipped",
    }
    assert parts["device"]["renderer"] and len(parts["golden pictures"]["pictures"]) == 21
    for name in ("shapes", "fern-pack"):
        facts = parts[f"pack {name}"]
        assert facts["exactness"]["holds"] and facts["exactness"]["views"] == 2
        times = facts["times"]
        assert times["ratio"] == pytest.approx(np.median(times["ms_paper"]) / np.median(times["ms_exact"]), rel=1e-3)
        assert facts["power"]["exact"]["fps"] > 0 and facts["timer"]["wall_ms_p50"] > 0
        assert Image.open(out / facts["picture"]).size == (48, 36)
    text = (out / "report.md").read_text()
    assert all(name in text for name in parts)
    assert not (out / "work").exists()
    for line in re.findall(r"\|.*\|\n(?=\| ---)", text):  # each table is as wide as its head
        table = text[text.index(line) :].split("\n\n")[0].splitlines()
        assert len({row.count("|") for row in table}) == 1


def test_a_part_that_fails_leaves_the_others_and_is_told_at_the_end(folder, tmp_path, monkeypatch, capsys):
    def broken(*_: object) -> dict:
        raise RuntimeError("the driver is moody")

    def skipped(out: Path, budget: Budget) -> dict:
        raise Skipped("they take seconds, and one test is enough")

    monkeypatch.setattr(card_report, "device", broken)
    monkeypatch.setattr(card_report, "golden", skipped)
    out = tmp_path / "card"
    words = ["--out", str(out), "--only", "--pack", str(folder), *SHORT, "--train-minutes", "0"]
    assert card_report.main(words) == 2
    assert "1 of 3 parts failed" in without_progress(capsys.readouterr().err)[-1]
    parts = json.loads((out / "report.json").read_text())["parts"]
    assert parts["device"]["status"] == "failed" and "broken" in parts["device"]["traceback"]
    assert parts["pack shapes"]["status"] == "done" and "the driver is moody" in (out / "report.md").read_text()


# The profile of a step

SMALL = MultiresConfig(resolutions=(8, 16), occupancy=16, samples_per_step=2048, steps_across=(16, 16, 16))
TINY = dataclasses.replace(QUICK, steps=20, multires=SMALL)


def test_photographs_become_a_table_and_json(procedural_path, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("training.config.PRESETS", {"quick": TINY})
    words = [str(procedural_path), "--steps", "3", "--rounds", "2"]
    assert profile_step([*words, "--json", str(tmp_path / "p.json"), "--markdown", str(tmp_path / "p.md")]) == 0
    figures = json.loads((tmp_path / "p.json").read_text())
    assert figures["step"] == 3 and figures["step_ms"] > 0 and figures["samples_per_cpu_second"] > 0
    assert set(figures["parts"]) == set(PARTS[figures["engine"]])
    assert capsys.readouterr().out == (tmp_path / "p.md").read_text()


def test_only_runs_of_the_field_can_be_profiled(capsys: pytest.CaptureFixture[str]) -> None:
    assert profile_step([str(STORED / "nerf")]) == 2
    assert "only the multi-resolution field can be profiled" in capsys.readouterr().err


# Procedural scenes


@pytest.mark.parametrize("name", ["glass", "wires"])
def test_the_program_writes_each_arrangement(name, tmp_path):
    procedural(tmp_path / "a", scene=name, size=16, views=2, subpixels=1)
    assert {split: len(views) for split, views in load_scene(tmp_path / "a").splits.items()} == {"train": 2, "test": 2}
    procedural(tmp_path / "b", size=16, views=2, subpixels=1)
    one, other = (load_scene(tmp_path / folder).splits["train"][0].load() for folder in "ab")
    assert not np.array_equal(one, other), "it is not the demo's"
