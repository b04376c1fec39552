"""Measure tool: points on surfaces, lengths and angles between them, the scale; and their text and table (CSV).

Points on surfaces also tell where the scene is placed: three of the ground, or one that is the origin.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import acos, ceil, degrees, dist, log10
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from console import UserError
from console.atomic import write_file
from scenepack.pack import Pack
from scenepack.placement import SCALES, transformed
from viewer.core.annotations import MOST_ANNOTATIONS, MOST_POINTS, Annotations, Measurement, Point, Scale, Unit
from viewer.core.files import FileRequest
from viewer.core.pose import triple
from viewer.features.measuring.surface import Hit, surface_under
from viewer.features.placing import placing

if TYPE_CHECKING:
    from viewer.app.application import App


MOST_DECIMALS = 6
WARPED_DECIMALS = 3  # in forward-facing packs, whose voxels are not of one size
COLUMNS = (
    "measurement", "kind", "point", "x", "y", "z", "scene_x", "scene_y", "scene_z", "length", "total", "angle_degrees", "unit",
)  # fmt: skip


def lengths(points: tuple[Point, ...]) -> list[float]:
    """Length of each segment of a polyline, grid units."""
    return [dist(a, b) for a, b in pairwise(points)]


def angle(points: tuple[Point, ...]) -> float:
    """Angle at the second of three points, degrees; 0 where two points are the same."""
    a, b, c = np.asarray(points, np.float64)
    one, two = a - b, c - b
    size = np.linalg.norm(one) * np.linalg.norm(two)
    return degrees(acos(np.clip(one @ two / size, -1.0, 1.0))) if size > 0 else 0.0


class LengthFormat:
    """Formats lengths and points of one pack, with decimals down to half a voxel. Points are in the placed frame."""

    def __init__(self, pack: Pack, annotations: Annotations) -> None:
        self.pack, self.scale = pack, annotations.scale
        self._placed_T_grid = annotations.placed_T_grid
        error = 0.5 * pack.voxel_size * self.scale.factor
        needed = WARPED_DECIMALS if pack.ndc else ceil(-log10(error))
        self.decimals = min(max(needed, 0), MOST_DECIMALS)

    def number(self, grid_units: float) -> str:
        return f"{grid_units * self.scale.factor:.{self.decimals}f}"

    def length(self, grid_units: float) -> str:
        return f"{self.number(grid_units)} {self.scale.unit}".rstrip()

    def placed(self, point: Point | np.ndarray) -> Point:
        """A point of the grid frame in the placed frame."""
        return triple(transformed(self._placed_T_grid, np.asarray(point)))

    def place(self, point: Point | np.ndarray) -> str:
        return "  ".join(f"{value:z.{self.decimals}f}" for value in self.placed(point))

    def in_scene(self, point: Point) -> Point:
        """The same place in the frame of the scene's own cameras, unscaled."""
        return triple(transformed(self.pack.worldspace_T_opengl, np.asarray(point, np.float64)))

    def measurement(self, measurement: Measurement) -> str:
        if measurement.kind == "point":
            return self.place(measurement.points[0])
        if measurement.kind == "angle":
            return f"{angle(measurement.points):.1f}°"
        pieces = lengths(measurement.points)
        parts = f" = {' + '.join(self.number(piece) for piece in pieces)}" if len(pieces) > 1 else ""
        return self.length(sum(pieces)) + parts


def as_text(pack: Pack, annotations: Annotations) -> str:
    """All measurements, a line each; for the clipboard."""
    words = LengthFormat(pack, annotations)
    return "\n".join(f"{m.kind} {i}: {words.measurement(m)}" for i, m in enumerate(annotations.measurements, 1))


def as_csv(pack: Pack, annotations: Annotations) -> str:
    """A table with a row for each point: x, y, z in the placed frame and lengths in `unit`; scene_* in the training frame."""
    words, text = LengthFormat(pack, annotations), io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for i, measurement in enumerate(annotations.measurements, 1):
        pieces = [piece * annotations.scale.factor for piece in lengths(measurement.points)]
        is_line = measurement.kind == "line"
        for j, point in enumerate(measurement.points):
            place = [f"{value:z.{MOST_DECIMALS}f}" for value in (*words.placed(point), *words.in_scene(point))]
            length = f"{pieces[j - 1]:.{MOST_DECIMALS}f}" if is_line and j else ""
            total = f"{sum(pieces):.{MOST_DECIMALS}f}" if is_line and j == len(pieces) else ""
            turn = f"{angle(measurement.points):.4f}" if measurement.kind == "angle" and j == 1 else ""
            table.writerow([i, measurement.kind, j + 1, *place, length, total, turn, annotations.scale.unit])
    return text.getvalue()


Tool = Literal["", "point", "line", "angle", "scale", "ground", "origin", "place", "focus"]
ENDS = {"point": 1, "angle": 3, "ground": 3, "origin": 1, "place": 1, "focus": 1}  # points after which the tool is done
UNMARKED = ("", "place", "focus")  # tools whose points are not drawn: of an annotated place, and of what is in focus
PAGE = "measure"


@dataclass
class MeasureTool:
    tool: Tool = ""  # what a click places; "" leaves clicks to the camera
    draft: tuple[Point, ...] = ()  # points placed so far
    selected: int | None = None  # index of a measurement
    shown: bool = False  # whether measurements stay in the picture while their page is closed
    known: float = 1.0  # the length that the scale is set by, as it is typed
    known_unit: Unit = "m"
    asks: bool = False  # that length's field gets the keyboard in the next frame
    cursor: Hit | None = None  # the surface under the mouse; None for no surface

    def drop(self) -> None:
        """Forgets everything, because another scene is shown."""
        self.tool, self.draft, self.selected, self.cursor = "", (), None, None

    # Placing

    def choose(self, app: App, tool: Tool) -> None:
        """Changes the tool and drops the draft of the last one."""
        if self.draft:
            app.open_scene.rig.remember()
        self.tool, self.draft = tool, ()
        if tool:
            app.erasing.tool = ""

    def toggle(self, app: App) -> None:
        """Starts measuring and opens the page, or stops."""
        self.choose(app, "line" if self.tool in UNMARKED else "")
        if self.tool:
            app.interface.opens(PAGE)

    def click(self, app: App, x: float, y: float) -> None:
        """Places a point on the surface under a point of the viewport (window units from its corner), if there is one."""
        self.cursor = surface_under(app, x, y)
        if self.cursor is not None:
            self._place(app, triple(self.cursor.point))
        else:
            app.messages.say("There is no surface under the cursor")

    def click_point(self, app: App, index: int, point: int) -> None:
        """Places a point exactly where one of a measurement is; without a tool, selects that measurement."""
        measurements = app.annotations.current.measurements
        if index >= len(measurements):  # it was undone meanwhile
            return
        if self.tool:
            self._place(app, measurements[index].points[point])
        else:
            self.selected = index

    def _place(self, app: App, point: Point) -> None:
        if self.draft[-1:] == (point,):  # a double click
            return
        if self.tool == "scale" and len(self.draft) == 2:
            self.draft = ()  # two others
        if len(self.draft) >= MOST_POINTS:
            return
        app.open_scene.rig.remember()
        self.draft = (*self.draft, point)
        self.asks = self.tool == "scale" and len(self.draft) == 2
        if len(self.draft) == ENDS.get(self.tool):
            self._keep(app)

    def finish(self, app: App) -> bool:
        """Ends the line that is being drawn; False where there is none yet."""
        if self.tool != "line" or len(self.draft) < 2:
            return False
        app.open_scene.rig.remember()
        self._keep(app)
        return True

    def _keep(self, app: App) -> None:
        """Makes the draft what the tool is for, such as a measurement; undone in one step with its last point."""
        annotations, draft = app.annotations.current, self.draft
        if self.tool in ("ground", "origin"):
            self._place_scene(app)
        elif self.tool == "place":
            self.tool, self.draft = "", ()
            app.bookmarks.add(app, draft[0])
        elif self.tool == "focus":
            self.tool, app.filming.focus = "", draft[0]
            away = dist(draft[0], app.open_scene.rig.matrix[:3, 3])
            app.messages.say(f"In focus: {self.length_format(app).length(away)} away")
        elif self.tool in ("point", "line", "angle") and len(annotations.measurements) < MOST_ANNOTATIONS:
            self.selected = len(annotations.measurements)
            app.annotations.current = annotations.with_measurement(self.selected, Measurement(self.tool, draft))
        self.draft = ()

    def _place_scene(self, app: App) -> None:
        """By the draft: three points of the ground, or the origin."""
        try:
            ground, origin = self.tool == "ground", replace(app.annotations.current.placement, origin=self.draft[0])
            placing.put(app, placing.by_points(app, self.draft) if ground else origin)
        except UserError as error:
            app.messages.say(str(error), "warning")
            return
        app.messages.say("The ground is level" if ground else "The origin is there")
        self.tool = ""

    def back(self, app: App) -> None:
        """Takes the last point back; without a draft, removes the measurement that is selected."""
        if self.draft:
            app.open_scene.rig.remember()
            self.draft = self.draft[:-1]
        elif self.selected is not None:
            app.annotations.change(app, app.annotations.current.with_measurement(self.selected, None))
            self.selected = None

    def escape(self, app: App) -> bool:
        """Drops the draft; without one, puts the tool away. False where there was neither."""
        if not self.tool:
            return False
        self.choose(app, self.tool if self.draft else "")
        return True

    # What is there already

    def move_point(self, app: App, index: int, point: int, x: float, y: float) -> None:
        """Puts a point of a measurement on the surface under a point of the viewport; remember() beforehand."""
        self.cursor, annotations = surface_under(app, x, y), app.annotations.current
        if self.cursor is None or index >= len(annotations.measurements):  # it was undone meanwhile
            return
        before = annotations.measurements[index]
        points = (*before.points[:point], triple(self.cursor.point), *before.points[point + 1 :])
        app.annotations.current = annotations.with_measurement(index, replace(before, points=points))

    def clear(self, app: App) -> None:
        app.annotations.change(app, replace(app.annotations.current, measurements=()))
        self.selected = None

    # The scale

    def set_scale(self, app: App) -> None:
        """Says how far apart the two points of the draft are: `known`, in `known_unit`."""
        if len(self.draft) != 2:
            return
        between = dist(*self.draft)
        factor = self.known / between if between > 0 else 0.0
        if not SCALES[0] <= factor <= SCALES[1]:
            raise UserError("no scale follows from these points", expected="two places and a length above 0")
        app.annotations.change(app, replace(app.annotations.current, scale=Scale(factor, self.known_unit)))
        self.tool, self.draft = "line" if app.interface.shows(PAGE) else "", ()
        app.messages.say(f"1 grid unit is {factor:.6g} {self.known_unit}".rstrip())

    # Out of the window

    @staticmethod
    def length_format(app: App) -> LengthFormat:
        return LengthFormat(app.open_scene.pack, app.annotations.current)

    def copy(self, app: App) -> None:
        annotations = app.annotations.current
        if annotations.measurements:
            count = len(annotations.measurements)
            what = "1 measurement is" if count == 1 else f"{count} measurements are"
            app.copy(as_text(app.open_scene.pack, annotations), f"{what} on the clipboard")

    def ask_for_table(self, app: App) -> None:
        then, name = partial(self.save_table, app), f"{app.open_scene.name}-measurements.csv"
        app.file_request = FileRequest("Save the measurements", "save", then, (".csv",), name)

    def save_table(self, app: App, file: Path) -> None:
        """Writes all measurements as CSV. OSError where it cannot."""
        if app.scene is not None:
            write_file(file, as_csv(app.scene.pack, app.annotations.current))
            app.messages.say(f"Saved {file}")
