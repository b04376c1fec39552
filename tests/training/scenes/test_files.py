"""Files are found where the description spells them otherwise, and never where two would do."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import pytest

from training.scenes.files import FileFinder


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")


@pytest.mark.parametrize(
    ("stored", "named"),
    [
        ("images/0001.jpg", "images/0001.jpg"),
        ("images/0001.jpg", "./images//0001.jpg"),
        ("images/0001.jpg", "images\\0001.jpg"),
        ("images/0001.jpg", "C:\\capture\\images\\0001.jpg"),
        ("images/0001.jpg", "/home/somebody/capture/images/0001.jpg"),
        ("images/0001.jpg", "0001.jpg"),
        ("images/0001.JPG", "images/0001.jpg"),
        ("images/0001.JPG", "images/0001"),
        ("Images/0001.jpg", "images/0001.JPG"),
        ("images/0001.webp", "images/0001.jpg"),
        ("images/0001.webp", "images/0001"),
        ("images/r_0.5.png", "images/r_0.5"),
        (unicodedata.normalize("NFD", "images/Été.jpg"), unicodedata.normalize("NFC", "images/Été.jpg")),
        (unicodedata.normalize("NFC", "images/Été.jpg"), unicodedata.normalize("NFD", "images/été.JPG")),
        ("images/Straße 1.jpg", "images\\STRASSE 1.JPG"),
    ],
)
def test_a_picture_is_found_under_another_spelling(tmp_path: Path, stored: str, named: str):
    touch(tmp_path, stored, "images/another.png", "other/0002.jpg")
    found = FileFinder(tmp_path, tmp_path / "images").find(named)
    assert found is not None and found.samefile(tmp_path / stored)


@pytest.mark.parametrize(
    ("stored", "named"),
    [
        (("images/0001.jpg",), "images/0002.jpg"),
        (("images/a.JPG", "images/A.jpg"), "images/a.jpg"),  # two would do
        (("images/._0001.jpg",), "images/0001.jpg"),
        (("__MACOSX/0001.jpg",), "0001.png"),
        (("images/0001.txt",), "images/0001.jpg"),
        (("images/0001.jpg",), ""),
        (("images/0001.jpg",), "images"),
        (("images/0001.jpg",), "x" * 5000),
        (("images/0001.jpg",), "images/0001.jpg\0"),
    ],
)
def test_nothing_is_found_where_nothing_is_or_two_would_do(tmp_path: Path, stored: tuple[str, ...], named: str):
    touch(tmp_path, *stored)
    assert FileFinder(tmp_path).find(named) is None


def test_what_is_named_exactly_wins(tmp_path: Path):
    touch(tmp_path, "a.jpg", "A.jpg", "a.png", "images/a.jpg")
    finder = FileFinder(tmp_path, tmp_path / "images")
    assert finder.find("a.jpg") == tmp_path / "a.jpg" and finder.find("A.jpg") == tmp_path / "A.jpg"
    assert finder.find("images/a.jpg") == tmp_path / "images/a.jpg"
    assert finder.find("a") == tmp_path / "a.png", "as Blender's names without a suffix mean it"


def test_two_names_never_lead_to_one_picture_by_guessing(tmp_path: Path):
    touch(tmp_path, "01.jpg", "02.jpg")
    finder = FileFinder(tmp_path)
    assert finder.find_all(["left/01.jpg", "right/01.jpg", "02.jpg"]) == [None, None, tmp_path / "02.jpg"]
    assert finder.find_all(["02.jpg", "right/02.jpg"]) == [tmp_path / "02.jpg", None]
    assert finder.find_all(["./01.jpg", "01.jpg"]) == [tmp_path / "01.jpg"] * 2, "the same name twice"
