"""Programs for makers of the project: the report of a card, which users are asked for (docs/card.md)."""

import json
import re

import numpy as np
import pytest
from PIL import Image

from scenepack import save_pack
from tests.messages import without_progress
from tests.stand_ins import raising
from tools.card import __main__ as card_report
from tools.card.parts import Skipped

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("hardly_optimised")]
SHORT = ["--size", "48x36", "--frames", "3", "--views", "2", "--power-seconds", "0.05"]


def test_one_command_measures_what_can_be_measured_here_and_says_what_cannot(shapes_folder, ndc_shapes, tmp_path):
    out, other = tmp_path / "card", tmp_path / "packs" / "fern" / "pack"
    save_pack(ndc_shapes, other)
    words = ["--out", str(out), "--only", "--pack", str(shapes_folder), str(other), *SHORT, "--train-minutes", "0.1"]
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


def test_a_part_that_fails_leaves_the_others_and_is_told_at_the_end(shapes_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(card_report, "device", raising(RuntimeError("the driver is moody")))
    monkeypatch.setattr(card_report, "golden", raising(Skipped("they take seconds, and one test is enough")))
    out = tmp_path / "card"
    words = ["--out", str(out), "--only", "--pack", str(shapes_folder), *SHORT, "--train-minutes", "0"]
    assert card_report.main(words) == 2
    assert "1 of 3 parts failed" in without_progress(capsys.readouterr().err)[-1]
    parts = json.loads((out / "report.json").read_text())["parts"]
    assert parts["device"]["status"] == "failed" and "raise error" in parts["device"]["traceback"]
    assert parts["pack shapes"]["status"] == "done" and "the driver is moody" in (out / "report.md").read_text()
