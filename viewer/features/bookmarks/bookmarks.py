"""Bookmarks, and the small pictures that show them and keyframes."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from console import UserError
from viewer.core.annotations import MOST_ANNOTATIONS, Bookmark, named
from viewer.core.pose import MAX_ELEVATION, Pose, Turntable, triple, view_camera
from viewer.features.camera.orbit_camera import FOVS, OrbitCamera
from viewer.features.film.camera_path import CameraPath, Keyframe
from viewer.rendering.canvas import Canvas
from viewer.rendering.settings import RenderSettings

if TYPE_CHECKING:
    from viewer.app.application import App


def bookmark_of(rig: OrbitCamera, fov: float, name: str) -> Bookmark:
    """The present view of a rig. fov: vertical, degrees. A photograph's camera is taken level, and without its lens."""
    pose = rig.shown
    if rig.held is not None:
        held = rig.held.grid_T_camera
        pose = Pose.from_matrix(held, pose.distance, rig.table)
    low, high = FOVS
    return Bookmark(name, triple(pose.eye(rig.table)), pose.pivot, rig.table.up, min(max(fov, low), high))


def pose_of(bookmark: Bookmark, table: Turntable) -> Pose:
    azimuth, elevation = table.angles(np.subtract(bookmark.eye, bookmark.target))
    elevation = min(max(elevation, -MAX_ELEVATION), MAX_ELEVATION)
    return Pose(bookmark.target, azimuth, elevation, math.dist(bookmark.eye, bookmark.target))


@dataclass
class Bookmarks:
    """selected: index of the one chosen last, also once the camera has moved. naming: the name being typed for it."""

    selected: int | None = None
    naming: str = ""

    def drop(self) -> None:
        self.selected, self.naming = None, ""

    def add(self, app: App) -> None:
        """Saves the present view, behind the selected one."""
        annotations = app.annotations.current
        if app.scene is None or len(annotations.bookmarks) >= MOST_ANNOTATIONS:
            return
        at = len(annotations.bookmarks) if self.selected is None else min(self.selected + 1, len(annotations.bookmarks))
        view = bookmark_of(app.scene.rig, app.fov, _free_name(annotations.bookmarks))
        added = (*annotations.bookmarks[:at], view, *annotations.bookmarks[at:])
        app.annotations.change(app, replace(annotations, bookmarks=added))
        self.selected = at
        app.messages.say(f"Bookmarked as “{view.name}”")

    def go(self, app: App, index: int) -> None:
        if app.scene is None or not 0 <= index < len(app.annotations.current.bookmarks):
            return
        view, rig = app.annotations.current.bookmarks[index], app.scene.rig
        rig.remember()
        self.selected = index
        if view.up != rig.table.up:
            rig.set_up(view.up)
        rig.go(pose_of(view, rig.table), remember=False)
        rig.fov = min(max(view.fov, FOVS[0]), FOVS[1])
        app.touch()

    def step(self, app: App, by: int) -> None:
        """Flies to the next saved view, or to the previous one, cyclically."""
        count = len(app.annotations.current.bookmarks)
        if not count:
            app.messages.say("There are no bookmarks yet: Ctrl+D saves this view")
            return
        first = 0 if by > 0 else -1
        self.go(app, (first if self.selected is None else self.selected + by) % count)
        assert self.selected is not None
        app.messages.say(app.annotations.current.bookmarks[self.selected].name)

    def give_name(self, app: App, index: int, name: str) -> None:
        annotations = app.annotations.current
        view = replace(annotations.bookmarks[index], name=named(name))
        app.annotations.change(app, annotations.with_bookmark(index, view))

    def update(self, app: App, index: int) -> None:
        """Puts a saved view where the camera is now."""
        annotations = app.annotations.current
        if app.scene is not None:
            view = bookmark_of(app.scene.rig, app.fov, annotations.bookmarks[index].name)
            app.annotations.change(app, annotations.with_bookmark(index, view))

    def move(self, app: App, index: int, by: int) -> None:
        """Moves a view earlier (-1) or later (1)."""
        to = min(max(index + by, 0), len(app.annotations.current.bookmarks) - 1)
        app.annotations.change(app, app.annotations.current.with_bookmark_moved(index, to))
        self.selected = to

    def remove(self, app: App, index: int) -> None:
        app.annotations.change(app, app.annotations.current.with_bookmark(index, None))
        left = len(app.annotations.current.bookmarks)
        self.selected = min(index, left - 1) if left else None

    def keyframes(self, app: App) -> list[Keyframe]:
        """The saved views, in their order."""
        assert app.scene is not None
        keys = []
        for view in app.annotations.current.bookmarks:
            table = replace(app.scene.rig.table, up=view.up)
            keys.append(Keyframe(pose_of(view, table).matrix(table), view.fov))
        return keys

    def film(self, app: App) -> None:
        """Makes the saved views, in their order, the keyframes of the camera path."""
        if app.scene is None:
            return
        if len(app.annotations.current.bookmarks) < 2:
            raise UserError("a film needs two views", remedy="bookmark some: Ctrl+D")
        filming, keys = app.filming, self.keyframes(app)
        filming.path, filming.selected, filming.time, filming.playing = CameraPath(keys), None, 0.0, False
        app.interface.opens("film")
        app.messages.say(f"A film of {filming.path.duration:.0f} seconds through {len(keys)} views")
        app.touch()


def _free_name(bookmarks: tuple[Bookmark, ...]) -> str:
    taken = {bookmark.name for bookmark in bookmarks}
    return next(name for name in (f"View {i}" for i in range(1, len(bookmarks) + 2)) if name not in taken)


# --- View pictures ---

SIZE = (144, 90)  # width, height, pixels
MOST_KEPT = 200  # 38 KiB each, and as much on the GPU
Key = tuple[bytes, float]


@dataclass
class ViewPictures:
    """pictures: uint8 [90, 144, 3] by view, least recently used first."""

    _pictures: OrderedDict[Key, np.ndarray] = field(default_factory=OrderedDict)
    _drawn_with: tuple[object, ...] = ()
    _drew: bool = False  # in this frame

    def clear(self, canvas: Canvas | None) -> None:
        """Forgets the pictures, because another pack is shown."""
        for key in self._pictures:
            if canvas is not None:
                canvas.drop_image(_name(key))
        self._pictures.clear()

    def tick(self, app: App) -> None:
        """A new frame. Another background, or a finer pack, is another picture."""
        self._drew = False
        pack = app.scene.pack if app.scene is not None else None
        now = (id(pack), app.settings.background)
        if now != self._drawn_with:
            self._drawn_with = now
            self.clear(app.canvas)

    def texture(self, app: App, canvas: Canvas, grid_T_camera: np.ndarray, fov: float) -> int | None:
        """OpenGL name of the picture of a view (float64 [4, 4]; vertical degrees); None while it is not drawn yet.

        One is drawn in a frame at most, and none while the picture is not whole: that goes before.
        """
        if app.scene is None:
            return None
        key = (np.round(grid_T_camera, 6).tobytes(), round(fov, 4))
        if key not in self._pictures:
            if self._drew or canvas.pending or not app.scene.whole:
                app.touch(1)
                return None
            self._drew = True
            camera = view_camera(grid_T_camera, fov, SIZE)
            self._pictures[key] = canvas.snapshot(camera, RenderSettings(background=app.settings.background))
            if len(self._pictures) > MOST_KEPT:
                canvas.drop_image(_name(self._pictures.popitem(last=False)[0]))
            app.touch(2)
        self._pictures.move_to_end(key)
        return canvas.image(_name(key), self._pictures[key])


def _name(key: Key) -> str:
    return f"view {key[0].hex()} {key[1]}"
