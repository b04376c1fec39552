"""Placement of a scene: the placed frame, in which people use it, and the ground, which it may be placed on.

Notation: the placed frame has y up. A point p of the grid frame lies at placed = factor R (p - origin) in it. R is
placed_R_grid: its rows are the placed frame's axes in the grid frame. factor: placed units per grid unit, the scale of the pack's
marks (docs/format.md, "Additional keys"). A pack that nobody has moved has the grid frame for its placed frame.

The ground is the plane that much of what is seen from above lies in, with nearly all of the rest higher. Planes through three
random points of the surface are tried (RANSAC), and the best one is fitted to all points that lie in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, radians, sin
from typing import Any, Literal, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from console import UserError
from scenepack.blocks import block_copy
from scenepack.pack import MOST_LENGTH, Pack, number_array, number_in

Triple = tuple[float, float, float]
Rows = tuple[Triple, Triple, Triple]

MARKS = "marks"  # in the pack's "snerg" object: what the viewer's user keeps with the scene
SCALES = (1e-12, 1e12)  # placed units per grid unit
Unit = Literal["", "m", "cm", "mm", "in", "ft"]  # "" while it is unknown
UNITS: tuple[Unit, ...] = get_args(Unit)
NOT_TURNED: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
# Of R Rᵀ from the identity: a stored matrix with a larger error is refused; one with a smaller error is not corrected
SKEWED, ROUNDED = 1e-3, 1e-12


@dataclass(frozen=True)
class Placement:
    """rotation: R, rows. origin: the point of the grid frame where the placed frame begins."""

    rotation: Rows = NOT_TURNED
    origin: Triple = (0.0, 0.0, 0.0)

    @property
    def up(self) -> np.ndarray:
        """What is up, float64 [3], grid frame."""
        return np.array(self.rotation[1])

    @property
    def angles(self) -> Triple:
        """Turn about the placed y axis, tilt about x and roll about z, degrees; R is their product in this order."""
        turn, tilt, roll = Rotation.from_matrix(np.array(self.rotation)).as_euler("YXZ", degrees=True)
        return float(turn), float(tilt), float(roll)

    def with_angles(self, turn: float, tilt: float, roll: float) -> Placement:
        """The same origin, and the rotation that has these angles, degrees."""
        return Placement(_rows(Rotation.from_euler("YXZ", [turn, tilt, roll], degrees=True).as_matrix()), self.origin)

    def levelled(self, up: np.ndarray, through: np.ndarray | None = None) -> Placement:
        """Turned as little as possible, so that `up` (float [3], grid frame, any length) is up.

        through: a point of the ground, float [3], grid frame; the origin moves along `up` to its height.
        """
        up = np.asarray(up, np.float64) / np.linalg.norm(up)
        before = np.array(self.rotation)
        turned = Rotation.align_vectors([0.0, 1.0, 0.0], before @ up)[0].as_matrix() @ before
        origin = np.array(self.origin)
        if through is not None:
            origin = origin - ((origin - through) @ up) * up
        return Placement(_rows(turned), triple(origin))

    def matrix(self, factor: float = 1.0) -> np.ndarray:
        """placed_T_grid, float64 [4, 4]."""
        placed_T_grid = np.eye(4)
        placed_T_grid[:3, :3] = factor * np.array(self.rotation)
        placed_T_grid[:3, 3] = -placed_T_grid[:3, :3] @ np.array(self.origin)
        return placed_T_grid


NOT_MOVED = Placement()


def triple(vector: np.ndarray) -> Triple:
    """float [3] as a hashable tuple of Python floats."""
    x, y, z = (float(v) + 0.0 for v in vector)  # no -0.0
    return x, y, z


def _rows(rotation: np.ndarray) -> Rows:
    """The rotation closest to a matrix [3, 3]."""
    left, _, right = np.linalg.svd(rotation)
    a, b, c = np.round(left @ right, 15)
    return triple(a), triple(b), triple(c)


def placement_to_json(placement: Placement) -> dict[str, Any]:
    return {"rotation": [list(row) for row in placement.rotation], "origin": list(placement.origin)}


def placement_from_json(value: Any) -> Placement:
    """ValueError, in words, for what is none."""
    entries = value if isinstance(value, Mapping) else {"rotation": None}
    rotation = _array(entries.get("rotation", NOT_TURNED), (3, 3), "a placement's rotation: expected 3 × 3 numbers")
    origin = _array(entries.get("origin", (0.0, 0.0, 0.0)), (3,), "a placement's origin: expected three numbers")
    skew = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if skew > SKEWED or np.linalg.det(rotation) < 0:
        raise ValueError("a placement's rotation: expected a rotation")
    x, y, z = rotation if skew < ROUNDED else np.array(_rows(rotation))
    return Placement((triple(x), triple(y), triple(z)), triple(origin))


def _array(value: Any, shape: tuple[int, ...], expected: str) -> np.ndarray:
    array = number_array(value)
    if array is None or array.shape != shape or not (np.abs(array) <= MOST_LENGTH).all():
        raise ValueError(expected)
    return array


def placement_of(pack: Pack) -> Placement:
    """Of the pack's own marks; where they say none, or nonsense, that of a pack that nobody has moved."""
    marks = pack.metadata.get(MARKS)
    try:
        found = placement_from_json(marks.get("placement", {})) if isinstance(marks, Mapping) else NOT_MOVED
    except ValueError:
        return NOT_MOVED
    return allowed(found, pack)


def allowed(placement: Placement, pack: Pack) -> Placement:
    """The placement without what the pack cannot have: a forward-facing scene is seen from one side, and is not turned."""
    return Placement(origin=placement.origin) if pack.ndc else placement


def placed_T_grid(pack: Pack) -> np.ndarray:
    """float64 [4, 4], by the pack's own marks: its placement and its scale."""
    marks = pack.metadata.get(MARKS)
    scale = marks.get("scale") if isinstance(marks, Mapping) else None
    factor = number_in(scale.get("factor"), *SCALES) if isinstance(scale, Mapping) else None
    return placement_of(pack).matrix(factor or 1.0)


def transformed(to_T_from: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points float64 [M, 3] in another frame."""
    return points @ to_T_from[:3, :3].T + to_T_from[:3, 3]


def moved_pose(to_T_from: np.ndarray, from_T_camera: np.ndarray) -> np.ndarray:
    """to_T_camera, float64 [4, 4]: where a similarity takes a camera; its axes stay of unit length."""
    moved = to_T_from @ from_T_camera
    moved[:3, :3] /= np.abs(np.linalg.det(to_T_from[:3, :3])) ** (1.0 / 3.0)
    return moved


# --- The ground ---

SURFACE = 0.5  # opacity of a voxel that may be ground
MOST_POINTS = 4000  # that are looked at
TRIES, TOGETHER = 6000, 500  # planes, and how many of them at once
THICK = 1.5  # voxels on either side of a plane that count as lying in it
LEAST_SHARE = 0.15  # of the points that lie in the ground
BELOW_SHARE = 0.1  # of the points that may lie below it
LEAST_WIDTH = 0.25  # of the ground across, of that of all points
NARROWEST = radians(5.0)  # angle of a triangle that tells a plane
STEEPEST = radians(60.0)  # from what is up now
FITS = 3  # to the points in the plane of the fit before


def ground_plane(pack: Pack, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A point of the ground and what is up there, a unit vector; float64 [3] both, grid frame. up: what is up now, float [3].

    UserError where there is no such plane.
    """
    nothing = UserError("no ground was found in the scene", remedy="click on three points of it, on the Move page")
    points, thick = _surface_points(pack, up), THICK * pack.voxel_size
    if pack.ndc or len(points) < 3:
        raise nothing
    rng, best, most = np.random.default_rng(0), None, 0.0
    for _ in range(TRIES // TOGETHER):
        a, b, c = points[rng.integers(0, len(points), (3, TOGETHER))]
        normals = np.cross(b - a, c - a)
        sizes = np.linalg.norm(normals, axis=1)
        wide = sizes > sin(NARROWEST) * np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
        normals, a = normals[wide] / sizes[wide, None], a[wide]
        normals *= np.copysign(1.0, normals @ up)[:, None]
        heights = points @ normals.T - np.sum(a * normals, axis=1)
        below = np.count_nonzero(heights < -2 * thick, axis=0)
        allowed = (below <= BELOW_SHARE * len(points)) & (normals @ up >= np.cos(STEEPEST) * np.linalg.norm(up))
        counts = np.count_nonzero(np.abs(heights) <= thick, axis=0) * allowed
        index = int(np.argmax(counts)) if len(counts) else 0
        if len(counts) and counts[index] > most:
            best, most = (a[index], normals[index]), counts[index]
    if best is None:
        raise nothing
    (at, normal), inside, spread = best, points, np.zeros(3)
    for _ in range(FITS):
        inside = points[np.abs((points - at) @ normal) <= thick]
        at = inside.mean(axis=0)
        _, spread, axes = np.linalg.svd(inside - at, full_matrices=False)
        normal = axes[2] * np.copysign(1.0, axes[2] @ normal)
    narrow = spread[1] / np.sqrt(len(inside)) < LEAST_WIDTH * points.std(axis=0).max()
    if narrow or len(inside) < LEAST_SHARE * len(points):
        raise nothing
    return at, normal


def _surface_points(pack: Pack, up: np.ndarray) -> np.ndarray:
    """Some of the opaque voxels that are clear above, float64 [n, 3], grid frame; of contracted packs, in the inner cube."""
    axis, found = int(np.argmax(np.abs(up))), []
    above = [slice(1, -1)] * 3  # z, y, x
    above[2 - axis] = slice(2, None) if up[axis] > 0 else slice(None, -2)
    for z, y, x in np.argwhere(pack.occupied).tolist():
        opaque = block_copy(pack, pack.atlas_rgba, (z, y, x))[..., 3] >= 255 * SURFACE
        shown = np.argwhere(opaque[1:-1, 1:-1, 1:-1] & ~opaque[tuple(above)])
        found.append((shown + np.array([z, y, x]) * pack.block_size)[:, ::-1] + 0.5)
    points = pack.min_xyz + pack.voxel_size * (np.concatenate(found) if found else np.zeros((0, 3)))
    points = points[np.abs(points).max(axis=1) <= (pack.contraction or inf)]
    return np.random.default_rng(0).permutation(points)[:MOST_POINTS]
