"""Camera poses at the door: checked, and turned into OpenGL camera-to-world (x right, y up, z back).

Notation: world_T_camera [4, 4] float64; P [N, 4, 4] a stack of them.
"""

from typing import Any

import numpy as np

from console import UserError

FARTHEST = 1e9  # from the origin, whatever the unit
MOST_SHEAR = 0.02  # cosine between two axes of a camera
LAST_ROW = 1e-3  # how far the last row of a matrix may be from 0, 0, 0, 1


def pose(matrix: Any, where: str) -> np.ndarray:
    """A checked world_T_camera from nested lists [4, 4] or [3, 4]; its axes are made unit length."""

    def wrong(what: str, **facts: str) -> UserError:
        return UserError(f"the camera's matrix {what}", where=where, **facts)

    try:
        world_T_camera = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        raise wrong("has values that are not numbers", expected="4x4") from None
    if world_T_camera.shape == (3, 4):
        world_T_camera = np.vstack([world_T_camera, [0, 0, 0, 1]])
    if world_T_camera.shape != (4, 4):
        raise wrong("has another shape", expected="4x4", found="x".join(map(str, world_T_camera.shape)) or "nothing")
    if not (np.abs(world_T_camera) <= FARTHEST).all():
        raise wrong("has values that are not finite, or too large", expected=f"at most {FARTHEST:g}")
    world_T_camera[:3, :3] /= np.maximum(np.linalg.norm(world_T_camera[:3, :3], axis=0), 1e-300)
    if np.abs(world_T_camera[:3, :3].T @ world_T_camera[:3, :3] - np.eye(3)).max() > MOST_SHEAR:
        raise wrong("is not a rotation and a position", expected="axes at right angles")
    if np.abs(world_T_camera[3] - (0, 0, 0, 1)).max() > LAST_ROW:
        raise wrong("has another last row", expected="0, 0, 0, 1", found=", ".join(f"{value:g}" for value in world_T_camera[3]),
                    remedy="write camera-to-world matrices row by row")  # fmt: skip
    if (determinant := np.linalg.det(world_T_camera[:3, :3])) < 0:
        raise wrong("mirrors the world", expected="a rotation, determinant 1", found=f"determinant {determinant:.3g}",
                    remedy="export with right-handed axes: x right, y up, z back")  # fmt: skip
    return world_T_camera


def finite_numbers(values: Any, count: int) -> np.ndarray | None:
    """Values of any nesting as float64 [count]; None where they are others, or not all finite numbers."""
    try:
        numbers = np.array(values, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        return None
    return numbers if len(numbers) == count and np.isfinite(numbers).all() else None


def normalised(v: np.ndarray) -> np.ndarray:
    """v / |v|."""
    return v / np.linalg.norm(v)


def axes_along(z: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Axes [3, 3] (columns) of a frame whose z is that, and whose y is as near to `up` as that allows."""
    z = normalised(z)
    x = normalised(np.cross(up, z))
    return np.stack([x, np.cross(z, x), z], axis=1)


def look_at(eye: np.ndarray, back: np.ndarray, up: np.ndarray) -> np.ndarray:
    """world_T_camera [4, 4] at `eye` whose z axis is `back` and whose y axis is as near to `up` as that allows."""
    return np.vstack([np.column_stack([axes_along(back, up), eye]), [0, 0, 0, 1]])


def focus_point(P: np.ndarray) -> np.ndarray | None:
    """The point [3] nearest to all optical axes, in the least squares sense; None where these are parallel."""
    across = np.eye(3) - P[:, :3, 2, None] * P[:, None, :3, 2]  # projects onto the plane across an axis
    system = across.mean(0)
    if np.linalg.cond(system) > 1e3:
        return None
    return np.linalg.solve(system, (across @ P[:, :3, 3, None]).mean(0)[:, 0])


def faces_forward(P: np.ndarray) -> bool:
    """Whether all cameras look into one half space with room to spare, as the NDC warp needs."""
    mean = P[:, :3, 2].mean(0)
    return bool(np.linalg.norm(mean) > 1e-6 and (P[:, :3, 2] @ normalised(mean)).min() > 0.4)
