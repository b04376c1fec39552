"""Physics of walking: where a body on foot moves, given which points of space are solid.

Notation: lengths in eye heights, y up; time in seconds. feet: float64 [3], below the middle of the body. The body is an upright
cylinder of RADIUS, tested at points from STEP above its feet to TOP: whatever is lower is stepped on. grain: the side of a voxel.
"""

from collections.abc import Callable
from math import ceil, floor
from typing import NamedTuple

import numpy as np

RADIUS, STEP, TOP = 0.15, 1 / 3, 1.06
GRAVITY, JUMP_SPEED, FASTEST_FALL = 6.0, 2.3, 15.0  # eye heights per s², and per s; a jump is 0.44 high
ASIDE = (0.0, 0.5, 1.0)  # voxels away from a wall, along which the body may have to go past its bumps


def _disc(*radii: float) -> np.ndarray:
    """Points on level circles around the axis, and on it; float64 [n, 3]."""
    angles = 2 * np.pi * np.arange(12) / 12
    circle = np.stack([np.cos(angles), np.zeros(12), np.sin(angles)], axis=1)
    return np.concatenate([np.zeros((1, 3)), *(radius * circle for radius in radii)])


def _upright(disc: np.ndarray, heights: int) -> np.ndarray:
    return (disc + np.linspace(STEP, TOP, heights)[:, None, None] * np.array([0.0, 1.0, 0.0])).reshape(-1, 3)


SOLES = _disc(RADIUS)
BODY = _upright(SOLES, 8)
NEAR = _upright(_disc(*(RADIUS * np.array([0.4, 0.8, 1.2, 1.6]))), 5)  # of which the solid ones tell where a wall is


class Body(NamedTuple):
    """rising: speed upwards. stands: there is ground below its feet."""

    feet: np.ndarray
    rising: float = 0.0
    stands: bool = False


class Space(NamedTuple):
    """is_solid: of points float64 [n, 3], bool [n]."""

    is_solid: Callable[[np.ndarray], np.ndarray]
    grain: float

    def is_free(self, feet: np.ndarray) -> bool:
        return not self.is_solid(feet + BODY).any()

    def swept(self, feet: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, bool]:
        """How far the body gets, and whether that is all of the way. No wall of a voxel's thickness is missed."""
        count = max(1, ceil(float(np.linalg.norm(way)) / (0.5 * self.grain)))
        places = feet + way * (np.arange(1, count + 1) / count)[:, None]
        hit = self.is_solid((places[:, None] + BODY).reshape(-1, 3)).reshape(count, -1).any(axis=1)
        if not hit.any():
            return feet + way, True
        first = int(np.argmax(hit))
        return (places[first - 1] if first else feet), False

    def ground(self, feet: np.ndarray, reach: float) -> float | None:
        """Height of the highest ground from STEP above the feet to `reach` below them. Heights are multiples of one spacing."""
        spacing = min(0.5 * self.grain, max(self.grain / 8, 0.005))
        top, bottom = floor((feet[1] + STEP) / spacing + 1e-6), ceil((feet[1] - reach) / spacing - 1e-6)
        heights = spacing * np.arange(top, bottom - 1, -1)
        columns = np.repeat((feet + SOLES)[None], len(heights), axis=0)
        columns[..., 1] = heights[:, None]
        found = self.is_solid(columns.reshape(-1, 3)).reshape(len(heights), -1).any(axis=1)
        return float(heights[np.argmax(found)]) if found.any() else None

    def wall_normal(self, feet: np.ndarray) -> np.ndarray | None:
        """Level unit vector away from what is solid near the body; None where that is on all sides, or nothing."""
        normal = -NEAR[self.is_solid(feet + NEAR)].sum(axis=0) * [1.0, 0.0, 1.0]
        size = float(np.linalg.norm(normal))
        return normal / size if size > 1e-6 else None


def moved(space: Space, body: Body, way: np.ndarray, jumps: bool, seconds: float) -> Body:
    """The body after `seconds`, in which it wants to walk `way` (float [3], level)."""
    feet, rising, stands = body
    if jumps and stands:
        rising, stands = JUMP_SPEED, False
    pieces = max(1, ceil(float(np.linalg.norm(way)) / RADIUS))
    for _ in range(pieces):
        if rising > 0:
            feet = _slid(space, feet, way / pieces)
        else:
            feet, stands = _walked(space, feet, way / pieces, STEP if stands else 0.0)
    if stands:
        return Body(feet, 0.0, True)
    rising = max(rising - GRAVITY * seconds, -FASTEST_FALL)
    if rising > 0:
        feet, clear = space.swept(feet, np.array([0.0, rising * seconds, 0.0]))
        return Body(feet, rising if clear else 0.0)
    ground = space.ground(feet, -rising * seconds)
    if ground is not None:
        return Body(_at_height(feet, ground), 0.0, True)
    return Body(_at_height(feet, feet[1] + rising * seconds), rising)


def _walked(space: Space, feet: np.ndarray, way: np.ndarray, reach: float) -> tuple[np.ndarray, bool]:
    """The feet after a way not longer than RADIUS, on the ground that is at most `reach` below; and whether there is some.

    A body that is stuck moves as if nothing were there, and is lifted out.
    """
    stuck = not space.is_free(feet)
    there = feet + way if stuck else _slid(space, feet, way)
    ground = space.ground(there, reach)
    if ground is None:
        return there, False
    lifted = _at_height(there, ground)
    if ground > feet[1] and not stuck and not space.is_free(lifted):  # the ceiling is too low
        return feet, space.ground(feet, reach) is not None
    return lifted, True


def _slid(space: Space, feet: np.ndarray, way: np.ndarray) -> np.ndarray:
    """As far as the walls let the body go, and on along them."""
    end = feet + way
    feet, clear = space.swept(feet, way)
    normal = None if clear else space.wall_normal(feet)
    if clear or normal is None:
        return feet
    along = end - feet
    along = along - min(float(along @ normal), 0.0) * normal
    for voxels in ASIDE:
        beside, _ = space.swept(feet, voxels * space.grain * normal)
        reached, clear = space.swept(beside, along)
        if clear:
            return reached
    return feet


def _at_height(feet: np.ndarray, height: float) -> np.ndarray:
    return np.array([feet[0], height, feet[2]])
