"""snerg-make of what is no photographs and no film: one line, status 2, and nothing written; and names of any bytes."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from baker.commands.make import main as snerg_make
from console import Notice
from tests.training.posing.rooms import texture
from training.posing import find
from training.posing.find import find_poses, posed_scene
from training.scenes.sources import require_source

COUNT = 9
ROOT = Path(__file__).parents[3]


def write_pictures(folder: Path, prefix: str = "p", count: int = COUNT) -> Path:
    """Pictures of one wall, some pixels on from one to the next."""
    folder.mkdir(parents=True, exist_ok=True)
    wall = texture(3).astype(np.uint8)
    for i in range(count):
        Image.fromarray(wall[:96, 20 * i : 20 * i + 128]).save(folder / f"{prefix}{i}.png")
    return folder


@pytest.mark.parametrize("more", [["--poses-only"], ["--no-view"]])
@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("none", None, "no such file or folder"),
        ("empty", {}, "the folder is empty"),
        ("folder", {"notes.txt": b"hello"}, "no photographs and no film in this folder"),
        ("jxl", {"a.jxl": b"", "b.jxl": b""}, "2 JXL pictures"),
        ("walk.mp4", b"hello", "not a film that can be read"),
        ("notes.txt", b"hello", "not a film that can be read"),
        ("transforms.json", b'{"frames": []}', "name the folder that it is in"),
        ("scene", {"transforms.json": b"{}"}, "transforms.json"),
    ],
)
def test_snerg_make_of_nothing_is_refused_in_one_line_and_writes_nothing(
    name: str, content: Any, told: str, more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path, out = tmp_path / name, tmp_path / "out"
    if isinstance(content, dict):
        path.mkdir()
        for file, data in content.items():
            (path / file).write_bytes(data)
    elif content is not None:
        path.write_bytes(content)
    assert snerg_make([str(path), "--out", str(out), *more]) == 2
    said = capsys.readouterr()
    assert not said.out and len(said.err.splitlines()) == 1 and told in said.err and str(path) in said.err
    assert not out.exists()


def pretend(monkeypatch: pytest.MonkeyPatch) -> None:
    """All pictures have a pose, without COLMAP."""

    def answer(service: str, request: dict, log: Path, tell: Any) -> dict:
        model = Path(request["work"]) / find.MODEL
        model.mkdir()
        (model / "cameras.bin").write_bytes(b"")
        names = request["names"]
        assert all(name.isascii() for name in names)  # which is all that COLMAP gets of them
        return {"registered": names, "features": dict.fromkeys(names, 9), "matched": dict.fromkeys(names, 1),
                "models": [names], "is_static": False, "points": 1, "error": 0.5}  # fmt: skip

    monkeypatch.setattr(find, "ask", answer)
    monkeypatch.setattr(find, "require", lambda source: None)


def test_photographs_and_folders_whose_names_are_not_utf_8_are_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    try:
        folder = write_pictures(tmp_path / "Fotos \udce4", "n\udcf6")
    except (OSError, UnicodeError):
        pytest.skip("this file system has no such names")
    (folder / "broken\udce4.png").write_bytes(b"none")
    pretend(monkeypatch)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = find_poses(require_source(folder), tmp_path / "Szene \udce4")
    assert len(list((scene / "images").iterdir())) == COUNT
    notices = [str(warning.message) for warning in caught if warning.category is Notice]
    assert any("broken\\xe4.png" in notice for notice in notices)
    report = json.loads((scene / find.REPORT).read_text())
    assert sorted(report["names"].values()) == [f"n\\xf6{i}.png" for i in range(COUNT)]
    assert report["photographs"] == str(folder)


def test_what_lies_beside_the_photographs_is_said_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = write_pictures(tmp_path / "photographs")
    for name in ("q1.jxl", "q2.gif", "._p0.png", "Thumbs.db"):
        (folder / name).write_bytes(b"")
    (folder / "masks").mkdir()
    pretend(monkeypatch)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = posed_scene(folder, tmp_path / "out")
    notices = [str(warning.message) for warning in caught if warning.category is Notice]
    assert len(notices) == 1 and f"{folder}: 1 GIF, 1 JXL pictures, a format that is not read" in notices[0]
    assert len(list((scene / "images").iterdir())) == COUNT and not (tmp_path / "out" / find.WORK).exists()
    before = find.fingerprint(require_source(folder))
    (folder / "masks" / ".DS_Store").write_bytes(b"new")  # as soon as somebody looks at them
    assert find.fingerprint(require_source(folder)) == before
