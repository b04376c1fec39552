"""snerg-make of what is no photographs and no film: one line, status 2, and nothing written; and names of any bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from baker.commands.make import main as snerg_make


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
