"""Small files of the viewer: preferences, camera paths, poses."""

import json
from pathlib import Path

import numpy as np

from console import UserError
from console.json_text import read_json_file
from viewer.app.application import App
from viewer.core.annotations import (
    Annotations,
    Bookmark,
    Measurement,
    Scale,
    annotations_from_json,
    annotations_to_json,
)
from viewer.core.pose import pose_from_text, pose_to_text
from viewer.features.film.camera_path import CameraPath, Keyframe, load_path, save_path
from viewer.features.opening.session import Seen, Session, load_session, save_session
from viewer.features.preferences import preferences

BASES = ("preferences", "path", "older-path", "pose", "session", "marks")
FILE = "file.json"
LOW, HIGH = (0.0, 0.0, 0.0), (1.0, 2.0, 3.0)
VIEW = Bookmark("The door", (0.0, 1.0, 4.0), LOW)
ANNOTATIONS = Annotations(Scale(2.0, "m"), (Measurement("line", (LOW, HIGH)),), (VIEW,))
MOST_SECONDS = 1e6


def write_base(name: str, folder: Path) -> None:
    """One file of the kind, with a value for each of its keys."""
    folder.mkdir(parents=True)
    file = folder / FILE
    pose = np.eye(4)
    pose[:3, 3] = HIGH
    if name == "preferences":
        app = App()
        app.preferences.recent, app.interface.moved = ["/a", "/b"], ["view"]
        file.write_text(json.dumps(preferences.current_preferences(app)))
    elif name == "path":
        keys = [Keyframe(np.eye(4), 50.0), Keyframe(pose, 40.0, 1.0)]
        save_path(CameraPath(keys, closed=True), file, np.eye(4), (64, 48), 1.0)
    elif name == "older-path":
        keys = [{"matrix": json.dumps(pose.T.ravel().tolist()), "fov": 50, "aspect": 1.3}] * 2
        file.write_text(json.dumps({"keyframes": keys, "default_transition_sec": 2.0, "is_cycle": False}))
    elif name == "pose":
        file.write_text(pose_to_text(pose, 40.0))
    elif name == "session":
        seen = Seen(folder / "pack", VIEW, crop=(LOW, HIGH), annotations=ANNOTATIONS)
        save_session(Session((seen,)), file)
    else:
        file.write_text(json.dumps(annotations_to_json(ANNOTATIONS)))


def open_it(path: Path, base: str) -> None:
    """Reads it as the viewer does, and asks for what the viewer then asks for."""
    file = path / FILE
    if base == "preferences":
        app = App()
        preferences.apply_preferences(app, preferences.load(file))
        app.preferences.recent_packs()
        numbers = [*app.preferences.window, *app.settings.background, app.resolution.target_fps]
        if not np.isfinite(numbers).all() or not 0 <= min(numbers) <= max(numbers) < 2**31:
            raise AssertionError("no window is of that size")
        values = preferences.current_preferences(app)
        preferences.save(values, path / "again.json", preferences.current_preferences(App()))
    elif base == "session":
        found = load_session(file)
        save_session(found, path / "again.json")
        if load_session(path / "again.json") != found:
            raise AssertionError("it is another session when it is saved again")
    elif base == "marks":
        try:
            annotations = annotations_from_json(read_json_file(file), lambda note: None)
        except (OSError, ValueError) as error:
            raise UserError(str(error)) from None
        if annotations_from_json(json.loads(json.dumps(annotations_to_json(annotations)))) != annotations:
            raise AssertionError("what was taken is not taken again")
    elif base == "pose":
        try:
            matrix, *_ = pose_from_text(file.read_text(encoding="utf-8", errors="replace") if file.is_file() else "")
        except ValueError as error:  # which the dialog shows
            raise UserError(str(error)) from None
        _require_finite(matrix)
    else:
        flight = load_path(file, np.eye(4))
        if not 0 <= flight.duration < MOST_SECONDS * max(len(flight.keyframes), 1):
            raise AssertionError("the flight never ends")
        for share in (0.0, 0.3, 1.0, 1.7) if flight.keyframes else ():
            matrix, fov = flight.at(share * flight.duration)
            _require_finite(matrix)
            if not 1 <= fov <= 170:
                raise AssertionError("no field of view")


def _require_finite(matrix: np.ndarray) -> None:
    if not np.isfinite(matrix).all():
        raise AssertionError("the camera stands nowhere")
