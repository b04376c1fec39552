"""Options of a scene; of these the box that holds the content (--aabb), and what is up (--up).

Both are in the training frame without --up (docs/scenes.md), which the window shows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from console import UserError
from console.command_line import parse_numbers
from training.scenes.files import notice
from training.scenes.poses import finite_numbers, normalised
from training.scenes.scene import Box, Camera, Direction, Scene, camera_rays, pixel_grid

AABB, UP = "--aabb", "--up"
PROBES = 17  # pixels along each side of a picture whose rays are tried
FEWEST_MEETING = 0.5  # share of the photographs that see the box, else the user is warned
SHORTEST = 1e-6  # of a direction


@dataclass(frozen=True)
class SceneOptions:
    """How a folder is to be read; a run stores it to read the same photographs again. UserError for values without sense."""

    downscale: int = 1  # divide width and height of the pictures by this whole number, averaging over areas
    spherify: bool | None = None  # LLFF, COLMAP: seen from all around, or forward-facing; None: as the cameras look
    masks: bool = False  # captures: cut the object out by the masks beside the pictures (alpha 0 where black)
    aabb: Box | None = None  # not in NDC: what holds the content, in the training frame; None: the reader's own
    up: Direction | None = None  # COLMAP, not in NDC: in the frame as it is without this; None: the cameras' mean

    def __post_init__(self) -> None:
        downscale = self.downscale
        if isinstance(downscale, bool) or not 1 <= downscale < math.inf or int(downscale) != downscale:
            raise UserError("downscale must be a whole number of at least 1", where="--downscale", found=downscale)
        object.__setattr__(self, "downscale", int(downscale))
        object.__setattr__(self, "aabb", None if self.aabb is None else checked_box(self.aabb))
        object.__setattr__(self, "up", None if self.up is None else checked_up(self.up))

    def require_unchanged(self, asked: Mapping[str, object], remedy: str) -> None:
        """UserError if one of `asked` differs from these options, which a resumed run keeps. None: the option was left out."""
        for name, value in asked.items():
            before = getattr(self, name)
            if value is not None and value != before:
                raise UserError("a run cannot change how its scene is read", where=f"--{name}", found=value,
                                expected="none" if before is None else before, remedy=remedy)  # fmt: skip


def parse_box(text: str | None) -> Box | None:
    """ "x0,y0,z0,x1,y1,z1" as six numbers; None where the option is left out. UserError for anything else."""
    return None if text is None else checked_box(parse_numbers(text, 6, AABB))


def checked_box(values: Sequence[float]) -> Box:
    """Six finite numbers, the low corner before the high one. UserError for anything else."""
    if (numbers := finite_numbers(values, 6)) is None:
        raise UserError("is not a box", where=AABB, expected="x0,y0,z0,x1,y1,z1", found=values)
    for axis, low, high in zip("xyz", numbers[:3], numbers[3:], strict=True):
        if low >= high:
            found = f"{axis}0 = {low:g}, {axis}1 = {high:g}"
            raise UserError("the box is empty", where=AABB, expected=f"{axis}0 below {axis}1", found=found)
    x0, y0, z0, x1, y1, z1 = map(float, numbers)
    return x0, y0, z0, x1, y1, z1


def with_box(scene: Scene, box: Box) -> Scene:
    """The scene within a box, its far end behind all of it. UserError in NDC, and where no training photograph sees the box."""
    if scene.ndc:
        what = "a forward-facing scene has no box: in NDC, the box is everything that the cameras see"
        raise UserError(what, where=AABB, remedy="leave it out, or use --spherify")
    aabb = np.array(checked_box(box)).reshape(2, 3)
    eyes = np.stack([photograph.camera.world_T_camera[:3, 3] for photograph in scene.splits["train"]])
    farthest = np.linalg.norm(np.maximum(np.abs(eyes - aabb[0]), np.abs(eyes - aabb[1])), axis=-1).max()
    boxed = replace(scene, aabb=aabb, far=max(scene.far, float(farthest)), contraction=None)
    if not any(_meets(photograph.camera, boxed) for photograph in scene.splits["train"]):
        expected = f"something about {box_text(scene.aabb)}"
        raise UserError("no photograph sees this box", where=AABB, expected=expected, found=box_text(aabb))
    return boxed


def require_rays(scene: Scene) -> None:
    """UserError where no ray of the training photographs meets the box between near and far; a Notice where few do."""
    if scene.ndc:
        return
    cameras = [photograph.camera for photograph in scene.splits["train"]]
    meeting = sum(_meets(camera, scene) for camera in cameras)
    if not meeting:
        found = f"{box_text(scene.aabb)} at {scene.near:.3g} to {scene.far:.3g} from the cameras"
        raise UserError("no photograph sees the box of the content", where=scene.path, found=found,
                        remedy=f"check the camera poses, or name the box with {AABB}")  # fmt: skip
    if meeting < FEWEST_MEETING * len(cameras):
        text = f"{len(cameras) - meeting} of {len(cameras)} photographs see nothing of the box of the content"
        notice(scene.path, f"{text} {box_text(scene.aabb)}; name another with {AABB}")


def box_text(aabb: np.ndarray) -> str:
    """A box [2, 3] as --aabb takes it."""
    return ",".join(f"{value:.4g}" for value in np.asarray(aabb).ravel())


def box_line(scene: Scene, given: bool, contracted: bool = False) -> str | None:
    """What a user must know to choose another box; None where there is nothing to choose. contracted: all of space is trained."""
    if scene.ndc:
        return None
    if contracted:
        return (
            f"unbounded: what lies within {scene.contraction:.4g} of the origin on every axis is trained finely, all else more "
            f"coarsely the farther it is; to train only a box: {AABB} x0,y0,z0,x1,y1,z1"
        )
    eyes = np.stack([photograph.camera.world_T_camera[:3, 3] for photograph in scene.splits["train"]])
    distance = np.linalg.norm(eyes, axis=-1).mean()
    whose = "as given by --aabb" if given else "another one: --aabb x0,y0,z0,x1,y1,z1"
    return f"box of the content: {box_text(scene.aabb)} where cameras stand {distance:.3g} from the origin; {whose}"


def _meets(camera: Camera, scene: Scene) -> bool:
    """Whether any of some rays through the picture meets the scene's box between near and far."""
    origins, directions = (v.reshape(-1, 3) for v in camera_rays(camera, *pixel_grid(camera, PROBES)))
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (scene.aabb[:, None] - origins) / directions
    enter = np.nanmax(np.fmin(ends[0], ends[1]), axis=-1).clip(scene.near)
    leave = np.nanmin(np.fmax(ends[0], ends[1]), axis=-1).clip(max=scene.far)
    return bool((enter < leave).any())


def parse_up(text: str | None) -> Direction | None:
    """ "x,y,z" as a direction; None where the option is left out. UserError for anything else."""
    return None if text is None else checked_up(parse_numbers(text, 3, UP))


def checked_up(values: Sequence[float]) -> Direction:
    """Three finite numbers, not all 0. UserError for anything else."""
    numbers = finite_numbers(values, 3)
    if numbers is None or np.linalg.norm(numbers) < SHORTEST:
        raise UserError("is no direction", where=UP, expected="x,y,z, not all 0", found=str(values)[:60])
    x, y, z = map(float, numbers)
    return x, y, z


def recorded_options(stored: object) -> dict[str, Any]:
    """`spherify`, `masks` and `up` of load_scene as the maker of a pack or run read its scene. stored: what that says of itself,
    which may be anything. UserError where its `up` makes no sense.
    """
    stored = stored if isinstance(stored, dict) else {}
    spherify, up = stored.get("spherify"), stored.get("up")
    spherify = spherify if isinstance(spherify, bool) else None
    return {"spherify": spherify, "masks": stored.get("masks") is True, "up": None if up is None else checked_up(up)}


def axes_of(up: Direction) -> np.ndarray:
    """Axes [3, 3] (columns), in the frame without the option, of the frame whose z is `up`: turned there the shortest way."""
    z = normalised(np.array(checked_up(up)))
    if z[2] < -1 + SHORTEST:
        return np.diag([1.0, -1.0, -1.0])
    return Rotation.align_vectors(z, [0.0, 0.0, 1.0])[0].as_matrix()


def composed(before: Direction | None, up: np.ndarray) -> Direction:
    """The option for what is up in the frame that another value of it has led to."""
    x, y, z = (float(f"{value:.5g}") for value in (up if before is None else axes_of(before) @ up))
    return x, y, z
