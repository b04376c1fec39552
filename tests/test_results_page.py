"""docs/results.md is what docs/results gives: no figure of it is typed by hand."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def results() -> ModuleType:
    spec = importlib.util.spec_from_file_location("results", ROOT / "scripts/results.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def docs(tmp_path: Path) -> Path:
    shutil.copytree(ROOT / "docs/results", tmp_path / "results")
    return tmp_path


def test_the_page_is_what_its_figures_give(results: ModuleType) -> None:
    assert (ROOT / "docs/results.md").read_text(encoding="utf-8") == results.page(), "make results"
    assert results.main(["--check"]) == 0


def test_every_figure_of_the_files_is_on_the_page_and_each_file_says_how_it_was_made(results: ModuleType) -> None:
    template = (ROOT / "docs/results/page.md").read_text(encoding="utf-8")
    for path in sorted((ROOT / "docs/results").glob("*.json")):
        file = json.loads(path.read_text(encoding="utf-8"))
        assert file["commands"] and file["commit"] and file["device"], path
        for key in file["figures"]:
            assert f"{{{{{path.stem}.{key}" in template, f"{path.name}: {key}"
        for key, table in file.get("tables", {}).items():
            assert f"{{{{{path.stem}.table:{key}}}}}" in template, f"{path.name}: {key}"
            assert {len(row) for row in table["rows"]} == {len(table["columns"])} == {len(table["formats"])}, key


def test_scores_are_not_typed_into_the_page() -> None:
    """What is left of decibels in the template tells of commands, sizes and photographs, not of what was measured."""
    template = (ROOT / "docs/results/page.md").read_text(encoding="utf-8")
    assert not re.findall(r"\d\.\d+\*{0,2} dB|\d GB of", template)
    assert not [line for line in template.splitlines() if line.startswith("|")], "tables are in the files"


def test_another_figure_gives_another_page(results: ModuleType, docs: Path) -> None:
    path = docs / "results/lego-800.json"
    file = json.loads(path.read_text(encoding="utf-8"))
    file["figures"]["webp_mb"] = 71
    file["tables"]["packs"]["rows"][1][1] = 34.567
    path.write_text(json.dumps(file))
    text, before = results.page(docs), results.page()
    assert "takes 71 MB" in text and "**34.57**" in text
    changed = [a for a, b in zip(text.splitlines(), before.splitlines(), strict=True) if a != b]
    assert len(changed) == 2
    del file["figures"]["webp_mb"]
    path.write_text(json.dumps(file))
    with pytest.raises(KeyError):
        results.page(docs)


def test_reports_are_kept_without_folders_of_a_machine(results: ModuleType) -> None:
    for path in (ROOT / "docs/results/reports").glob("*.json"):
        document = json.loads(path.read_text(encoding="utf-8"))
        assert results.without_folders(document) == document, f"{path.name}: make results"
        assert not re.findall(r"[\" ](?:/|[A-Z]:)\w", json.dumps(document)), path.name


def test_the_reports_of_scenes_are_put_in_as_they_are_without_folders_of_a_machine(
    results: ModuleType, docs: Path
) -> None:
    about = {"name": "jewels", "step": 6000, "views": 10, "split": "test", "width": 200, "height": 200, "kind": "synthetic",
             "theirs": "the mean", "out": "/somewhere/out", "run": "/somewhere/runs/a", "scene": "/data/jewels"}  # fmt: skip
    row = {
        "row": "field",
        "label": "voxel field, 6,000 steps",
        "psnr": 31.25,
        "ssim": 0.95,
        "lpips": None,
        "paper": None,
    }
    lacking = {
        "row": "diffuse",
        "label": "Diffuse",
        "command": "snerg-train /data/jewels --out /somewhere/out/runs/d",
        "paper": None,
    }
    table = {"resolution": 512, "field": "voxel field, 6,000 steps", "rows": [row, lacking], "figures": {}}
    made = {"command": "snerg-report /somewhere/runs/a --out /somewhere/out", "commit": "abc", "device": "2 cores"}
    (docs / "results/reports").mkdir(exist_ok=True)
    for old in (docs / "results/reports").glob("*.json"):
        old.unlink()
    document = {"about": about, "tables": {"quality": table}, "made": {"quality": made}}
    (docs / "results/reports/jewels.json").write_text(json.dumps(document))
    text = results.page(docs)
    assert "    snerg-report RUN --out DIR" in text and "Commit abc; 2 cores." in text
    assert (
        "| voxel field, 6,000 steps | 31.25 | 0.9500 | – |" in text and "`snerg-train SCENE --out DIR/runs/d`" in text
    )
    assert "/work" not in text and results.NO_REPORTS not in text
