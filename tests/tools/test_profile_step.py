"""python -m tools.profile_step: photographs become a table and JSON, and what cannot be profiled is refused."""

import dataclasses
import json

import pytest

from tests.stored_runs import STORED
from tools.profile_step import PARTS, main
from training.config import QUICK
from training.multires.config import MultiresConfig

SMALL = MultiresConfig(resolutions=(8, 16), occupancy=16, samples_per_step=2048, steps_across=(16, 16, 16))
TINY = dataclasses.replace(QUICK, steps=20, multires=SMALL)

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("hardly_optimised")]


def test_photographs_become_a_table_and_json(procedural_path, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("training.config.PRESETS", {"quick": TINY})
    words = [str(procedural_path), "--steps", "3", "--rounds", "2"]
    assert main([*words, "--json", str(tmp_path / "p.json"), "--markdown", str(tmp_path / "p.md")]) == 0
    figures = json.loads((tmp_path / "p.json").read_text())
    assert figures["step"] == 3 and figures["step_ms"] > 0 and figures["samples_per_cpu_second"] > 0
    assert set(figures["parts"]) == set(PARTS[figures["engine"]])
    assert capsys.readouterr().out == (tmp_path / "p.md").read_text()


def test_only_runs_of_the_field_can_be_profiled(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(STORED / "nerf")]) == 2
    assert "only the multi-resolution field can be profiled" in capsys.readouterr().err
