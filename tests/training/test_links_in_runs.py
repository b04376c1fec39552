"""Going on with somebody else's run writes into that run, and nowhere else."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from training.commands.train import main

STORED = Path(__file__).parents[1] / "data" / "runs"


@pytest.mark.parametrize(
    "name", ["metrics.jsonl", "curves.png", "validation/latest.png", "report/report.md", "config.json"]
)
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_link_or_a_pipe_in_the_place_of_a_file_is_refused(
    name: str, kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, mine = Path(shutil.copytree(STORED / "multires", tmp_path / "run")), tmp_path / "mine.txt"
    mine.write_bytes((run / name).read_bytes() if name == "config.json" else b"mine")
    before = mine.read_bytes()
    file = run / name
    file.parent.mkdir(exist_ok=True)
    file.unlink(missing_ok=True)
    file.symlink_to(mine) if kind == "link" else os.mkfifo(file)
    assert main([str(STORED / "scene"), "--out", str(run), "--resume"]) == 2
    assert file.name in capsys.readouterr().err or name == "config.json"
    assert mine.read_bytes() == before
