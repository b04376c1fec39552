"""docs/results.md is what docs/results gives: no figure of it is typed by hand."""

from __future__ import annotations

import importlib.util
import json
import re
from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.documents
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def results() -> ModuleType:
    spec = importlib.util.spec_from_file_location("results", ROOT / "scripts/results.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
