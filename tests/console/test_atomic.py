"""Files and folders take their place in one step, and are on the disk before they do."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baker.reports.cross_sections import Section, draw_sections
from console import atomic, write_json
from viewer.features.film.camera_path import CameraPath, save_path
from viewer.features.film.film_export import write_film
from viewer.features.preferences.preferences import Preferences, save

ROOT = Path(__file__).parents[2]
PICTURE = np.zeros((16, 16, 3), np.uint8)


def draw_a_section(path: Path) -> None:
    empty = Section(np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4), bool), np.zeros(2), np.ones(2), 0.25, False)
    draw_sections(path, {"empty": empty})


def film(path: Path) -> None:
    pytest.importorskip("av", reason="needs PyAV: pip install 'snerg[video]'")
    write_film(path, [PICTURE] * 3, 24)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("figures.json", lambda path: write_json(path, {"psnr": 30.0})),
        ("viewer.json", lambda path: save(Preferences(), path)),
        ("path.json", lambda path: save_path(CameraPath(), path, np.eye(4), (320, 200), 30.0)),
        ("sections.png", draw_a_section),
        ("film.mp4", film),
    ],
)
def test_what_a_person_keeps_is_flushed_before_it_takes_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, write: Callable[[Path], Any]
) -> None:
    steps: list[str] = []
    sync, replace = os.fsync, os.replace

    def fsync(handle: int) -> None:
        steps.append("folder" if os.path.isdir(f"/proc/self/fd/{handle}") else "file")
        sync(handle)

    def renamed(source: Any, target: Any) -> None:
        steps.append("rename")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", renamed)
    write(tmp_path / name)
    assert steps == ["file", "rename", "folder"]
    assert os.listdir(tmp_path) == [name]


def test_no_other_module_writes_aside_and_renames() -> None:
    """One owner: whoever renames a file by hand forgets to flush it."""
    found = []
    for room in ("console", "scenepack", "training", "baker", "viewer"):
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                    continue
                owner = node.func.value.id if isinstance(node.func.value, ast.Name) else ""
                renames = node.func.attr == "rename" or (
                    node.func.attr == "replace" and owner in ("os", "aside", "new")
                )
                if renames or (owner == "shutil" and node.func.attr == "move"):
                    found.append(str(path.relative_to(ROOT)))
    assert set(found) == {
        "console/atomic.py",
        "viewer/core/log.py",
    }  # the latter names a log that is complete, and writes none


def test_a_failure_leaves_the_old_file_and_nothing_beside_it(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    atomic.write_file(file, "old")
    with pytest.raises(RuntimeError), atomic.replacing(file) as new:
        new.write_text("half")
        raise RuntimeError
    assert file.read_text() == "old" and os.listdir(tmp_path) == ["figures.json"]


def test_what_a_killed_writer_left_is_gone_after_the_next_one(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    code = (
        "import os, sys; from pathlib import Path; from console.atomic import Replacement\n"
        "Replacement(Path(sys.argv[1])).path.write_text('half'); os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(file)], cwd=ROOT, timeout=60).returncode == 9
    assert len(os.listdir(tmp_path)) == 1
    atomic.write_file(file, "whole")
    assert os.listdir(tmp_path) == ["figures.json"]
