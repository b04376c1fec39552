"""docs/notebooks/first_scene.ipynb runs from its first cell to its last, and shows what it says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs/notebooks/first_scene.ipynb"
LEAST_PSNR = 20.0  # dB, of 200 steps; a picture of the background alone has 14


@pytest.mark.slow
def test_the_notebook_makes_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat", reason="the notebook runs with nbclient and ipykernel (the extra dev)")
    client = pytest.importorskip("nbclient", reason="the notebook runs with nbclient and ipykernel (the extra dev)")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    notebook = nbformat.reads(NOTEBOOK.read_text(encoding="utf-8"), as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "clear its outputs before you commit it"
    client.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 3
    pages = [
        output["data"]["text/html"] for output in outputs if "<iframe" in output.get("data", {}).get("text/html", "")
    ]
    assert len(pages) == 1 and "Content-Security-Policy" in pages[0]
    printed = "".join(output.get("text", "") for output in outputs if output.output_type == "stream")
    assert float(re.findall(r"([\d.]+) dB on 4 photographs", printed)[0]) > LEAST_PSNR, printed
    assert {"island.glb", "mine.zip", "photographs", "run"} <= {path.name for path in tmp_path.iterdir()}
