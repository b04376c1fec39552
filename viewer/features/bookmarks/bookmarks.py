"""Bookmarks; the places in the scene that some of them annotate, and their labels in saved pictures; small pictures of views."""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from console import UserError
from console.streams import one_line
from scenepack.pack import Pack
from viewer.core.annotations import MOST_ANNOTATIONS, Annotations, Bookmark, Point
from viewer.core.pose import Pose, Turntable, project, triple
from viewer.features.camera.orbit_camera import FOVS, OrbitCamera
from viewer.features.film.camera_path import CameraPath, Keyframe
from viewer.features.measuring.surface import surface_at
from viewer.rendering.camera import ViewCamera, ray_through
from viewer.rendering.canvas import Canvas
from viewer.rendering.settings import RenderSettings

if TYPE_CHECKING:
    from viewer.app.application import App


def bookmark_of(rig: OrbitCamera, name: str) -> Bookmark:
    """The present view of a rig. A photograph's camera is taken level, and without its lens."""
    pose = rig.shown
    if rig.held is not None:
        pose = Pose.from_matrix(rig.held.grid_T_camera, pose.distance, rig.table)
    fov = min(max(rig.seen_fov, FOVS[0]), FOVS[1])
    return Bookmark(name, triple(pose.eye(rig.table)), pose.pivot, rig.table.up, fov)


def pose_of(bookmark: Bookmark, table: Turntable) -> Pose:
    angles = table.angles(np.subtract(bookmark.eye, bookmark.target))
    return Pose(bookmark.target, *angles, math.dist(bookmark.eye, bookmark.target))


T = TypeVar("T")
Rearranging = Literal["up", "down", "update", "remove"]  # a view of a list


def rearranged(views: Sequence[T], how: Rearranging, index: int, here: T) -> tuple[list[T], int | None]:
    """Other views: one of them earlier, later, `here` instead, or gone; and the index of what is chosen then."""
    others = [*views[:index], *views[index + 1 :]]
    to = min(max(index + {"up": -1, "down": 1}.get(how, 0), 0), len(others))
    if how != "remove":
        others.insert(to, here if how == "update" else views[index])
    return others, min(to, len(others) - 1) if others else None


COVERED_S, PAUSE_S = 0.004, 0.05  # for finding out which places are covered, and before that is done again
TOLERANCE = 4.0, 0.02  # by which something lies before a place that it covers: voxels, and of the place's distance


def _is_covered(pack: Pack, camera: ViewCamera, settings: RenderSettings, point: Point) -> bool:
    """Whether something else hides a place in the picture of a camera."""
    x, y = project(camera, np.array([point]))[0][0]
    hit = surface_at(pack, camera, settings, x, y)
    before = 0.0 if hit is None else float((np.asarray(point) - hit.point) @ ray_through(camera, x, y)[1])
    voxels, share = TOLERANCE
    return before > max(voxels * pack.voxel_size, share * math.dist(point, camera.position))


@dataclass
class Bookmarks:
    """selected: index of the one chosen last, also once the camera has moved."""

    selected: int | None = None
    shown: bool = True  # places are marked in the picture
    _looked: dict[Point, tuple[float, object, bool]] = field(default_factory=dict)  # when, in which view, if covered

    def drop(self) -> None:
        self.selected, self._looked = None, {}

    def annotate(self, app: App) -> None:
        """Starts or stops waiting for a click on the place to annotate."""
        app.measure_tool.choose(app, "" if app.measure_tool.tool == "place" else "place")
        if app.measure_tool.tool:
            app.interface.opens("bookmarks")
            app.messages.say("Click on the place to annotate")

    def covered(self, app: App) -> set[Point]:
        """The places that something else hides in the picture; what takes too long for one frame is found in the next."""
        pack, camera, settings = app.open_scene.pack, app.viewport.camera, app.settings
        assert camera is not None
        view = id(pack), camera.key, settings.crop, settings.near, settings.surroundings  # what surface_at depends on
        points = {view.point for view in app.annotations.current.bookmarks if view.point is not None}
        self._looked = {point: self._looked.get(point, (0.0, None, False)) for point in points}
        stale = [point for point, found in self._looked.items() if found[1] != view]
        now = time.monotonic()
        if stale:
            app.touch(2)  # this frame and the next
        if now - max((found[0] for found in self._looked.values()), default=0.0) < PAUSE_S:
            stale = []
        for point in sorted(stale, key=lambda point: self._looked[point][0]):
            self._looked[point] = time.monotonic(), view, _is_covered(pack, camera, settings, point)
            if time.monotonic() > now + COVERED_S:
                break
        return {point for point, (_, _, hidden) in self._looked.items() if hidden}

    def add(self, app: App, point: Point | None = None) -> None:
        """Saves the present view, of a place to annotate where there is one, behind the selected one."""
        views = list(app.annotations.current.bookmarks)
        if len(views) >= MOST_ANNOTATIONS:
            return
        at = len(views) if self.selected is None else min(self.selected + 1, len(views))
        kind, taken = "View" if point is None else "Place", {view.name for view in views}
        name = next(name for name in (f"{kind} {i}" for i in range(at + 1, at + len(views) + 2)) if name not in taken)
        view = replace(bookmark_of(app.open_scene.rig, name), point=point)
        views.insert(at, view)
        self._change(app, views, at)
        app.messages.say(f"Bookmarked as “{view.name}”")

    def go(self, app: App, index: int) -> None:
        if not 0 <= index < len(app.annotations.current.bookmarks):
            return
        view, rig = app.annotations.current.bookmarks[index], app.open_scene.rig
        rig.remember()
        self.selected = index
        if view.up != rig.table.up:
            rig.set_up(view.up)
        rig.go(pose_of(view, rig.table))
        rig.fov = min(max(view.fov, FOVS[0]), FOVS[1])
        app.touch()

    def step(self, app: App, by: int) -> None:
        """Flies to the next saved view, or to the previous one, cyclically."""
        views = app.annotations.current.bookmarks
        if not views:
            app.messages.say("There are no bookmarks yet: Ctrl+D saves this view")
            return
        first = 0 if by > 0 else -1
        index = (first if self.selected is None else self.selected + by) % len(views)
        self.go(app, index)
        app.messages.say(views[index].name)

    def edit(self, app: App, index: int, **fields: Any) -> None:
        views = list(app.annotations.current.bookmarks)
        views[index] = replace(views[index], **fields)
        self._change(app, views, self.selected)

    def rearrange(self, app: App, how: Rearranging, index: int) -> None:
        views, now = app.annotations.current.bookmarks, bookmark_of(app.open_scene.rig, "")
        here = replace(views[index], eye=now.eye, target=now.target, up=now.up, fov=now.fov)
        self._change(app, *rearranged(views, how, index, here))

    def _change(self, app: App, views: list[Bookmark], selected: int | None) -> None:
        """Takes other bookmarks, in one step that can be undone."""
        app.annotations.change(app, replace(app.annotations.current, bookmarks=tuple(views)))
        self.selected = selected

    def keyframes(self, app: App) -> list[Keyframe]:
        table, views = app.open_scene.rig.table, app.annotations.current.bookmarks
        turned = [(view, replace(table, up=view.up)) for view in views]
        return [Keyframe(pose_of(view, table).matrix(table), view.fov) for view, table in turned]

    def film(self, app: App) -> None:
        if len(app.annotations.current.bookmarks) < 2:
            raise UserError("a film needs two views", remedy="bookmark some: Ctrl+D")
        app.filming.use(CameraPath(self.keyframes(app)))
        app.interface.opens("film")
        path = app.filming.path
        app.messages.say(f"A film of {path.duration:.0f} seconds through {len(path.keyframes)} views")


# --- View pictures ---

SIZE = (144, 90)  # width, height, pixels
MOST_KEPT = 200  # 38 KiB each, and as much on the GPU


@dataclass
class ViewPictures:
    """pictures: uint8 [90, 144, 3] by view."""

    _pictures: dict[str, np.ndarray] = field(default_factory=dict)
    _drawn_with: tuple[object, ...] = ()
    _drew: bool = False  # in this frame

    def tick(self, app: App) -> None:
        """A new frame. Another background, or a finer pack, is another picture; too many begin anew."""
        self._drew = False
        now = (id(app.scene.pack) if app.scene else None, app.settings.background)
        if now != self._drawn_with or len(self._pictures) > MOST_KEPT:
            self._drawn_with = now
            while self._pictures:
                name, _ = self._pictures.popitem()
                if app.canvas is not None:
                    app.canvas.drop_image(name)

    def texture(self, app: App, canvas: Canvas, grid_T_camera: np.ndarray, fov: float) -> int | None:
        """OpenGL name of the picture of a view (float64 [4, 4]; vertical degrees); None while it is not drawn yet.

        One is drawn in a frame at most, and none while the picture is not whole: that goes before.
        """
        name = f"view {np.round(grid_T_camera, 6).tobytes().hex()} {round(fov, 4)}"
        if name not in self._pictures:
            if self._drew or canvas.pending or not app.open_scene.whole:
                app.touch(1)
                return None
            self._drew = True
            camera = ViewCamera.posed(grid_T_camera, fov, SIZE)
            self._pictures[name] = canvas.snapshot(camera, RenderSettings(background=app.settings.background))
            app.touch(2)
        return canvas.image(name, self._pictures[name])


# --- Labels in saved pictures and films: a number at each annotated place that is seen, and its title beside it ---

SIDE, LEAST = 0.045, 16.0  # a disc's diameter, of the picture's lesser side; pixels
SMOOTH = 4  # labels are drawn so many times larger
DISC, CHIP, RIM, TEXT = (26, 33, 44, 255), (13, 17, 23, 225), (69, 208, 189, 255), (230, 235, 242, 255)
WIDEST = 0.4  # a title, of the picture's width


def with_places(
    picture: np.ndarray, camera: ViewCamera, pack: Pack, settings: RenderSettings, annotations: Annotations
) -> np.ndarray:
    """The picture of a camera, uint8 [h, w, 3], with the places that nothing covers."""
    marked = [(i, view.name, view.point) for i, view in enumerate(annotations.bookmarks, 1) if view.point is not None]
    if not marked:
        return picture
    pixels, ahead = project(camera, np.array([point for *_, point in marked]))
    height, width = picture.shape[:2]
    size = round(max(SIDE * min(height, width), LEAST))
    image = Image.fromarray(picture)
    for (number, name, point), (x, y), before in zip(marked, pixels, ahead, strict=True):
        if not before or not (0 <= x < width and 0 <= y < height) or _is_covered(pack, camera, settings, point):
            continue
        label = _label(number, one_line(name, 60), size, round(WIDEST * width), left=bool(x > 0.6 * width))
        corner = round(x - label.width + 0.5 * size) if x > 0.6 * width else round(x - 0.5 * size)
        image.paste(label, (corner, round(y - 0.5 * size)), label)
    return np.asarray(image)


@lru_cache(maxsize=256)
def _label(number: int, title: str, size: int, widest: int, *, left: bool) -> Image.Image:
    """A disc of `size` pixels with a number, and a title at its right, or at its left."""
    big, font = SMOOTH * size, _font(round(0.56 * SMOOTH * size), title)
    while title and font.getlength(title) > SMOOTH * widest:
        title = title[:-2].rstrip() + "…" if len(title) > 2 else ""
    wide = big + (round(font.getlength(title) + 0.75 * big) if title else 0)
    image = Image.new("RGBA", (wide, big), (0, 0, 0, 0))
    draw = ImageDraw.Draw(image)
    disc = wide - big if left else 0
    if title:
        draw.rounded_rectangle((0, 0.06 * big, wide - 1, 0.94 * big), 0.44 * big, CHIP)
        start = 0.4 * big if left else 1.25 * big
        draw.text((start, 0.5 * big), title, TEXT, font, "lm")
    draw.ellipse((disc, 0, disc + big - 1, big - 1), RIM)
    rim = 0.07 * big
    draw.ellipse((disc + rim, rim, disc + big - 1 - rim, big - 1 - rim), DISC)
    draw.text((disc + 0.5 * big, 0.5 * big), str(number), TEXT, _font(round(0.56 * big), str(number)), "mm")
    return image.resize((max(wide // SMOOTH, 1), size), Image.Resampling.BOX)


@lru_cache(maxsize=64)
def _font(size: int, text: str) -> ImageFont.FreeTypeFont:
    """The interface's font, or one of the system's where that lacks letters of the text."""
    spec = importlib.util.find_spec("imgui_bundle")
    assert spec is not None and spec.origin is not None
    own = ImageFont.truetype(str(Path(spec.origin).parent / "assets" / "fonts" / "Roboto" / "Roboto-Regular.ttf"), size)
    missing = "".join(sorted({letter for letter in text if _is_box(own, letter)}))
    if missing:
        from viewer.core.theme import load_fonts

        for found in load_fonts(missing):
            other = ImageFont.truetype(str(found.path), size, found.number)
            if not any(_is_box(other, letter) for letter in text):
                return other
    return own


def _is_box(font: ImageFont.FreeTypeFont, letter: str) -> bool:
    """Whether a font draws a letter as it draws those it does not have."""
    drawn, box = (bytes(font.getmask(each)) for each in (letter, "\U0010ffff"))  # pyright: ignore[reportArgumentType]
    return not letter.isspace() and drawn == box
