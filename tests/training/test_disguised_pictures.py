"""What lies under the name of a photograph is opened as a picture or not at all: no other program is started for it."""

from __future__ import annotations

import io
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import EpsImagePlugin, Image

from console import UserError
from training.scenes import load_pixels, load_scene
from training.scenes.picture_headers import SCAN
from training.scenes.pictures import PictureLoader, read_picture

# All that Pillow wants to see before it hands a file to Ghostscript; 48 × 48, as the photographs are.
EPS = b"""%!PS-Adobe-3.0 EPSF-3.0
%%BoundingBox: 0 0 48 48
%%EndComments
0 0 48 48 rectfill
showpage
%%EOF
"""


@pytest.fixture
def ghostscript_mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file that a stand-in for Ghostscript leaves behind when it is started."""
    programs, mark = tmp_path / "programs", tmp_path / "started"
    programs.mkdir()
    (programs / "gs").write_text(f"#!/bin/sh\ntouch '{mark}'\n")
    (programs / "gs").chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)  # it remembers where it found one
    return mark


@pytest.mark.skipif(os.name == "nt", reason="the stand-in for Ghostscript is a shell script")
@pytest.mark.parametrize("name", ["r_4.png", "r_4.jpg"])
def test_postscript_named_like_a_photograph_does_not_start_ghostscript(
    procedural_path: Path, tmp_path: Path, ghostscript_mark: Path, name: str
) -> None:
    scene = Path(shutil.copytree(procedural_path, tmp_path / "scene"))
    picture = scene / "train" / "r_4.png"
    picture.write_bytes(EPS)
    if name != picture.name:
        (scene / "transforms_train.json").write_text(
            (scene / "transforms_train.json").read_text().replace('r_4"', f'{name}"')
        )
        picture = picture.rename(picture.with_name(name))
    with pytest.raises(UserError, match=r"r_4.*found PostScript"):
        load_pixels(load_scene(scene).splits["train"])
    for read in (read_picture, lambda path: PictureLoader(path, (48, 48), (48, 48)).thumbnail(16)):
        with pytest.raises(UserError, match="found PostScript"):
            read(picture)
    assert not ghostscript_mark.exists()

    # The trap works: whoever does not name the formats starts it.
    with pytest.raises(Exception), Image.open(picture) as opened:  # noqa: B017
        opened.load()
    assert ghostscript_mark.exists()


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "TIFF", "BMP"])
def test_a_picture_of_another_format_than_its_name_says_opens(tmp_path: Path, kind: str) -> None:
    Image.new("RGB", (6, 4), (200, 100, 50)).save(tmp_path / "003.png", format=kind)
    assert read_picture(tmp_path / "003.png").shape == (4, 6, 4)


@pytest.mark.parametrize(
    "data, found",
    [
        (b"GIF89a\1\0\1\0\0\0\0;", "found a GIF"),
        (b"%PDF-1.7\n", "found a PDF"),
        (b"<html>\n<body>not found", "found text that begins '<html> <body>not found'"),
        (b"", "found an empty file"),
        (bytes(range(128, 160)), "found unknown data"),
    ],
)
def test_what_is_no_picture_is_told_for_what_it_is(tmp_path: Path, data: bytes, found: str) -> None:
    (tmp_path / "003.png").write_bytes(data)
    with pytest.raises(UserError) as raised:
        read_picture(tmp_path / "003.png")
    line = str(raised.value)
    assert "003.png" in line and "expected PNG, JPEG, WebP, TIFF, BMP, AVIF, HEIC or OpenEXR" in line and found in line


# A photograph whose decoding would take hours is refused, in the program itself, before it begins

SIZE = (64, 48)


def progressive(more: int) -> bytes:
    """A progressive JPEG that goes over its pixels so many times more than it has to, 31 bytes each time."""
    file = io.BytesIO()
    Image.new("RGB", SIZE, (200, 100, 50)).save(file, "JPEG", progressive=True)
    whole, end = file.getvalue()[:-2], file.getvalue()[-2:]
    return whole + whole[whole.rindex(SCAN) :] * more + end


def test_a_jpeg_of_many_scans_is_refused_by_all_that_decodes(tmp_path: Path) -> None:
    picture = tmp_path / "r_0.png"
    picture.write_bytes(progressive(200))
    load = PictureLoader(picture, SIZE, SIZE)
    for decode in (lambda: read_picture(picture), load, load.pixels, lambda: load.thumbnail(8)):
        with pytest.raises(UserError, match=r"r_0\.png: the picture cannot be decoded.*it has 2\d\d scans"):
            decode()


@pytest.mark.parametrize("more", [0, 50])
def test_progressive_photographs_are_decoded(tmp_path: Path, more: int) -> None:
    (tmp_path / "r_0.jpg").write_bytes(progressive(more))
    np.testing.assert_allclose(read_picture(tmp_path / "r_0.jpg")[..., 0], 200 / 255, atol=0.02)
