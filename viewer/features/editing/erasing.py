"""Erasing: what is selected of the open pack, by tools in the picture and by rules; taking it away, and saving what is left.

The pack on disk does not change. scenepack.editing shows the edits in the atlas in memory, some macroblocks each frame.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from PIL import Image, ImageDraw

from console import UserError
from scenepack.editing import NOTHING, EditPreview, Parts, Selection, Voxels
from viewer.core.files import FileRequest
from viewer.core.log import Dialog
from viewer.core.pose import project
from viewer.core.state import Edits, OpenScene
from viewer.core.tasks import Task
from viewer.features.export.exporting import check_is_on_disk
from viewer.features.measuring.surface import Hit, depth_of, surface_under
from viewer.rendering.camera import ViewCamera
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.settings import RenderSettings

if TYPE_CHECKING:
    from viewer.app.application import App

Tool = Literal["", "brush", "lasso", "sphere"]
TOOLS: dict[Tool, str] = {"brush": "Brush", "lasso": "Lasso", "sphere": "Sphere"}
RULES = {
    "parts": "All but the largest part",
    "small": "Small parts",
    "faint": "Faint voxels",
    "inside": "Inside the crop box",
    "outside": "Outside the crop box",
}
PAGE = "erase"
WORK_S = 0.025  # of each frame, for strokes, and for the atlas and its way to the GPU
DRAWN_EVERY_S = 0.3  # while much goes to the GPU
UPLOADED = 4  # macroblocks at once
DAB_STEP = 0.4  # of the brush's radius, between two dabs of a stroke
RADII = (1.0, 60.0)  # of the brush, voxels
SIZES = (2, 100_000)  # of parts, voxels
FAINTEST = (0.004, 0.5)  # opacity

Choose = Callable[[Voxels, Edits], Selection]  # of the voxels that are left, with what is selected now
CHANGES: dict[str, tuple[str, Choose]] = {
    "invert": ("Invert the selection", lambda voxels, edits: voxels.everything() - edits.selected),
    "grow": ("Grow the selection", lambda voxels, edits: voxels.grown(edits.selected)),
    "shrink": ("Shrink the selection", lambda voxels, edits: voxels.shrunk(edits.selected)),
    "clear": ("Select nothing", lambda voxels, edits: NOTHING),
}


@dataclass
class Erasing:
    tool: Tool = ""
    adds: bool = True  # to what is selected; False: takes away from it
    through: bool = False  # the lasso takes what is hidden, too
    radius: float = 6.0  # of the brush, voxels
    smaller_than: int = 100  # voxels of a part
    fainter_than: float = 0.03  # opacity
    cursor: Hit | None = None  # the surface under the mouse, for the brush; the middle of the sphere that is drawn
    reach: float = 0.0  # radius of that sphere, window units
    outline: list[tuple[float, float]] = field(default_factory=list)  # of the lasso that is drawn, window units
    _stroke: tuple[float, float] | None = None  # where the brush painted last
    _subtracts: bool = False  # the stroke of this moment
    _dabs: deque[tuple[float, float]] = field(default_factory=deque)
    _wanted: tuple[Choose, bool] | None = None  # gives all that is selected; and whether that is a step to be undone
    _working: tuple[bool, Edits, Task[Selection]] | None = None  # the latter, what was selected, and the thread
    _parts: tuple[Selection, Parts] | None = None  # of what was left when this had been removed
    _base: Selection | None = None  # what was selected before the slider of a rule was taken
    _drawn: float = 0.0  # when the picture was drawn anew

    def of_another_scene(self) -> Erasing:
        """What stays when another scene is shown."""
        settings = ("adds", "through", "radius", "smaller_than", "fainter_than")
        return Erasing(**{name: getattr(self, name) for name in settings})

    @property
    def choosing(self) -> bool:
        """Whether a thread is choosing voxels, or shall."""
        return self._working is not None or self._wanted is not None

    def busy(self, app: App) -> bool:
        """Whether more will be selected or shown without anything being done."""
        preview = app.scene.preview if app.scene is not None else None
        return self.choosing or bool(self._dabs) or (preview is not None and not preview.settled)

    # Tools

    def toggle(self, app: App) -> None:
        """Opens the page with the brush, or puts the tool away. UserError where the scene cannot be changed."""
        self.choose(app, "" if self.tool else "brush")
        if self.tool:
            app.interface.opens(PAGE)

    def choose(self, app: App, tool: Tool) -> None:
        if tool:
            _preview(app)
            app.measure_tool.choose(app, "")
        self.tool, self.cursor, self.outline, self._stroke = tool, None, [], None
        app.touch()

    def escape(self, app: App) -> bool:
        """Puts the tool away, or what it is drawing; False where there was neither."""
        if not self.tool:
            return False
        self.choose(app, self.tool if self.outline else "")
        return True

    def press(self, app: App, x: float, y: float, *, subtracts: bool) -> None:
        """The left button goes down at a point of the viewport. subtracts: whatever `adds` says."""
        if self.choosing:
            app.messages.say("Still selecting…")
            return
        sides = app.comparison.sides(app)
        if sides is not None and app.comparison.shows_other_pack(app, x):
            app.messages.say("{} is edited, not {}".format(*sides))
            return
        self._subtracts = subtracts or not self.adds
        if self.tool == "brush":
            self._stroke = (x, y)
            self._dabs.append((x, y))
        elif self.tool == "lasso":
            self.outline = [(x, y)]
        else:
            self.cursor, self.reach, self._stroke = surface_under(app, x, y), 0.0, (x, y)
        app.touch()

    def drag(self, app: App, x: float, y: float) -> None:
        if self.tool == "lasso" and self.outline:
            self.outline.append((x, y))
        elif self.tool == "sphere" and self._stroke is not None:
            self.reach = hypot(x - self._stroke[0], y - self._stroke[1])
        elif self.tool == "brush" and self._stroke is not None:
            (x0, y0), hit = self._stroke, self.cursor
            step = 6.0 if hit is None else max(DAB_STEP * self.radius * self.units_per_voxel(app, hit), 3.0)
            count = int(hypot(x - x0, y - y0) / step)
            self._dabs += [(x0 + (x - x0) * i / count, y0 + (y - y0) * i / count) for i in range(1, count + 1)]
            if count:
                self._stroke = (x, y)
        app.touch()

    def release(self, app: App) -> None:
        """The button goes up: lasso and sphere select."""
        outline, self.outline, stroke, self._stroke = self.outline, [], self._stroke, None
        if self.tool == "lasso" and len(outline) > 2:
            self._select_within(app, np.array(outline) * app.viewport.pixels_per_unit)
        elif self.tool == "sphere" and stroke is not None and self.cursor is not None and self.reach > 0:
            hit, radius = self.cursor, self.reach / self.units_per_voxel(app, self.cursor)
            self.reach = 0.0
            self._combine(app, lambda voxels, _: voxels.in_ball(hit.position, radius))
        app.touch()

    def _select_within(self, app: App, outline: np.ndarray) -> None:
        """outline: pixels, float [m, 2]. Only the part of the picture around it is looked at."""
        camera, settings, scale = app.viewport.camera, app.settings, app.resolution.moving_scale
        assert camera is not None
        corners = np.floor([outline.min(axis=0), outline.max(axis=0)])
        x, y, right, foot = np.clip(corners, 0, (camera.width - 1, camera.height - 1)).astype(int).ravel().tolist()
        part = camera.part(x, y, right - x + 1, foot - y + 1)
        depth = None
        if not self.through and app.canvas is not None:
            size = max(1, round(scale * part.width)), max(1, round(scale * part.height))
            depth = app.canvas.depth(part.resized(*size), settings)
        self._combine(app, lambda voxels, _: seen_within(voxels, part, settings, outline - (x, y), depth))

    @staticmethod
    def units_per_voxel(app: App, hit: Hit) -> float:
        """How large a voxel is seen at a surface, window units."""
        camera, preview = app.viewport.camera, _preview(app)
        assert camera is not None
        size = float(preview.voxels.frame.sizes(hit.position[None])[0, :2].max())
        pixels = camera.fx * size / (1.0 if camera.orthographic else max(depth_of(camera, hit.point), 1e-9))
        return max(pixels / app.viewport.pixels_per_unit, 1e-6)

    # Rules

    def select(self, app: App, rule: str) -> None:
        crop = app.settings.crop
        if rule in ("inside", "outside") and crop is None:
            raise UserError("there is no crop box", remedy="switch it on, on the Crop page")
        limit, alpha = self.smaller_than, self.fainter_than
        rules: dict[str, Choose] = {
            "parts": lambda voxels, edits: self._parts_of(voxels, edits).smaller_than(),
            "small": lambda voxels, edits: self._parts_of(voxels, edits).smaller_than(limit),
            "faint": lambda voxels, _: voxels.fainter_than(alpha),
        }
        if crop is not None:
            rules["inside"] = lambda voxels, _: voxels.in_box(crop)
            rules["outside"] = lambda voxels, _: voxels.everything() - voxels.in_box(crop)
        self._subtracts = not self.adds
        self._combine(app, rules[rule], self._base)

    def _parts_of(self, voxels: Voxels, edits: Edits) -> Parts:
        """Found once for what is left."""
        if self._parts is None or self._parts[0] is not edits.removed:
            self._parts = edits.removed, voxels.parts()
        return self._parts[1]

    def hold(self, app: App) -> None:
        """A slider of a rule is taken: until it is let go of, each choice takes the place of the one before."""
        app.open_scene.rig.remember()
        self._base = app.open_scene.edits.selected

    def let_go(self) -> None:
        self._base = None

    def change(self, app: App, how: str) -> None:
        self._begin(app, CHANGES[how][1])

    def _combine(self, app: App, choose: Choose, base: Selection | None = None) -> None:
        """Adds what is chosen to `base`, or to what is selected (None), or takes it away."""
        subtracts = self._subtracts

        def combined(voxels: Voxels, edits: Edits) -> Selection:
            found, start = choose(voxels, edits), edits.selected if base is None else base
            return start - found if subtracts else start | found

        self._begin(app, combined, undoable=base is None)

    def _begin(self, app: App, choose: Choose, *, undoable: bool = True) -> None:
        """Has a thread choose all that is selected."""
        _preview(app)
        self._wanted = choose, undoable
        app.touch()

    # What is selected

    def erase(self, app: App) -> bool:
        """Takes away what is selected; False where that is nothing."""
        scene = app.open_scene
        edits = scene.edits
        if not edits.selected.bits:
            return False
        scene.rig.remember()
        scene.edits = Edits(edits.removed | edits.selected, NOTHING)
        app.touch()
        return True

    def tick(self, app: App) -> None:
        """Time passes: paints strokes, takes what a thread has chosen, and brings the atlas and the GPU up to date."""
        scene = app.scene
        if scene is None or scene.preview is None:
            return
        self._paint(app, scene)
        self._take(app, scene)
        if scene.preview.settled and self._working is None and self._wanted is not None:
            (choose, undoable), self._wanted = self._wanted, None
            self._working = undoable, scene.edits, Task(partial(choose, scene.preview.voxels, scene.edits))
        self._show(app, scene.preview, scene.edits)

    def _paint(self, app: App, scene: OpenScene) -> None:
        end, selected = time.perf_counter() + WORK_S, scene.edits.selected
        while self._dabs and time.perf_counter() < end:
            self.cursor = surface_under(app, *self._dabs.popleft())
            if self.cursor is not None:
                dab = _preview(app).voxels.in_ball(self.cursor.position, self.radius)
                selected = selected - dab if self._subtracts else selected | dab
        if selected is not scene.edits.selected:
            scene.edits = replace(scene.edits, selected=selected)
            app.touch()

    def _take(self, app: App, scene: OpenScene) -> None:
        if self._working is None or not self._working[2].finished:
            return
        (undoable, before, task), self._working = self._working, None
        app.touch()
        try:
            found = task.result()
        except Exception as error:  # a dialog, and the program goes on
            app.messages.fail("Nothing was selected", error)
            return
        if scene.edits is before:  # else something was undone meanwhile
            if undoable:
                scene.rig.remember()
            scene.edits = replace(before, selected=found)

    def _show(self, app: App, preview: EditPreview, edits: Edits) -> None:
        if preview.settled and not preview.differs(edits.removed, edits.selected):
            return
        end = time.perf_counter() + WORK_S
        preview.follow(edits.removed, edits.selected, WORK_S)
        while time.perf_counter() < end and (some := preview.take(UPLOADED)):
            redraw = preview.settled or time.monotonic() - self._drawn > DRAWN_EVERY_S
            if app.canvas is not None:
                app.canvas.rewrite(some, redraw=redraw)
            if redraw:
                self._drawn = time.monotonic()
                app.touch(1)

    # Saving

    @staticmethod
    def ask_to_leave(app: App, scenes: list[OpenScene], command: str) -> bool:
        """Asks before what was erased from these scenes and is saved nowhere is lost; False where there is no such thing.

        command: the id of what happens if it may be lost.
        """
        names = [scene.name for scene in scenes if scene.unsaved]
        if names and not app.messages.dialogs:
            title = f"What you erased from {', '.join(names)} is not saved"
            text = "The Erase page saves what is left as a new pack."
            app.messages.dialogs.append(Dialog(title, text, (("Keep it", ""), ("Discard it", command))))
            app.touch()
        return bool(names)

    def ask_where_to_save(self, app: App) -> None:
        """Asks for the new pack. UserError where nothing was erased."""
        scene = app.open_scene
        if not scene.edits.removed.bits:
            raise UserError("nothing was erased", remedy="select something and press Delete")
        name = f"{scene.name}-edited" + (".zip" if scene.path.suffix.lower() == ".zip" else "")
        here, then = scene.path.resolve().parent, partial(self.save, app)
        app.file_request = FileRequest("Save the edited scene", "save", then, (), name, here)

    def save(self, app: App, path: Path) -> None:
        """Begins to write what is left as the pack `path`, in a process. UserError where it cannot be started."""
        scene = app.scene
        if scene is None:
            return
        removed, rig = scene.edits.removed, scene.rig

        def words(folder: Path) -> list[str]:
            removed.save(folder / "voxels.npz")
            source = str(scene.path.resolve())
            return ["edit", source, "--out", str(path.absolute()), "--voxels", str(folder / "voxels.npz")]

        def saved() -> None:
            scene.saved = removed
            if app.scene is scene and scene.edits.removed is removed:
                app.open(path, then=lambda: app.open_scene.rig.stand_as(rig))

        app.exporting.write(app, path, words, saved)


def _preview(app: App) -> EditPreview:
    """Of the open scene, begun if there is none. UserError where it cannot be edited."""
    scene = app.open_scene
    if scene.preview is None:
        check_is_on_disk(scene, "open a pack, then erase parts of it")
        pack, canvas = scene.pack, app.canvas
        if not scene.whole or not scene.stays or (canvas is not None and canvas.refines):
            raise UserError("is not complete yet", where=scene.name, remedy="wait for it")
        if canvas is not None and canvas.renderer is not None and canvas.renderer.pack is not pack:
            what = "does not fit on the graphics card, so that its voxels cannot be shown one by one"
            raise UserError(what, where=scene.name, remedy="use snerg-pack edit")
        used = pack.atlas_indices[pack.occupied]
        if len(np.unique(used, axis=0)) < len(used):
            raise UserError("has macroblocks that share their voxels", where=scene.name, remedy="use snerg-pack edit")
        scene.preview = EditPreview(Voxels(pack))
    return scene.preview


# --- Voxels within an outline that is drawn over the picture: only what shows there, or all behind it as well ---

REACH = 2.0  # voxels behind the mean depth of a pixel that still show in it


def seen_within(
    voxels: Voxels, camera: ViewCamera, settings: RenderSettings, outline: np.ndarray, depth: np.ndarray | None
) -> Selection:
    """Voxels that are seen within `outline` (pixels, float [m, 2], of the camera's picture) and are not cut off.

    depth: of the picture, float [h, w]: only voxels that show there. None: those behind them as well.
    """
    width, height = camera.width, camera.height
    image = Image.new("1", (width, height))
    ImageDraw.Draw(image).polygon(outline.ravel().tolist(), fill=1)
    inside = np.asarray(image)
    low, high = RayFrame(voxels.pack).box(settings)
    near = max(camera.near, settings.near)

    def test(positions: np.ndarray) -> np.ndarray:
        points = voxels.frame.points(positions)
        pixels, before = project(camera, points)
        column, row = np.floor(pixels).T
        held = before & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        held &= np.all((positions >= low) & (positions <= high), axis=1)
        some = np.flatnonzero(held)
        column, row = column[some].astype(int), row[some].astype(int)
        away = (camera.position - points[some]) @ camera.grid_T_camera[:3, 2]
        chosen = inside[row, column] & (away >= near)
        if depth is not None:
            h, w = depth.shape
            shown = depth[row * h // height, column * w // width]
            reach = REACH * voxels.frame.sizes(positions[some]).max(axis=1)
            chosen &= (shown > 0) & (away <= shown + reach)
        held[some] = chosen
        return held

    return voxels.where(test, _may_be_seen(voxels, camera))


def _may_be_seen(voxels: Voxels, camera: ViewCamera) -> np.ndarray | None:
    """bool [n]: macroblocks that reach into the pyramid of a camera's rays; None, for all, where a lens bends the rays."""
    if any(camera.distortion):
        return None
    left, right = ((end - camera.cx) / camera.fx for end in (0, camera.width))
    top, foot = ((camera.cy - end) / camera.fy for end in (0, camera.height))
    if camera.orthographic:
        planes = [(1, 0, 0, -left), (-1, 0, 0, right), (0, 1, 0, -foot), (0, -1, 0, top)]
    else:
        planes = [(1, 0, left, 0), (-1, 0, -right, 0), (0, 1, foot, 0), (0, -1, -top, 0)]
    inwards = np.array([*planes, (0, 0, -1, 0)], float) @ np.linalg.inv(camera.grid_T_camera)
    first, last = voxels.boxes
    centre, half = 0.5 * (first + last), 0.5 * (last - first)
    return np.all(centre @ inwards[:, :3].T + half @ np.abs(inwards[:, :3]).T + inwards[:, 3] >= 0, axis=1)
