"""Measurements as numbers and as text: lengths, angles, coordinates, and a table of all of them (CSV)."""

from __future__ import annotations

import csv
import io
from itertools import pairwise
from math import acos, ceil, degrees, dist, log10

import numpy as np

from scenepack.pack import Pack
from viewer.app.annotations import Annotations, Measurement, Point, Scale

MOST_DECIMALS = 6
WARPED_DECIMALS = 3  # in forward-facing packs, whose voxels are not of one size
COLUMNS = (
    "measurement", "kind", "point", "x", "y", "z", "scene_x", "scene_y", "scene_z", "length", "total", "angle_degrees", "unit",
)  # fmt: skip


def lengths(points: tuple[Point, ...]) -> list[float]:
    """Of each piece of a polyline, grid units."""
    return [dist(a, b) for a, b in pairwise(points)]


def angle(points: tuple[Point, ...]) -> float:
    """Degrees between the ways from the second of three points to the others; 0 where two points are the same."""
    a, b, c = (np.asarray(point, np.float64) for point in points)
    one, two = a - b, c - b
    size = float(np.linalg.norm(one) * np.linalg.norm(two))
    return degrees(acos(float(np.clip(one @ two / size, -1.0, 1.0)))) if size > 0 else 0.0


class Words:
    """Lengths and places of one pack in words, with as many decimals as its voxels are worth: half of one is the error."""

    def __init__(self, pack: Pack, scale: Scale) -> None:
        self.pack, self.scale = pack, scale
        error = 0.5 * pack.voxel_size * scale.factor
        needed = WARPED_DECIMALS if pack.ndc else ceil(-log10(error))
        self.decimals = min(max(needed, 0), MOST_DECIMALS)

    def number(self, grid_units: float) -> str:
        """A length without its unit."""
        return f"{grid_units * self.scale.factor:.{self.decimals}f}"

    def length(self, grid_units: float) -> str:
        """A length with its unit."""
        return f"{self.number(grid_units)} {self.scale.unit}".rstrip()

    def place(self, point: Point) -> str:
        """Coordinates in the grid's frame."""
        return "  ".join(self.number(value) for value in point)

    def in_scene(self, point: Point) -> Point:
        """The same place in the frame of the scene's own cameras, unscaled."""
        moved = np.asarray(self.pack.worldspace_T_opengl, np.float64) @ np.array([*point, 1.0])
        return float(moved[0]), float(moved[1]), float(moved[2])

    def measurement(self, measurement: Measurement) -> str:
        """What it measures, in a line."""
        if measurement.kind == "point":
            return self.place(measurement.points[0])
        if measurement.kind == "angle":
            return f"{angle(measurement.points):.1f}°"
        pieces = lengths(measurement.points)
        parts = f" = {' + '.join(self.number(piece) for piece in pieces)}" if len(pieces) > 1 else ""
        return self.length(sum(pieces)) + parts


def as_text(pack: Pack, annotations: Annotations) -> str:
    """All measurements, a line each; for the clipboard."""
    words = Words(pack, annotations.scale)
    return "\n".join(f"{m.kind} {i}: {words.measurement(m)}" for i, m in enumerate(annotations.measurements, 1))


def as_csv(pack: Pack, annotations: Annotations) -> str:
    """A table with a row for each point: x, y, z and lengths in `unit` (grid units where it is empty), scene_* unscaled."""
    words, text = Words(pack, annotations.scale), io.StringIO()
    factor, places = annotations.scale.factor, MOST_DECIMALS
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for i, measurement in enumerate(annotations.measurements, 1):
        pieces = lengths(measurement.points) if measurement.kind == "line" else []
        for j, point in enumerate(measurement.points):
            where = [f"{value * factor:.{places}f}" for value in point]
            scene = [f"{value:.{places}f}" for value in words.in_scene(point)]
            last = j == len(measurement.points) - 1
            length = f"{pieces[j - 1] * factor:.{places}f}" if pieces and j else ""
            total = f"{sum(pieces) * factor:.{places}f}" if pieces and last else ""
            turn = f"{angle(measurement.points):.4f}" if measurement.kind == "angle" and j == 1 else ""
            table.writerow([i, measurement.kind, j + 1, *where, *scene, length, total, turn, annotations.scale.unit])
    return text.getvalue()
