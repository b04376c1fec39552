"""The box that holds the content, where the user names it (--aabb) in place of the reader's own.

Its numbers are coordinates of the training frame: what the reader made of the folder's poses (docs/scenes.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from console import UserError
from console.arguments import parse_numbers
from training.scenes.scene import Box, Camera, Scene

OPTION = "--aabb"
PROBES = 9  # points along each side of a box whose being seen is tested


def parse_box(text: str) -> Box:
    """ "x0,y0,z0,x1,y1,z1" as six numbers. UserError for anything else."""
    return checked_box(parse_numbers(text, 6, OPTION))


def checked_box(values: Sequence[float]) -> Box:
    """Six finite numbers, the low corner before the high one. UserError for anything else."""
    numbers = np.array(values, np.float64)
    if numbers.shape != (6,) or not np.isfinite(numbers).all():
        raise UserError("is not a box", where=OPTION, expected="x0,y0,z0,x1,y1,z1", found=values)
    if not (numbers[:3] < numbers[3:]).all():
        axis = "xyz"[int(np.argmin(numbers[:3] < numbers[3:]))]
        found = f"{axis}0 = {numbers['xyz'.index(axis)]:g}, {axis}1 = {numbers['xyz'.index(axis) + 3]:g}"
        raise UserError("the box is empty", where=OPTION, expected=f"{axis}0 below {axis}1", found=found)
    x0, y0, z0, x1, y1, z1 = map(float, numbers)
    return x0, y0, z0, x1, y1, z1


def with_box(scene: Scene, box: Box) -> Scene:
    """The scene with that box, its far end moved out to reach all of it.

    UserError for NDC scenes, whose box is all that the cameras see, and where no training photograph sees the box.
    """
    if scene.ndc:
        raise UserError(
            "a forward-facing scene has no box: in NDC, the box is everything that the cameras see",
            where=OPTION,
            remedy="leave it out, or use --spherify",
        )
    aabb = np.array(checked_box(box)).reshape(2, 3)
    if not _seen(scene, aabb):
        raise UserError(
            "no photograph sees this box",
            where=OPTION,
            expected=f"something about {box_text(scene.aabb)}",
            found=box_text(aabb),
        )
    eyes = np.stack([photograph.camera.world_T_camera[:3, 3] for photograph in scene.splits["train"]])
    farthest = np.linalg.norm(np.maximum(np.abs(eyes - aabb[0]), np.abs(eyes - aabb[1])), axis=-1).max()
    return replace(scene, aabb=aabb, far=max(scene.far, float(farthest)))


def require_seen(scene: Scene) -> None:
    """UserError where no training photograph sees the reader's own box: there would be nothing to train."""
    if not scene.ndc and not _seen(scene, scene.aabb):
        raise UserError(
            "no photograph sees the box of the content",
            where=scene.path,
            found=box_text(scene.aabb),
            remedy=f"check the camera poses, or name the box with {OPTION}",
        )


def box_text(aabb: np.ndarray) -> str:
    """A box [2, 3] as --aabb takes it."""
    return ",".join(f"{value:.4g}" for value in np.asarray(aabb).ravel())


def box_line(scene: Scene, given: bool) -> str | None:
    """What a user must know to choose another box; None where there is nothing to choose."""
    if scene.ndc:
        return None
    eyes = np.stack([photograph.camera.world_T_camera[:3, 3] for photograph in scene.splits["train"]])
    distance = np.linalg.norm(eyes, axis=-1).mean()
    whose = "as told by --aabb" if given else "another one: --aabb x0,y0,z0,x1,y1,z1"
    return f"box of the content: {box_text(scene.aabb)} where cameras stand {distance:.3g} from the origin; {whose}"


def _seen(scene: Scene, aabb: np.ndarray) -> bool:
    """Whether a training photograph was taken within the box [2, 3], or shows any of it."""
    probes = np.stack(np.meshgrid(*np.linspace(aabb[0], aabb[1], PROBES).T, indexing="ij"), -1).reshape(-1, 3)
    cameras = [photograph.camera for photograph in scene.splits["train"]]
    eyes = np.stack([camera.world_T_camera[:3, 3] for camera in cameras])
    within = ((eyes > aabb[0]) & (eyes < aabb[1])).all(-1).any()
    return bool(within) or any(_sees(camera, probes) for camera in cameras)


def _sees(camera: Camera, points: np.ndarray) -> bool:
    """Whether any of the points [N, 3] lies within the picture; the lens's distortion is left out."""
    x, y, z = (np.linalg.inv(camera.world_T_camera) @ np.c_[points, np.ones(len(points))].T)[:3]
    depth = np.where(z < 0, -z, np.inf)
    u, v = camera.fx * x / depth + camera.cx, camera.cy - camera.fy * y / depth
    return bool(((z < 0) & (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)).any())
