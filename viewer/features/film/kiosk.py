"""Kiosk: a scene that shows itself, full screen and without panels, and waits while somebody moves the camera."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from viewer.features.film.camera_path import CameraPath, Keyframe
from viewer.rendering.camera import forward_facing_path

if TYPE_CHECKING:
    from viewer.app.application import App

IDLE_S = 60.0  # without a movement of the camera, before it begins again
TURN_S = 40.0  # of a turntable
LEG_S = 8.0  # from one bookmark to the next
SWAY_KEYS = 8  # of a forward-facing scene
COMMANDS = ("home", "frame", "escape", "full-screen", "quit")  # that keys still run


@dataclass
class Kiosk:
    """began: the path of the scene is known. moved_at: when the camera moved last, seconds of the monotonic clock."""

    began: bool = False
    tour: bool = False  # it leads through the bookmarks
    moved_at: float = 0.0
    _goal: object = None

    def tick(self, app: App) -> None:
        """Plays the path once the scene is there, and again IDLE_S after somebody moved the camera the last time."""
        if app.scene is None or not app.scene.whole:
            return
        filming, now = app.filming, time.monotonic()
        if not self.began:
            self.began = True
            filming.path, filming.time = self._path(app), 0.0
            filming.play(app)
        elif filming.playing or app.scene.rig.goal != self._goal:
            self.moved_at, self._goal = now, app.scene.rig.goal
            if filming.playing and self.tour:
                app.bookmarks.selected = round(filming.time / LEG_S) % len(filming.path.keyframes)
        elif now - self.moved_at > IDLE_S:
            filming.time = 0.0
            filming.play(app)

    def _path(self, app: App) -> CameraPath:
        """The camera path that was loaded, or one through the bookmarks, or a turn; without an end."""
        filming, scene = app.filming, app.open_scene
        if len(filming.path.keyframes) > 1:
            keys = filming.path.keyframes
        elif len(app.annotations.current.bookmarks) > 1:
            self.tour = True
            keys = [replace(key, seconds=LEG_S) for key in app.bookmarks.keyframes(app)]
        elif scene.rig.bounded:
            cameras = forward_facing_path(scene.pack, SWAY_KEYS)
            keys = [Keyframe(camera.grid_T_camera, app.fov, TURN_S / SWAY_KEYS) for camera in cameras]
        else:
            filming.turntable(app)
            turn = filming.path.keyframes
            keys = [replace(key, seconds=TURN_S / len(turn)) for key in turn]
        return CameraPath(keys, closed=True)
