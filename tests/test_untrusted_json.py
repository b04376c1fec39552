"""JSON that nobody writes by mistake: whoever reads it says no in one line, and never with a traceback."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from console import UserError
from console.json_text import MOST_BYTES, parse_json
from console.progress_protocol import read_report
from scenepack import load_pack
from tests.scenepack.helpers import small_pack, written
from tools.procedural import write_procedural_scene
from training.config import TINY, from_json
from training.recorder import MetricsLog
from training.run import read_description
from training.scenes import load_scene
from viewer.core.annotations import annotations_from_json
from viewer.core.pose import pose_from_text
from viewer.features.film.camera_path import load_path
from viewer.features.opening.session import load_session
from viewer.features.preferences import preferences

# As they stand in the file; json.dumps would not write most of them.
HOSTILE = {
    "out of float64's range": "1" + "0" * 400,
    "five thousand digits": "7" * 5000,
    "a negative one": "-" + "7" * 5000,
    "infinite": "Infinity",
    "no number": "NaN",
    "1e999": "1e999",
    "nested": "[" * 400 + "]" * 400,
    "nested objects": '{"a":' * 300 + "1" + "}" * 300,
    "deeper than the parser goes": "[" * 200_000,
    "true": "true",
    "null": "null",
    "text": '"text"',
    "a NUL": '"a\\u0000b"',
    "a long name": '"' + "n" * 100_000 + '"',
    "an empty list": "[]",
    "an object": '{"x": {}}',
    "ragged": "[[1, 2], [3]]",
    "huge numbers": "[[1e308, 1e308, 1e308, 1e308]]",
}
PLACE = "@here@"


def places(document: Any) -> list[list[Any]]:
    """Paths to every value of `document`, but of a list only to its first."""
    found: list[list[Any]] = []
    if isinstance(document, dict):
        for key, value in document.items():
            found += [[key], *([key, *rest] for rest in places(value))]
    elif isinstance(document, list) and document:
        found += [[0], *([0, *rest] for rest in places(document[0]))]
    return found


def spoilt(document: Any) -> list[str]:
    """The document's text, once for each place and each hostile value in it."""
    texts = []
    for path in places(document):
        copy = json.loads(json.dumps(document))
        inner = copy
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = PLACE
        text = json.dumps(copy)
        texts += [text.replace(f'"{PLACE}"', value) for value in HOSTILE.values()]
    return texts


def read_all(document: Any, file: Path, read: Callable[[], Any], allowed: type[Exception] = UserError) -> int:
    """Reads every spoilt document; how many were refused. Whatever else is raised fails the test."""
    refused = 0
    for text in spoilt(document):
        file.write_text(text)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                read()
            except allowed as error:
                refused += 1
                assert "\n" not in str(error)
    return refused


def test_packs(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack", small_pack().with_metadata(cameras=[{"name": "a"}]))
    file = folder / "scene_params.json"
    document = json.loads(file.read_text())
    assert read_all(document, file, lambda: load_pack(folder)) > 200


def test_scenes(tmp_path: Path) -> None:
    scene = write_procedural_scene(tmp_path / "scene", size=8, views=2, subpixels=1)
    file = scene / "transforms_train.json"
    assert read_all(json.loads(file.read_text()), file, lambda: load_scene(scene)) > 50


def test_descriptions_of_runs(tmp_path: Path) -> None:
    document = {
        "format": 1, "scene": "/scene", "scene_options": {"downscale": 2, "aabb": [-1, -1, -1, 1, 1, 1]},
        "config": dataclasses.asdict(TINY), "provenance": {"host": "here"},
    }  # fmt: skip
    assert read_all(document, tmp_path / "config.json", lambda: read_description(tmp_path)) > 400


def test_journals(tmp_path: Path) -> None:
    """Records that make no sense are left out, like the one that a kill cut off."""
    file = tmp_path / "metrics.jsonl"
    read_all({"step": 3, "seconds": 2.5, "training_seconds": 2.0}, file, lambda: MetricsLog(file, 10))


def test_settings_paths_poses_and_progress(tmp_path: Path) -> None:
    """Settings that make no sense are the defaults; a path or a pose is refused."""
    file = tmp_path / "file.json"
    settings = dataclasses.asdict(preferences.Preferences())
    assert read_all(settings, file, lambda: preferences.load(file)) == 0
    matrix = np.eye(4).ravel().tolist()
    path = {"keyframes": [{"matrix": matrix, "fov": 40.0}], "is_cycle": False, "default_transition_sec": 2.0}
    assert read_all(path, file, lambda: load_path(file, np.eye(4))) > 30
    pose = {"eye": [0, 0, 1], "target": [0, 0, 0], "up": [0, 1, 0], "fov": 40.0}
    assert read_all(pose, file, lambda: pose_from_text(file.read_text()), ValueError) > 30
    view = {"name": "a", "eye": [0, 0, 1], "target": [0, 0, 0], "up": "y", "fov": 40.0}
    measured = [{"kind": "line", "points": [[0, 0, 0], [1, 0, 0]]}]
    annotations = {"scale": {"factor": 2.0, "unit": "m"}, "measurements": measured, "bookmarks": [view]}
    session = {"snerg_session": 1, "page": "view", "compare": {"path": "b", "how": "wipe"},
               "packs": [{"path": "a", "camera": view, "crop": [[0, 0, 0], [1, 1, 1]], "near": 0.0,
                          "marks": annotations}]}  # fmt: skip
    assert read_all(session, file, lambda: load_session(file)) > 300
    no_json = read_all(annotations, file, lambda: parse_json(file.read_text()), ValueError)
    assert (
        read_all(annotations, file, lambda: annotations_from_json(parse_json(file.read_text()), str), ValueError)
        == no_json
    )
    report = {"title": "t", "note": "", "done": 1, "total": 2, "seconds": 1, "begun": 0, "stage": "s",
              "metrics": {"psnr": 20}, "error": "", "bug": False}  # fmt: skip
    assert read_all(report, file, lambda: read_report(file)) == 0


def test_a_value_comes_back_as_it_was_written() -> None:
    document = {"whole": 123456789012345678, "float": 0.1, "text": "日本語", "list": [1, -2.5, None, True]}
    assert parse_json(json.dumps(document)) == document
    assert parse_json(b"\xef\xbb\xbf" + json.dumps(document).encode()) == document
    assert type(parse_json("17")) is int and parse_json("9" * 30) == 1e30


def test_more_than_anybody_writes_is_not_parsed() -> None:
    with pytest.raises(ValueError, match="16 MiB"):
        parse_json(b" " * (MOST_BYTES + 1))


@pytest.mark.parametrize(
    ("name", "value"),
    [("batch_size", -1), ("log_every", 0), ("seed", 10**20), ("steps", -5), ("minutes", float("nan")), ("nerf.width", 0),
     ("multires.occupancy", 0), ("multires.view_octaves", -1), ("multires.steps_from", [0.1, float("nan")]),
     ("nerf.first_rate", -1.0), ("checkpoint_every", 0), ("nerf.depth", 2.5), ("method", "magic")],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused_by_name(name: str, value: object) -> None:
    document = dataclasses.asdict(TINY)
    inner = document
    for part in name.split(".")[:-1]:
        inner = inner[part]
    inner[name.split(".")[-1]] = value
    with pytest.raises(UserError, match=name.split(".")[-1].replace("_", ".")):
        from_json(type(TINY), document, "config.json")


def test_a_copy_of_a_run_is_still_read(tmp_path: Path) -> None:
    older = Path(__file__).parent / "data" / "older"
    for config in older.rglob("config.json"):
        shutil.copy(config, tmp_path / "config.json")
        with contextlib.suppress(FileNotFoundError):
            assert read_description(tmp_path).config.steps > 0
