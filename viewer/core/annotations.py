"""Annotations of a scene: its scale, placement, look, measurements and bookmarks; their JSON, and where they are saved.

Points are in the pack's grid frame (y up; in forward-facing packs, before the warp). Lengths are in grid units.
The JSON is untrusted.

A writable folder of this project's format holds its own annotations, in its "snerg" object. Other packs are not changed: theirs
are in a file of the user's, named by a hash of the pack's own parameters, so that a pack that was moved keeps them. A thread
writes changes a moment after the last one.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import platformdirs

from console import not_written
from console.atomic import write_file
from console.json_text import read_json_file
from console.streams import one_line
from scenepack.pack import Pack, number_in
from scenepack.placement import MARKS as KEY
from scenepack.placement import (
    NOT_MOVED,
    SCALES,
    UNITS,
    Placement,
    Unit,
    allowed,
    placement_from_json,
    placement_to_json,
)
from scenepack.writer import metadata_writable, write_metadata
from viewer.core.pose import FARTHEST, POSSIBLE_FOVS, UP_AXES
from viewer.core.tasks import Autosave
from viewer.rendering.settings import LOOKS, Look

if TYPE_CHECKING:
    from viewer.app.application import App


Point = tuple[float, float, float]
Kind = Literal["point", "line", "angle"]
KINDS: tuple[Kind, ...] = get_args(Kind)
METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
LEAST_POINTS = {"point": 1, "line": 2, "angle": 3}
MOST_POINTS, MOST_ANNOTATIONS = 1000, 10_000  # of a line; of each kind
LONGEST_NAME, LONGEST_TEXT = 100, 2000  # characters


@dataclass(frozen=True)
class Scale:
    """factor: units per grid unit. unit: "" while the scale is unknown."""

    factor: float = 1.0
    unit: Unit = ""

    def shown_in(self, unit: Unit) -> Scale:
        """The same scale in another unit; this one where either is none."""
        if unit not in METRES or self.unit not in METRES:
            return self
        return Scale(self.factor * METRES[self.unit] / METRES[unit], unit)


@dataclass(frozen=True)
class Measurement:
    """kind "point": one point. "line": two or more. "angle": three, at the second of them."""

    kind: Kind
    points: tuple[Point, ...]


@dataclass(frozen=True)
class Bookmark:
    """A saved view. eye, target: of the camera and of what it turns about. up: a key of UP_AXES. fov: vertical, degrees."""

    name: str
    eye: Point
    target: Point
    up: str = "y"
    fov: float = 35.0
    point: Point | None = None  # the place that it shows, marked in the picture
    text: str = ""  # what there is to say of it


@dataclass(frozen=True)
class Annotations:
    scale: Scale = Scale()
    measurements: tuple[Measurement, ...] = ()
    bookmarks: tuple[Bookmark, ...] = ()
    look: Look | None = None  # None: colours as they are
    placement: Placement = NOT_MOVED

    @property
    def placed_T_grid(self) -> np.ndarray:
        """float64 [4, 4]."""
        return self.placement.matrix(self.scale.factor)

    def with_measurement(self, index: int, measurement: Measurement | None) -> Annotations:
        """With another one in the place of `index` (one behind the last adds it); without it where there is none."""
        new = () if measurement is None else (measurement,)
        return replace(self, measurements=(*self.measurements[:index], *new, *self.measurements[index + 1 :]))


def annotations_to_json(annotations: Annotations) -> dict[str, Any]:
    placement = annotations.placement
    return {
        "scale": asdict(annotations.scale),
        "measurements": [{"kind": m.kind, "points": [list(p) for p in m.points]} for m in annotations.measurements],
        "bookmarks": [bookmark_to_json(view) for view in annotations.bookmarks],
        **({} if annotations.look is None else {"look": asdict(annotations.look)}),
        **({} if placement == NOT_MOVED else {"placement": placement_to_json(placement)}),
    }


def bookmark_to_json(view: Bookmark) -> dict[str, Any]:
    fields = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(view).items()}
    return {name: value for name, value in fields.items() if value not in (None, "")}


def annotations_from_json(document: Any, complain: Callable[[str], None] | None = None) -> Annotations:
    """The annotations in a document. Bad values raise ValueError; with `complain`, they are reported and left out."""

    def part(read: Callable[[Any], Any], value: Any, otherwise: Any) -> Any:
        try:
            return read(value)
        except ValueError as error:
            if complain is None:
                raise
            complain(str(error))
            return otherwise

    entries = part(lambda value: object_from_json(value, "marks"), document, {})

    def listed(key: str, read: Callable[[Any], Any]) -> tuple[Any, ...]:
        values = part(lambda value: _list(value, key), entries.get(key, []), [])
        found = (part(read, value, None) for value in values)
        return tuple(each for each in found if each is not None)

    scale = part(_scale, entries.get("scale", {}), Scale())
    look = part(_look, entries.get("look", {}), None)
    measurements, bookmarks = listed("measurements", _measurement), listed("bookmarks", bookmark_from_json)
    placement = part(placement_from_json, entries.get("placement", {}), NOT_MOVED)
    return Annotations(scale, measurements, bookmarks, look, placement)


def object_from_json(value: Any, what: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{what}: expected an object")
    return value


def _list(value: Any, what: str) -> list[Any]:
    if not isinstance(value, list) or len(value) > MOST_ANNOTATIONS:
        raise ValueError(f"{what}: expected a list of at most {MOST_ANNOTATIONS}")
    return value


def number_from_json(value: Any, low: float, high: float, what: str) -> float:
    number = number_in(value, low, high)
    if number is None:
        raise ValueError(f"{what}: expected a number from {low:g} to {high:g}")
    return number


def point_from_json(value: Any, what: str) -> Point:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{what}: expected three numbers")
    x, y, z = (number_from_json(number, -FARTHEST, FARTHEST, what) for number in value)
    return x, y, z


def _scale(value: Any) -> Scale:
    entries = object_from_json(value, "scale")
    unit = entries.get("unit", "")
    if unit not in UNITS:
        raise ValueError("scale: expected a unit such as m, cm, mm, in or ft")
    return Scale(number_from_json(entries.get("factor", 1.0), *SCALES, "scale"), unit)


def _look(value: Any) -> Look | None:
    entries = object_from_json(value, "look")
    known = {name: number_from_json(entries[name], *LOOKS[name], f"look's {name}") for name in LOOKS if name in entries}
    return Look(**known) if known else None


def _measurement(value: Any) -> Measurement:
    entries = object_from_json(value, "a measurement")
    kind, points = entries.get("kind"), entries.get("points")
    if kind not in KINDS:
        raise ValueError("a measurement: expected a point, a line or an angle")
    least = LEAST_POINTS[kind]
    most = MOST_POINTS if kind == "line" else least
    if not isinstance(points, list) or not least <= len(points) <= most:
        raise ValueError(f"a measurement: expected {least} points" + (" or more" if most > least else ""))
    return Measurement(kind, tuple(point_from_json(point, "a measurement") for point in points))


def bookmark_from_json(value: Any) -> Bookmark:
    """A view. ValueError, in words, for what makes no sense."""
    entries = object_from_json(value, "a bookmark")
    eye, target = (point_from_json(entries.get(key), f"a bookmark's {key}") for key in ("eye", "target"))
    if math.dist(eye, target) < 1e-9:
        raise ValueError("a bookmark: its eye and its target are the same point")
    up = entries.get("up", "y")
    if not isinstance(up, str) or up not in UP_AXES:
        raise ValueError("a bookmark: expected up to be an axis such as y or -z")
    fov = number_from_json(entries.get("fov", 35.0), *POSSIBLE_FOVS, "a bookmark's fov")
    point = None if entries.get("point") is None else point_from_json(entries["point"], "a bookmark's point")
    return Bookmark(named(entries.get("name")), eye, target, up, fov, point, worded(entries.get("text")))


def worded(text: Any) -> str:
    """A text of at most LONGEST_TEXT characters, with its lines, and without control characters; "" for what is none."""
    lines = text[:LONGEST_TEXT].split("\n") if isinstance(text, str) else []
    return "\n".join(one_line(line, LONGEST_TEXT) for line in lines)


def named(text: Any) -> str:
    """A name cut to one line of at most LONGEST_NAME characters."""
    return one_line(text, LONGEST_NAME) if isinstance(text, str) and text.strip() else "View"


SETTLE_S = 0.4  # after the last change, before it is written


def default_folder() -> Path:
    """Folder for the annotations of packs that are not changed."""
    return platformdirs.user_data_path("snerg", appauthor=False) / "marks"


def file_for(pack: Pack, folder: Path) -> Path:
    """The file in `folder` with the annotations of `pack`, the same wherever the pack is."""
    own = {key: value for key, value in pack.params.items() if key != "snerg"}
    return folder / f"{hashlib.sha256(json.dumps(own, sort_keys=True, default=str).encode()).hexdigest()[:32]}.json"


def read_annotations(
    pack: Pack,
    path: Path | None = None,
    folder: Path | None = None,
    complain: Callable[[str], None] = lambda note: None,
) -> Annotations:
    """Those in `pack`; of a pack at `path` that is not changed, those in the user's `folder`, if any. What is bad is left out."""
    document = pack.metadata.get(KEY)
    if path is not None and folder is not None and not metadata_writable(pack, path):
        file = file_for(pack, folder)
        try:
            document = read_json_file(file)
        except FileNotFoundError:
            pass
        except (OSError, ValueError) as error:
            complain(f"{file}: {error}")
    annotations = annotations_from_json({} if document is None else document, complain)
    return replace(annotations, placement=allowed(annotations.placement, pack))


@dataclass
class AnnotationStore:
    """Reads the annotations of the open pack, and writes them when they change."""

    current: Annotations = field(default_factory=Annotations)
    folder: Path | None = None  # of the user's files; None: nothing is written, as in scripts
    _autosave: Autosave[Annotations] | None = None

    def open_pack(self, app: App, pack: Pack, path: Path | None, annotations: Annotations | None = None) -> None:
        """Writes the annotations of the last pack and reads those of `pack`. path: None if they are not saved.

        annotations: of `pack`, if it was open before; those in `pack` may be older.
        """
        self.close_pack(app)
        notes: list[str] = []
        if annotations is None:
            annotations = read_annotations(pack, path, self.folder, notes.append)
        for note in dict.fromkeys(notes):
            app.messages.log(f"marks of this scene are left out: {note}", "warning")
        self.current = annotations
        self._autosave = Autosave(partial(_write, pack, path, self.folder), annotations, SETTLE_S)

    def save_now(self) -> None:
        """Writes changes now, because another process is about to read them."""
        if self._autosave is not None:
            self._autosave.finish(self.current)

    def close_pack(self, app: App) -> None:
        """Writes changes now, because the pack is closed or the program ends."""
        self.save_now()
        self._report(app)
        self.current, self._autosave = Annotations(), None

    def change(self, app: App, annotations: Annotations) -> None:
        """Changes the annotations in one step that can be undone."""
        if app.scene is not None and annotations != self.current:
            app.scene.rig.remember()
            self.current = annotations
            app.touch()

    def tick(self, app: App) -> None:
        """Writes what has not changed for a moment. Reports a failure once for each pack."""
        self._report(app)
        if self._autosave is not None:
            self._autosave.follow(self.current)

    def _report(self, app: App) -> None:
        if self._autosave is not None and (problem := self._autosave.new_problem()):
            app.messages.say(problem, "warning")
            app.touch()


def _write(pack: Pack, path: Path | None, folder: Path | None, annotations: Annotations) -> str | None:
    """Writes annotations into the pack or the user's file, unless a path is None. Returns what went wrong, or None."""
    if path is None or folder is None:
        return None
    document = None if annotations == Annotations() else annotations_to_json(annotations)
    file = file_for(pack, folder)
    try:
        if metadata_writable(pack, path):
            write_metadata(path, KEY, document)
        elif document is None:
            file.unlink(missing_ok=True)
        else:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_file(file, json.dumps(document, indent=1))
    except (OSError, ValueError) as error:
        why = "; ".join(not_written(error)) if isinstance(error, OSError) else error
        return f"Measurements and bookmarks are not saved: {why}"
    return None
