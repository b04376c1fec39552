"""Poses of the camera: turntable, text, projection of points, and undo.

Notation: pivot, the point looked at; azimuth and elevation (degrees) of the camera as seen from the pivot; distance
from it. At azimuth 0 and elevation 0 the camera stands on the `front` axis. Everything is in the pack's grid frame.
With up = y, azimuth 0 looks from +z and azimuth 90 from +x. The axes are those of the placed frame (scenepack.placement).

An entry of the history holds camera, crop and marks, so that moves and cuts are taken back in the order in which they were made.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import asin, atan2, degrees
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from console.json_text import parse_json
from scenepack.placement import NOT_TURNED, Rows, transformed, triple
from training.scenes.lens import image_of
from viewer.rendering.camera import ViewCamera, rays_through

# right, up and front of each choice of the up axis; front = right × up
UP_AXES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "y": ((1, 0, 0), (0, 1, 0)), "z": ((1, 0, 0), (0, 0, 1)), "x": ((0, 1, 0), (1, 0, 0)),
    "-y": ((1, 0, 0), (0, -1, 0)), "-z": ((1, 0, 0), (0, 0, -1)), "-x": ((0, 1, 0), (-1, 0, 0)),
}  # fmt: skip
MAX_ELEVATION = 90.0
STEEP = 89.95  # elevation beyond which a camera's back says nothing of its azimuth
FARTHEST = 1e12  # from the origin, in grid units
POSSIBLE_FOVS = (1.0, 170.0)  # of a camera from a file or a text: vertical, degrees


@dataclass(frozen=True)
class Turntable:
    """The frame that azimuth and elevation are counted in."""

    up: str = "y"  # a key of UP_AXES
    mirrored: bool = False  # the grid frame is a mirror image of the world, as in forward-facing packs
    placed: Rows = NOT_TURNED  # placed_R_grid: axes of the placed frame, which `up` names, in the grid frame

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """right, up, front: float64 [3] each, grid frame."""
        right, up = np.asarray(UP_AXES[self.up], np.float64) @ np.array(self.placed)
        return right, up, np.cross(right, up)

    def rotation(self, azimuth: float, elevation: float) -> np.ndarray:
        """grid_R_camera, float64 [3, 3]: columns right, up, back of a level camera; angles in degrees."""
        turn = Rotation.from_euler("YX", [azimuth, -elevation], degrees=True).as_matrix()
        level = np.stack(self.axes, axis=1) @ turn
        return level * [-1.0 if self.mirrored else 1.0, 1.0, 1.0]

    def angles(self, back: np.ndarray) -> tuple[float, float]:
        """Azimuth and elevation (degrees) of a camera whose back axis is `back` (float [3], any length)."""
        right0, up0, front0 = self.axes
        back = np.asarray(back, np.float64) / np.linalg.norm(back)
        elevation = degrees(asin(float(np.clip(back @ up0, -1.0, 1.0))))
        return degrees(atan2(float(back @ right0), float(back @ front0))), elevation


@dataclass(frozen=True)
class Pose:
    """A camera on the turntable; see the module's notation. pivot: grid frame; distance: grid units, above 0."""

    pivot: tuple[float, float, float] = (0.0, 0.0, 0.0)
    azimuth: float = 0.0
    elevation: float = 0.0
    distance: float = 1.0

    def rotation(self, table: Turntable) -> np.ndarray:
        """grid_R_camera, float64 [3, 3]."""
        return table.rotation(self.azimuth, self.elevation)

    def eye(self, table: Turntable) -> np.ndarray:
        """Position of the camera, float64 [3], grid frame."""
        return np.asarray(self.pivot) + self.distance * self.rotation(table)[:, 2]

    def matrix(self, table: Turntable) -> np.ndarray:
        """grid_T_camera, float64 [4, 4]."""
        grid_T_camera = np.eye(4)
        grid_T_camera[:3, :3] = self.rotation(table)
        grid_T_camera[:3, 3] = self.eye(table)
        return grid_T_camera

    def aimed(self, azimuth: float, elevation: float) -> Pose:
        """This pose with other angles (degrees); the elevation is clipped to ±MAX_ELEVATION."""
        return replace(self, azimuth=azimuth, elevation=float(np.clip(elevation, -MAX_ELEVATION, MAX_ELEVATION)))

    def seen_from(self, eye: np.ndarray, table: Turntable) -> Pose:
        """The same angles and distance with the camera at `eye` (float [3]); the pivot moves along."""
        pivot = np.asarray(eye, np.float64) - self.distance * self.rotation(table)[:, 2]
        return replace(self, pivot=triple(pivot))

    @classmethod
    def from_matrix(cls, grid_T_camera: np.ndarray, distance: float, table: Turntable) -> Pose:
        """The level pose nearest to a camera; roll is lost. distance: to the point it shall turn about."""
        azimuth, elevation = table.angles(grid_T_camera[:3, 2])
        if abs(elevation) > STEEP:  # the picture's upper edge tells where it would stand
            azimuth, _ = table.angles(-np.sign(elevation) * grid_T_camera[:3, 1])
        return cls(distance=distance).aimed(azimuth, elevation).seen_from(grid_T_camera[:3, 3], table)


def shortest_turn(degrees_from: float, degrees_to: float) -> float:
    """Degrees in -180 … 180 that lead from one azimuth to the other."""
    return (degrees_to - degrees_from + 180.0) % 360.0 - 180.0


def pose_to_text(grid_T_camera: np.ndarray, fov: float, ortho_height: float | None = None) -> str:
    """A pose as one line of JSON: eye, target (one unit ahead), up, all in the grid frame, and fov (vertical degrees).

    ortho_height: of an orthographic view, grid units from the top of the picture to the bottom.
    """
    eye, back, up = grid_T_camera[:3, 3], grid_T_camera[:3, 2], grid_T_camera[:3, 1]
    values = {"eye": eye, "target": eye - back, "up": up}
    rounded = {name: [round(float(v), 6) for v in vector] for name, vector in values.items()}
    parallel = {} if ortho_height is None else {"ortho_height": float(f"{ortho_height:.9g}")}
    return json.dumps({**rounded, "fov": round(fov, 4), **parallel})


def pose_from_text(text: str) -> tuple[np.ndarray, float | None, float | None]:
    """grid_T_camera (float64 [4, 4], not mirrored), fov and ortho_height of a pose written by pose_to_text.

    `up` may be missing (y). Also taken: six bare numbers, eye and target. ValueError, in plain words, for the rest, but for an
    ortho_height that makes no sense, which is passed over.
    """
    try:
        values = parse_json(text)
    except ValueError:
        values = text.replace(";", " ").replace(",", " ").split()
    try:
        found: dict[str, Any] = values if isinstance(values, dict) else {"eye": values[:3], "target": values[3:]}
        vectors = found["eye"], found["target"], found.get("up", (0.0, 1.0, 0.0))
        eye, target, up = (np.asarray(vector, np.float64) for vector in vectors)
        if any(v.shape != (3,) or not (np.abs(v) <= FARTHEST).all() for v in (eye, target, up)):
            raise ValueError
        camera = ViewCamera.look_at(eye, target, up)
        fov = None if found.get("fov") is None else float(found["fov"])
        if fov is not None and not POSSIBLE_FOVS[0] <= fov <= POSSIBLE_FOVS[1]:
            raise ValueError
        given = found.get("ortho_height")
        height = float(given) if isinstance(given, int | float) and 0 < given < FARTHEST else None
    except (KeyError, TypeError, ValueError):
        raise ValueError(
            'this is not a pose: expected {"eye": [x, y, z], "target": [x, y, z]} with "up" and "fov" if wanted, '
            "or six numbers x,y,z,x,y,z"
        ) from None
    return camera.grid_T_camera, fov, height


def fitted(camera: ViewCamera, size: tuple[int, int]) -> ViewCamera:
    """A photograph's camera, lens included, for another picture size: the whole photograph fits, centred."""
    width, height = size
    scale = min(width / camera.width, height / camera.height)
    cx = 0.5 * width + scale * (camera.cx - 0.5 * camera.width)
    cy = 0.5 * height + scale * (camera.cy - 0.5 * camera.height)
    lens = {"fx": camera.fx * scale, "fy": camera.fy * scale, "cx": cx, "cy": cy}
    return replace(camera, width=width, height=height, **lens)


# --- From the grid frame to the picture: points, frusta, boxes, and dragging along an axis ---

# Pairs of the corners that box_points (viewer.rendering.camera) and frustum_points return
BOX_EDGES = tuple((a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1)
FRUSTUM_EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1))


def project(camera: ViewCamera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (float [n, 2]) of points (float [n, 3], grid frame), and whether the camera can see each (bool [n])."""
    local = transformed(np.linalg.inv(camera.grid_T_camera), points)
    if camera.orthographic:
        a, b, before = local[:, 0], -local[:, 1], local[:, 2] < -1e-6
    else:
        a, b, before = image_of(local, camera.distortion)
    return np.stack([camera.cx + camera.fx * a, camera.cy + camera.fy * b], axis=1), before


def frustum_points(camera: ViewCamera, depth: float) -> np.ndarray:
    """float64 [5, 3]: a camera's eye and the corners of its picture at `depth` (grid units) ahead; see FRUSTUM_EDGES."""
    corners = [(0, 0), (camera.width, 0), (camera.width, camera.height), (0, camera.height)]
    rays = rays_through(camera, np.asarray(corners, np.float64))
    return transformed(camera.grid_T_camera, np.vstack([np.zeros(3), depth * rays]))


def along_axis(camera: ViewCamera, at: np.ndarray, axis: int, moved: tuple[float, float]) -> float:
    """How far (grid units) a point at `at` moves along an axis when it is dragged by `moved` pixels."""
    unit = np.zeros(3)
    unit[axis] = 1e-3 * max(float(np.linalg.norm(at - camera.position)), 1e-6)
    pixels, before = project(camera, np.stack([at, at + unit]))
    direction = (pixels[1] - pixels[0]) / unit[axis]
    length = float(direction @ direction)
    if not before.all() or length < 1e-6:
        return 0.0
    return float(np.asarray(moved) @ direction) / length


# --- One history of what can be undone: where the camera was, and what was cut off ---

DEPTH = 100

Moment = tuple[Any, ...]  # one value for each part


class History:
    """Moments to come back to. parts: each reads a value (compared by ==) and puts it back."""

    def __init__(self) -> None:
        self._parts: list[tuple[Callable[[], Any], Callable[[Any], None]]] = []
        self._undo: list[Moment] = []
        self._redo: list[Moment] = []

    def follow(self, read: Callable[[], Any], restore: Callable[[Any], None]) -> None:
        """Has another part remembered; call before the first moment is."""
        self._parts.append((read, restore))

    def remember(self) -> None:
        """Marks this moment as one to come back to; call before each gesture."""
        now = self._now()
        if not self._undo or self._undo[-1] != now:
            self._undo = [*self._undo[1 - DEPTH :], now]
        self._redo = []

    def undo(self) -> bool:
        """Back to before the last gesture; False where there is none."""
        return self._swap(self._undo, self._redo)

    def redo(self) -> bool:
        """Forward again; False where there is nothing."""
        return self._swap(self._redo, self._undo)

    @property
    def empty(self) -> bool:
        return not self._undo

    def _now(self) -> Moment:
        return tuple(read() for read, _ in self._parts)

    def _swap(self, take: list[Moment], give: list[Moment]) -> bool:
        now = self._now()
        while take and take[-1] == now:
            take.pop()
        if not take:
            return False
        give.append(now)
        for (_, restore), value in zip(self._parts, take.pop(), strict=True):
            restore(value)
        return True
