"""The ruler: points on the scene's surfaces, lengths between them, angles, and the scale that gives them a unit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import dist
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from console import UserError
from console.atomic import write_file
from viewer.app.annotations import LEAST_POINTS, MOST_ANNOTATIONS, MOST_POINTS, SCALES, Measurement, Point, Scale, Unit
from viewer.app.measured import Words, as_csv, as_text
from viewer.app.pose import triple
from viewer.app.surface import Hit, surface_at

if TYPE_CHECKING:
    from viewer.app.application import App

Tool = Literal["", "point", "line", "angle", "scale"]
TOOLS: tuple[Tool, ...] = get_args(Tool)
PAGE = "measure"


@dataclass
class Measuring:
    """tool: what a click in the picture places; "" leaves it to the camera. draft: points placed so far.

    selected: index of a measurement. shown: measurements stay in the picture while their page is closed. known, known_unit:
    the length that the scale is set by, as it is being typed. cursor: what is under the mouse; None for nothing.
    """

    tool: Tool = ""
    draft: tuple[Point, ...] = ()
    selected: int | None = None
    shown: bool = False
    known: float = 1.0
    known_unit: Unit = "m"
    cursor: Hit | None = None
    _looked: tuple[object, ...] = ()

    def drop(self) -> None:
        """Another scene is shown."""
        self.tool, self.draft, self.selected, self.cursor, self._looked = "", (), None, None, ()

    # Looking

    def look_at(self, app: App, x: float, y: float) -> Hit | None:
        """What is under a point of the viewport (window units from its corner), found once for each place and view."""
        camera = app.viewport.camera
        if app.scene is None or camera is None:
            return None
        scale, settings = app.viewport.pixels_per_unit, app.settings
        view = (
            camera.grid_T_camera.tobytes(),
            camera.fx,
            camera.width,
            camera.orthographic,
            camera.height,
            settings.crop,
            settings.near,
            settings.surroundings,
        )
        key = (id(app.scene.pack), x, y, scale, *view)
        if key != self._looked:
            self._looked = key
            self.cursor = surface_at(app.scene.pack, camera, settings, x * scale, y * scale)
        return self.cursor

    def look_away(self) -> None:
        """The mouse is elsewhere."""
        self.cursor, self._looked = None, ()

    # Placing

    def choose(self, app: App, tool: Tool) -> None:
        """Takes another tool; a draft of the last one is dropped."""
        if app.scene is None:
            return
        if self.draft:
            app.scene.rig.remember()
        self.tool, self.draft = tool, ()
        app.touch()

    def toggle(self, app: App) -> None:
        """Takes the ruler, with its page, or puts it away."""
        self.choose(app, "" if self.tool else "line")
        if self.tool:
            app.interface.opens(PAGE)

    def click(self, app: App, x: float, y: float) -> None:
        """Places a point on the surface under a point of the viewport, if there is one."""
        hit = self.look_at(app, x, y)
        if not self.tool or app.scene is None:
            return
        if hit is None:
            app.messages.say("There is no surface under the cursor")
        else:
            self._place(app, triple(hit.point))

    def click_point(self, app: App, index: int, point: int) -> None:
        """Places a point exactly where one of a measurement is; without a tool, selects that measurement."""
        if self.tool:
            self._place(app, app.annotations.current.measurements[index].points[point])
        else:
            self.selected = index
            app.touch()

    def _place(self, app: App, point: Point) -> None:
        if app.scene is None or self.draft[-1:] == (point,):  # a double click
            return
        if self.tool == "scale" and len(self.draft) == 2:
            self.draft = ()  # two others
        if len(self.draft) >= MOST_POINTS:
            return
        app.scene.rig.remember()
        self.draft = (*self.draft, point)
        if self.tool in ("point", "angle") and len(self.draft) == LEAST_POINTS[self.tool]:
            self._keep(app)
        app.touch()

    def finish(self, app: App) -> bool:
        """Ends the line that is being drawn; False where there is none yet."""
        if self.tool != "line" or len(self.draft) < 2 or app.scene is None:
            return False
        app.scene.rig.remember()
        self._keep(app)
        app.touch()
        return True

    def _keep(self, app: App) -> None:
        """Makes the draft a measurement, in the same step to be undone as its last point."""
        annotations = app.annotations.current
        if self.tool in ("point", "line", "angle") and len(annotations.measurements) < MOST_ANNOTATIONS:
            self.selected = len(annotations.measurements)
            app.annotations.current = annotations.with_measurement(self.selected, Measurement(self.tool, self.draft))
        self.draft = ()

    def back(self, app: App) -> None:
        """Takes the last point back; without a draft, removes the measurement that is selected."""
        if app.scene is None:
            return
        if self.draft:
            app.scene.rig.remember()
            self.draft = self.draft[:-1]
            app.touch()
        elif self.selected is not None:
            self.remove(app, self.selected)

    def escape(self, app: App) -> bool:
        """Drops the draft; without one, puts the tool away. False where there was neither."""
        if not self.tool:
            return False
        self.choose(app, self.tool if self.draft else "")
        return True

    # What is there already

    def move_point(self, app: App, index: int, point: int, x: float, y: float) -> None:
        """Puts a point of a measurement on the surface under a point of the viewport; remember() beforehand."""
        hit, annotations = self.look_at(app, x, y), app.annotations.current
        if hit is None or not 0 <= index < len(annotations.measurements):
            return
        moved = list(annotations.measurements[index].points)
        moved[point] = triple(hit.point)
        app.annotations.current = annotations.with_measurement(
            index, replace(annotations.measurements[index], points=tuple(moved))
        )
        app.touch()

    def remove(self, app: App, index: int) -> None:
        """Takes a measurement away."""
        annotations = app.annotations.current
        if 0 <= index < len(annotations.measurements):
            app.annotations.change(app, annotations.with_measurement(index, None))
        self.selected = None

    def clear(self, app: App) -> None:
        """Takes all of them away."""
        app.annotations.change(app, replace(app.annotations.current, measurements=()))
        self.selected = None

    # The scale

    def set_scale(self, app: App) -> None:
        """Says how far apart the two points of the draft are: `known`, in `known_unit`."""
        if len(self.draft) != 2 or app.scene is None:
            return
        between = dist(*self.draft)
        factor = self.known / between if between > 0 else 0.0
        if not SCALES[0] <= factor <= SCALES[1]:
            raise UserError("no scale follows from these points", expected="two places and a length above 0")
        self._use(app, Scale(factor, self.known_unit))
        self.tool, self.draft = "line", ()
        app.messages.say(f"1 grid unit is {factor:.6g} {self.known_unit}".rstrip())

    def show_in(self, app: App, unit: Unit) -> None:
        """Shows lengths in another unit."""
        self._use(app, app.annotations.current.scale.shown_in(unit))

    def forget_scale(self, app: App) -> None:
        """Back to grid units."""
        self._use(app, Scale())

    @staticmethod
    def _use(app: App, scale: Scale) -> None:
        app.annotations.change(app, replace(app.annotations.current, scale=scale))

    # Out of the window

    def words(self, app: App) -> Words | None:
        """How lengths of the open pack are told."""
        return None if app.scene is None else Words(app.scene.pack, app.annotations.current.scale)

    def copy(self, app: App) -> None:
        """Puts all measurements on the clipboard, as text."""
        annotations = app.annotations.current
        if app.scene is not None and annotations.measurements:
            app.clipboard.set(as_text(app.scene.pack, annotations))
            count = len(annotations.measurements)
            app.messages.say(f"{count} measurement{'s' * (count > 1)} on the clipboard")

    def save_table(self, app: App, file: Path) -> None:
        """Writes all measurements as CSV. OSError where it cannot."""
        if app.scene is not None:
            write_file(file, as_csv(app.scene.pack, app.annotations.current))
            app.messages.say(f"Saved {file}")
