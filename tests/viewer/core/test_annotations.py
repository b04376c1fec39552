"""Scale, measurements and bookmarks: what they say, and how they are kept with a pack and read back."""

import csv
import io
import os
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenepack import Pack, load_pack, save_pack
from scenepack.placement import NOT_MOVED
from tests.scenepack.helpers import edit_json, read_json, written
from tests.viewer.waiting import not_none, until
from viewer.app.application import App
from viewer.core.annotations import (
    Annotations,
    Bookmark,
    Measurement,
    Scale,
    annotations_from_json,
    annotations_to_json,
    file_for,
)
from viewer.features.measuring.measure_tool import LengthFormat, as_csv, as_text
from viewer.rendering.settings import Look

LINE = Measurement("line", ((0.0, 0.0, 0.0), (3.0, 4.0, 0.0), (3.0, 4.0, 2.0)))
ANGLE = Measurement("angle", ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 1.0, 0.0)))
POINT = Measurement("point", ((0.5, -0.25, 0.125),))
VIEW = Bookmark("The façade", (0.0, 1.0, 4.0), (0.0, 0.0, 0.0), "z", 40.0)
PLACE = replace(VIEW, name="Top", point=(0.1, 0.2, -0.3), text="Two lines\nof <b>text</b>")
LOOK = Look(0.5, -0.2, 0.1, 1.5)
ANNOTATIONS = Annotations(Scale(2.5, "m"), (LINE, ANGLE, POINT), (VIEW, PLACE), LOOK)


def test_words_have_as_many_digits_as_voxels_are_worth(pack: Pack):
    words = LengthFormat(replace(pack, voxel_size=0.02), Annotations(Scale(1.0, "m")))
    assert words.length(1.23456) == "1.23 m" and words.measurement(LINE) == "7.00 m = 5.00 + 2.00"
    assert LengthFormat(replace(pack, voxel_size=0.02), Annotations(Scale(100.0, "cm"))).length(1.23456) == "123 cm"
    assert LengthFormat(pack, Annotations()).measurement(ANGLE) == "45.0°"
    assert words.place((-0.004, 0.0, 1.0)) == "0.00  0.00  1.00"


def test_the_table_has_a_row_for_each_point_and_the_text_a_line_for_each_measurement(pack: Pack):
    rows = list(csv.DictReader(io.StringIO(as_csv(pack, ANNOTATIONS))))
    assert [(row["measurement"], row["kind"], row["point"]) for row in rows][:4] == [
        ("1", "line", "1"), ("1", "line", "2"), ("1", "line", "3"), ("2", "angle", "1"),
    ]  # fmt: skip
    assert [row["length"] for row in rows[:3]] == ["", "12.500000", "5.000000"] and rows[2]["total"] == "17.500000"
    assert rows[4]["angle_degrees"] == "45.0000" and rows[6]["x"] == "1.250000" and rows[6]["unit"] == "m"
    scene = [float(rows[6][f"scene_{axis}"]) for axis in "xyz"]
    assert scene == pytest.approx([-0.5, 0.125, -0.25])  # the Blender frame, unscaled
    assert len(as_text(pack, ANNOTATIONS).splitlines()) == 3


@pytest.mark.parametrize(
    ("part", "value", "words"),
    [("scale", {"factor": 0, "unit": "m"}, "scale"), ("scale", {"factor": 1, "unit": "mile"}, "unit"),
     ("measurements", {"kind": "line"}, "list"), ("measurements", [{"kind": "line", "points": [[0, 0, 0]]}], "2 points"),
     ("placement", {"origin": [0, 0]}, "origin"), ("look", {"exposure": 9}, "exposure"),
     ("bookmarks", [{"name": 3, "eye": [0, 0, 1], "target": [0, 0, 1]}], "same point")],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_or_left_out(part, value, words):
    document = {**annotations_to_json(ANNOTATIONS), part: value}
    with pytest.raises(ValueError, match=words):
        annotations_from_json(document)
    notes: list[str] = []
    left = annotations_from_json(document, notes.append)
    assert len(notes) == 1 and words in notes[0]
    kept = {"scale": ANNOTATIONS.scale, "measurements": ANNOTATIONS.measurements, "bookmarks": ANNOTATIONS.bookmarks}
    assert all(getattr(left, name) == whole for name, whole in kept.items() if name != part)


def test_a_name_is_one_line_and_not_endless_and_a_text_holds_no_control_characters():
    document = annotations_to_json(Annotations(bookmarks=(replace(VIEW, name="x" * 5000),)))
    assert len(annotations_from_json(document).bookmarks[0].name) < 120
    document["bookmarks"][0] |= {"name": "one\n\x1b[2Jtwo", "text": "A ball\n\x1b[31mred"}
    read = annotations_from_json(document).bookmarks[0]
    assert "\x1b" not in read.name and read.text == "A ball\n\ufffd[31mred"


def opened(path: Path, user: Path) -> App:
    app = App()
    app.annotations.folder = user
    app.show(load_pack(path), path)
    return app


def keep(app: App, annotations: Annotations) -> None:
    app.annotations.change(app, annotations)
    until(lambda: app.tick(0.01) or not_none(app.annotations._autosave).saved == annotations)
    app.annotations.close_pack(app)


@pytest.fixture
def own(tmp_path: Path, pack: Pack) -> Path:
    return written(tmp_path / "own", pack)


def test_a_folder_of_ours_carries_its_marks_and_opens_elsewhere(own: Path, tmp_path: Path):
    before = {file.name: file.read_bytes() for file in own.iterdir() if file.suffix == ".png"}
    keep(opened(own, tmp_path / "user"), ANNOTATIONS)
    assert not (tmp_path / "user").exists()
    assert {file.name: file.read_bytes() for file in own.iterdir() if file.suffix == ".png"} == before
    document = read_json(own)
    assert document["snerg"]["marks"]["scale"] == {"factor": 2.5, "unit": "m"} and document["snerg"]["version"]
    assert opened(own.rename(tmp_path / "moved"), tmp_path / "another user").annotations.current == ANNOTATIONS
    save_pack(load_pack(tmp_path / "moved"), tmp_path / "packed.zip")
    assert opened(tmp_path / "packed.zip", tmp_path / "another user").annotations.current == ANNOTATIONS
    keep(opened(tmp_path / "moved", tmp_path / "user"), Annotations())
    assert "marks" not in read_json(tmp_path / "moved")["snerg"]


@pytest.mark.parametrize("kind", ["zip", "foreign", "read-only"])
def test_what_is_not_ours_to_change_is_not_changed(pack: Pack, tmp_path: Path, kind: str):
    path = tmp_path / ("pack.zip" if kind == "zip" else "pack")
    save_pack(pack, path)
    if kind == "foreign":
        edit_json(path, lambda document: document.pop("snerg"))
    if kind == "read-only":
        if os.geteuid() == 0:
            pytest.skip("root may write anywhere")
        path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    files = [path] if path.is_file() else sorted(path.iterdir())
    before = [file.read_bytes() for file in files]
    moved = replace(ANNOTATIONS, placement=NOT_MOVED.levelled(np.array([0.1, 0.9, 0.0]), np.zeros(3)))
    keep(opened(path, tmp_path / "user"), moved)
    assert [file.read_bytes() for file in files] == before
    assert len(list((tmp_path / "user").glob("*.json"))) == 1
    again = opened(path.rename(path.with_stem("elsewhere")), tmp_path / "user")
    assert again.annotations.current == moved and again.open_scene.rig.table.placed == moved.placement.rotation
    keep(opened(path.with_stem("elsewhere"), tmp_path / "user"), Annotations())
    assert not list((tmp_path / "user").glob("*.json"))


def test_a_broken_file_of_the_user_is_told_in_the_log_and_nothing_else(tmp_path: Path, pack: Pack):
    save_pack(pack, tmp_path / "pack.zip")
    file = file_for(load_pack(tmp_path / "pack.zip"), tmp_path / "user")
    file.parent.mkdir()
    file.write_text('{"scale": {"factor": 1e999}}')
    app = opened(tmp_path / "pack.zip", tmp_path / "user")
    assert app.annotations.current == Annotations() and not app.messages.dialogs
    assert any("left out" in line.text for line in app.messages.lines)


def test_marks_that_cannot_be_written_are_told_once(own: Path, pack: Pack, tmp_path: Path):
    app = opened(own, tmp_path / "user")
    (own / "scene_params.json").unlink()
    (tmp_path / "user").write_text("a file where the folder should be")
    keep_told = []
    for factor in (2.0, 3.0):
        app.annotations.change(app, Annotations(Scale(factor, "m")))
        autosave = not_none(app.annotations._autosave)
        until(lambda: app.tick(0.01) or (autosave.saved == app.annotations.current and not autosave.writing))  # noqa: B023
        app.tick(0.01)
        keep_told.append(sum("not saved" in line.text for line in app.messages.lines))
    assert keep_told == [1, 1]
    app.show(pack, tmp_path / "another")
    app.tick(0.01)
    assert sum("not saved" in line.text for line in app.messages.lines) == 1


def test_the_last_change_is_written_when_the_scene_is_closed(own: Path, tmp_path: Path):
    app = opened(own, tmp_path / "user")
    app.annotations.change(app, ANNOTATIONS)
    app.close()
    assert opened(own, tmp_path / "user").annotations.current == ANNOTATIONS
