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


def test_the_pages_are_what_their_figures_give(results: ModuleType) -> None:
    assert results.main(["--check"]) == 0, "make results"
    for path, text in results.pages().items():
        assert path.read_text(encoding="utf-8") == text
    told = {path.stem for path in results.pages()} - {"results"}
    assert told == {path.stem for path in (ROOT / "docs/results/reports").glob("*.json")}


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


def report_of(name: str, psnr: float) -> dict[str, object]:
    about = {"name": name, "step": 6000, "views": 10, "split": "test", "width": 200, "height": 200, "kind": "synthetic",
             "theirs": "the mean", "out": "/somewhere/out", "run": "/somewhere/runs/a", "scene": f"/data/{name}"}  # fmt: skip
    field = "voxel field, 6,000 steps"
    row = {"row": "field", "label": field, "psnr": psnr, "ssim": 0.95, "lpips": None, "paper": None}
    command = f"snerg-train /data/{name} --out /somewhere/out/runs/d"
    lacking = {"row": "diffuse", "label": "Diffuse", "command": command, "paper": None}
    pictures = {"crops": {"view": "test/r_1", "picture": "crops.png"}}
    table = {"resolution": 512, "field": field, "rows": [row, lacking], "figures": pictures}
    made = {"command": "snerg-report /somewhere/runs/a --out /somewhere/out", "commit": "abc", "device": "2 cores"}
    return {"about": about, "tables": {"quality": table}, "made": {"quality": made}}


@pytest.fixture
def with_reports(docs: Path) -> Path:
    """The docs, with reports of two scenes of our own alone."""
    for old in (docs / "results/reports").glob("*.json"):
        old.unlink()
    for name, psnr in (("jewels", 31.25), ("lace", 28.75)):
        (docs / f"results/reports/{name}.json").write_text(json.dumps(report_of(name, psnr)))
    return docs


def test_each_report_has_a_page_without_folders_of_a_machine(results: ModuleType, with_reports: Path) -> None:
    reports = results.read_reports(with_reports / "results/reports")
    text = results.report_page(reports["jewels"])
    assert text.startswith("# The paper's tables: jewels\n") and text.endswith("\n")
    assert "    snerg-report RUN --out DIR" in text and "Commit abc; 2 cores." in text
    assert (
        "| voxel field, 6,000 steps | 31.25 | 0.9500 | – |" in text and "`snerg-train SCENE --out DIR/runs/d`" in text
    )
    assert "/somewhere" not in text and "/data" not in text
    assert "crops.png" not in text and "r_1" not in text, "pictures are not kept, nor what is said of them"


def test_the_scenes_stand_side_by_side_with_their_mean(results: ModuleType, with_reports: Path) -> None:
    text = results.page(with_reports)
    assert results.NO_REPORTS not in text and "/somewhere" not in text
    assert (
        "| jewels | voxel field, 6,000 steps | 512³ | 10 of 200 × 200 | [quality](results/reports/jewels.md) |" in text
    )
    assert "| the field itself | 30.00 | 31.25 | 28.75 |" in text
    (with_reports / "results/reports/lace.json").unlink()
    assert "### PSNR" not in results.page(with_reports), "one scene has its own page only"


def test_a_row_that_one_scene_alone_has_stands_where_it_stands_there(results: ModuleType, with_reports: Path) -> None:
    path = with_reports / "results/reports/lace.json"
    lace = json.loads(path.read_text())
    field, lacking = lace["tables"]["quality"]["rows"]
    own = field | {"row": "ours-auto", "label": "ours", "psnr": 27.5}
    lace["tables"]["quality"]["rows"] = [field, own, lacking]
    path.write_text(json.dumps(lace))
    text = results.page(with_reports)
    text = text[text.index("### PSNR") : text.index("### SSIM")]
    first, ours, last = (
        text.index(row) for row in ("| the field itself |", "| ours | – | – | 27.50 |", "| JAXNeRF+ Diffuse |")
    )
    assert first < ours < last, "jewels, which has no such row, comes first"
