"""Placement of the open scene: what is up, which way it is turned, and where its origin is (scenepack.placement)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from console import UserError
from scenepack.placement import Placement, ground_plane
from viewer.core.annotations import Point

if TYPE_CHECKING:
    from viewer.app.application import App

PAGE = "move"
FLATTEST = 0.03  # of three points that tell a plane: the area of their triangle, in squares of its longest side


def put(app: App, placement: Placement) -> None:
    """Places the scene; the camera stays where it is in it, and is levelled. Its undo history remembers the moment before."""
    app.annotations.current = replace(app.annotations.current, placement=placement)
    app.open_scene.rig.place(placement.rotation)
    app.touch()


def change(app: App, placement: Placement) -> None:
    """Places the scene in one step that can be undone."""
    if placement != app.annotations.current.placement:
        app.open_scene.rig.remember()
        put(app, placement)


def by_points(app: App, points: tuple[Point, ...]) -> Placement:
    """With three points of the ground level, at height 0, and the side that the camera sees upwards.

    UserError where they tell no plane.
    """
    camera = app.viewport.camera
    a, b, c = (np.asarray(point) for point in points)
    normal = np.cross(b - a, c - a)
    longest = max(float((side**2).sum()) for side in (b - a, c - b, a - c))
    if camera is None or np.linalg.norm(normal) <= FLATTEST * longest:
        raise UserError("these points lie in a line", expected="three points of the ground, apart from each other")
    seen = camera.grid_T_camera[:3, 2] if camera.orthographic else camera.position - (a + b + c) / 3
    return app.annotations.current.placement.levelled(normal * np.copysign(1.0, normal @ seen), a)


def find_ground(app: App) -> None:
    """Levels the plane that most of the ground lies in. UserError where there is none."""
    before = app.annotations.current.placement
    at, up = ground_plane(app.open_scene.pack, before.up)
    change(app, before.levelled(up, at))
    app.messages.say("The ground is level")
