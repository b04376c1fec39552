"""What people keep with a scene: its scale, what they measured, and the views they come back to; and its JSON.

Points are in the pack's grid frame (y up; in forward-facing packs, before the warp), lengths in grid units. Whoever wrote the
JSON need not be trusted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

from console.streams import one_line
from viewer.app.pose import FARTHEST, UP_AXES

Point = tuple[float, float, float]
Kind = Literal["point", "line", "angle"]
Unit = Literal["", "m", "cm", "mm", "in", "ft"]
KINDS: tuple[Kind, ...] = get_args(Kind)
UNITS: tuple[Unit, ...] = get_args(Unit)
METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
LEAST_POINTS = {"point": 1, "line": 2, "angle": 3}
MOST_POINTS, MOST_MARKS = 1000, 10_000  # of a line; of each kind of mark
LONGEST_NAME = 100  # characters
SCALES = (1e-12, 1e12)
FOVS = (1.0, 170.0)  # degrees, vertical


@dataclass(frozen=True)
class Scale:
    """factor: units per grid unit. unit: "" while nobody has said what a grid unit is."""

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


@dataclass(frozen=True)
class Marks:
    """All that is kept with one scene."""

    scale: Scale = Scale()
    measurements: tuple[Measurement, ...] = ()
    bookmarks: tuple[Bookmark, ...] = ()

    def with_measurement(self, index: int, measurement: Measurement | None) -> Marks:
        """With another one in the place of `index` (one behind the last adds it); without it where there is none."""
        new = () if measurement is None else (measurement,)
        return replace(self, measurements=(*self.measurements[:index], *new, *self.measurements[index + 1 :]))

    def with_bookmark(self, index: int, bookmark: Bookmark | None) -> Marks:
        """Likewise with a bookmark."""
        new = () if bookmark is None else (bookmark,)
        return replace(self, bookmarks=(*self.bookmarks[:index], *new, *self.bookmarks[index + 1 :]))

    def with_bookmark_moved(self, index: int, to: int) -> Marks:
        """With a bookmark at another place in the order."""
        left = [bookmark for i, bookmark in enumerate(self.bookmarks) if i != index]
        left.insert(to, self.bookmarks[index])
        return replace(self, bookmarks=tuple(left))

    @property
    def empty(self) -> bool:
        """Whether there is nothing to keep."""
        return self == Marks()


def marks_to_json(marks: Marks) -> dict[str, Any]:
    """What marks_from_json reads; for json.dumps."""
    return {
        "scale": {"factor": marks.scale.factor, "unit": marks.scale.unit},
        "measurements": [{"kind": m.kind, "points": [list(p) for p in m.points]} for m in marks.measurements],
        "bookmarks": [bookmark_to_json(view) for view in marks.bookmarks],
    }


def bookmark_to_json(view: Bookmark) -> dict[str, Any]:
    """What bookmark_from_json reads."""
    return {"name": view.name, "eye": list(view.eye), "target": list(view.target), "up": view.up, "fov": view.fov}


def marks_from_json(document: Any, complain: Callable[[str], None] | None = None) -> Marks:
    """The marks in a document. ValueError, in words, for what makes no sense; with `complain`, that is told and left out."""

    def part(read: Callable[[Any], Any], value: Any, otherwise: Any) -> Any:
        try:
            return read(value)
        except ValueError as error:
            if complain is None:
                raise
            complain(str(error))
            return otherwise

    entries = part(_object, document, {})

    def listed(key: str, read: Callable[[Any], Any]) -> tuple[Any, ...]:
        values = part(lambda value: _list(value, key), entries.get(key, []), [])
        found = (part(read, value, None) for value in values)
        return tuple(each for each in found if each is not None)

    scale = part(_scale, entries.get("scale", {}), Scale())
    return Marks(scale, listed("measurements", _measurement), listed("bookmarks", bookmark_from_json))


def _object(value: Any, what: str = "marks") -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{what}: expected an object")
    return value


def _list(value: Any, what: str) -> list[Any]:
    if not isinstance(value, list) or len(value) > MOST_MARKS:
        raise ValueError(f"{what}: expected a list of at most {MOST_MARKS}")
    return value


def number_from_json(value: Any, low: float, high: float, what: str) -> float:
    """A finite number. ValueError for anything else."""
    good = (
        isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and low <= value <= high
    )
    if not good:
        raise ValueError(f"{what}: expected a number from {low:g} to {high:g}")
    return float(value)


def point_from_json(value: Any, what: str) -> Point:
    """Three numbers. ValueError for anything else."""
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{what}: expected three numbers")
    x, y, z = (number_from_json(number, -FARTHEST, FARTHEST, what) for number in value)
    return x, y, z


def _scale(value: Any) -> Scale:
    entries = _object(value, "scale")
    unit = entries.get("unit", "")
    if unit not in UNITS:
        raise ValueError("scale: expected a unit such as m, cm, mm, in or ft")
    return Scale(number_from_json(entries.get("factor", 1.0), *SCALES, "scale"), unit)


def _measurement(value: Any) -> Measurement:
    entries = _object(value, "a measurement")
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
    entries = _object(value, "a bookmark")
    eye, target = (point_from_json(entries.get(key), f"a bookmark's {key}") for key in ("eye", "target"))
    if math.dist(eye, target) < 1e-9:
        raise ValueError("a bookmark: its eye and its target are the same point")
    up = entries.get("up", "y")
    if not isinstance(up, str) or up not in UP_AXES:
        raise ValueError("a bookmark: expected up to be an axis such as y or -z")
    return Bookmark(
        named(entries.get("name")),
        eye,
        target,
        up,
        number_from_json(entries.get("fov", 35.0), *FOVS, "a bookmark's fov"),
    )


def named(text: Any) -> str:
    """A name as it is kept: one line, not too long."""
    return one_line(text, LONGEST_NAME) if isinstance(text, str) and text.strip() else "View"
