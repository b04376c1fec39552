"""What lies at a path without poses: photographs or a film, and in plain words what is neither."""

from pathlib import Path

import pytest

from console import UserError
from training.scenes.files import FileFinder, distinct
from training.scenes.sources import FEWEST, Source, container_of, find_source, require_source

MANY = [f"p{i}.jpg" for i in range(FEWEST)]


def files(folder: Path, *names: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


def found(folder: Path, *names: str) -> Source:
    source = find_source(files(folder, *names))
    assert source is not None
    return source


def names_of(source: Source) -> list[str]:
    return [source.name_of(file) for file in source.files]


def test_photographs_are_found_in_the_folder_or_just_below_it_in_the_order_of_their_numbers(tmp_path: Path):
    assert names_of(found(tmp_path / "a", "IMG_10.jpg", "IMG_9.JPG", "notes.txt")) == ["IMG_9.JPG", "IMG_10.jpg"]
    assert names_of(found(tmp_path / "b", "images/1.heic", "masks/1.png")) == ["images/1.heic"]
    assert names_of(found(tmp_path / "c", "left/1.png", "right/1.png")) == ["left/1.png", "right/1.png"]
    assert names_of(found(tmp_path / "sd", "DCIM/100APPLE/1.jpg", "DCIM/.x/2.jpg")) == ["DCIM/100APPLE/1.jpg"]
    phone = "keyframes/depth/1.png", "keyframes/images/1.jpg"  # Polycam's raw data
    assert names_of(found(tmp_path / "phone", *phone, "masks/left/1.png")) == ["keyframes/images/1.jpg"]
    assert names_of(found(tmp_path / "depths", "rgb/1.jpg", "depth/1.exr", "conf/1.png")) == ["rgb/1.jpg"]  # Record3D's
    maps = "depth_00000.png", "conf_00000.png", "thumb_00000.jpg", "textured_output.jpg"  # 3D Scanner App's
    pose = tmp_path / "scan/frame_00000.json"
    assert len(names_of(found(pose.parent, "frame_00000.jpg", pose.name, *maps))) == 1 + len(maps), "of another program"
    pose.write_text('{"cameraPoseARFrame": []}')
    assert names_of(found(pose.parent, "frame_00000.jpg")) == ["frame_00000.jpg"]
    covered = found(tmp_path / "covered", "cover.jpg", *(f"images/{name}" for name in MANY))
    said = f"the {FEWEST} pictures in folders below are used, not cover.jpg"
    assert len(covered.files) == FEWEST and covered.notes == (said,)
    copies = "images_8/1.png", "images_4/1.png"  # an LLFF scene's, of the same photograph
    assert names_of(found(tmp_path / "d", "poses_bounds.npy", *copies)) == ["images_4/1.png"]
    assert find_source(files(tmp_path / "e", "notes.txt")) is None and find_source(tmp_path / "none") is None


def test_a_scene_below_is_named_where_its_poses_would_not_be_used(tmp_path: Path):
    with pytest.raises(UserError, match=r"found .*scene\); name that folder"):
        found(tmp_path, "scene/transforms.json", "scene/images/1.jpg")


def test_a_film_with_its_cover_is_a_film_and_a_film_beside_enough_photographs_is_not(tmp_path: Path):
    for number, stills in enumerate((["cover.jpg"], MANY[:3], ["images/a.png"], ["cover.gif"], [])):
        source = found(tmp_path / f"film{number}", "w.MOV", *stills)
        assert source.kind == "film" and names_of(source) == ["w.MOV"] and len(source.notes) == bool(stills)
    assert "w.MOV is used, not cover.jpg beside it" in found(tmp_path / "one", "w.MOV", "cover.jpg").notes[0]
    assert names_of(found(tmp_path / "photographs", "walk.mp4", *MANY)) == MANY
    for number, stills in enumerate(([], ["cover.jpg"])):
        said = r"several films, .*expected one film, found a\.mp4, b\.webm\); name one of them"
        with pytest.raises(UserError, match=said):
            find_source(files(tmp_path / f"several{number}", "a.mp4", "b.webm", *stills))


def test_a_film_is_told_by_its_first_bytes_whatever_it_is_called(tmp_path: Path):
    """Of every container: tests/training/posing/test_films.py."""
    (tmp_path / "film").write_bytes(b"\0\0\0\x08wide" + bytes(64))  # as old QuickTime has it
    assert require_source(tmp_path / "film").kind == "film"
    stills = b"RIFF\0\0\0\0WEBPVP8 ", b"\0\0\0\x18ftypheic", b"\0\0\0\x18ftypmif1", b"GIF89a"
    for head in (*stills, b"#EXTM3U\n", b"G" * 99):
        (tmp_path / "other").write_bytes(head + bytes(2000))
        assert container_of(tmp_path / "other") is None


# Files are found where the description spells them otherwise (tests/fuzz/spellings.py), and never where two would do


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
    files(tmp_path, *stored)
    assert FileFinder(tmp_path).find(named) is None


def test_what_is_named_exactly_wins(tmp_path: Path):
    files(tmp_path, "a.jpg", "A.jpg", "a.png", "images/a.jpg")
    finder = FileFinder(tmp_path, tmp_path / "images")
    assert finder.find("a.jpg") == tmp_path / "a.jpg" and finder.find("A.jpg") == tmp_path / "A.jpg"
    assert finder.find("images/a.jpg") == tmp_path / "images/a.jpg"
    assert finder.find("a") == tmp_path / "a.png", "as Blender's names without a suffix mean it"


def test_file_stems_that_repeat_another_are_numbered():
    assert distinct(["a", "A", "a-2", "b"]) == ["a", "A-2", "a-2-2", "b"], "some file systems take A for a"


def test_two_names_never_lead_to_one_picture_by_guessing(tmp_path: Path):
    files(tmp_path, "01.jpg", "02.jpg")
    finder = FileFinder(tmp_path)
    assert finder.find_all(["left/01.jpg", "right/01.jpg", "02.jpg"]) == [None, None, tmp_path / "02.jpg"]
    assert finder.find_all(["02.jpg", "right/02.jpg"]) == [tmp_path / "02.jpg", None]
    assert finder.find_all(["./01.jpg", "01.jpg"]) == [tmp_path / "01.jpg"] * 2, "the same name twice"
