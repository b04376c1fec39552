"""A scene: posed photographs, as every reader returns them and as every other package sees them; rays of its cameras in NumPy
(training.dataset has the JAX twin), and the NDC warp of either. No JAX here.

Frames: OpenGL camera-to-world (x right, y up, z back) from the reader on. Rays: (x, y) pixel coordinates, pixel centres at +0.5;
(u, v) = ((x - cx) / fx, (y - cy) / fy) image coordinates, y down, still distorted; training.scenes.lens undoes that.
We undistort rays, not pictures: no pixel is resampled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np

from console import UserError
from scenepack.cameras import Camera
from scenepack.constants import NDC_NEAR
from training.scenes.files import distinct
from training.scenes.lens import Model, directions_at, image_of, shows

# What was photographed: cut out by alpha; from around, within a box or without an end; from one side.
Kind = Literal["object", "surroundings", "unbounded", "forward"]
Box = tuple[float, float, float, float, float, float]  # x0, y0, z0, x1, y1, z1
Direction = tuple[float, float, float]  # of any length above 0


LARGEST_SIDE = 1e6  # pixels


def camera_of(
    model: Model, values: Mapping[str, float], size: tuple[float, float], world_T_camera: np.ndarray, where: str
) -> Camera:
    """The camera with these values of a lens model's parameters, for pictures of that size. UserError where none makes sense."""
    fx, fy, cx, cy = model.intrinsics(values, *size)
    numbers = [*size, *values.values()]
    if not np.isfinite(numbers).all() or min(fx, fy) <= 0 or not 1 <= min(size) <= max(size) <= LARGEST_SIDE:
        found = ", ".join(f"{number:g}" for number in numbers)
        raise UserError("size and focal length must be positive numbers", where=where, found=found)
    return Camera(world_T_camera, round(size[0]), round(size[1]), fx, fy, cx, cy, model.lens(values))


@dataclass(frozen=True)
class Photograph:
    """One posed picture. load() decodes it: float32 [H, W, 4] in [0, 1], RGB not premultiplied, alpha 1 where opaque."""

    name: str
    camera: Camera
    load: Callable[[], np.ndarray]


def picture_stems(photographs: Sequence[Photograph]) -> list[str]:
    """A file name without suffix for each, no two alike: r_3 of train/r_3.png; left-003 where right/003.png is there as well."""
    stems = [Path(photograph.name).stem for photograph in photographs]
    if distinct(stems) != stems:
        stems = ["-".join(part for part in Path(p.name).with_suffix("").parts if part.strip("./")) for p in photographs]
    return distinct(stems)


@dataclass(frozen=True)
class Space:
    """What a trainer must know of the space that photographs show."""

    near: float  # along the unit-length ray, as far; in NDC 0 and 1
    far: float
    aabb: np.ndarray  # float64 [2, 3]: the box that holds the content, in the training frame (NDC space where ndc)
    worldspace_T_opengl: np.ndarray  # float64 [4, 4]: from the pack's grid frame (y up) to the training frame
    ndc: bool = False
    ndc_camera: tuple[int, int, float] | None = None  # width, height, focal length in pixels of the NDC warp
    contraction: float | None = None  # half the side of the cube about the origin beyond which space may be contracted
    disparity: bool = False  # whether samples are spread evenly in 1/t, as suits captures without a far end
    guessed: bool = False  # near, far and box are guesses: a capture of opaque photographs without points


@dataclass(frozen=True, kw_only=True)
class Scene(Space):
    """Posed photographs by split, and the space they show."""

    path: Path
    kind: str  # "blender", "llff", "transforms", "colmap" or "program"
    splits: Mapping[str, tuple[Photograph, ...]]
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)  # the colour behind everything, sRGB in [0, 1]
    held_out: str = ""  # what decided which photographs are held out, for messages; "" where none are
    notes: Mapping[str, object] = field(default_factory=dict)  # the SceneOptions that it was read with


def cameras_of(scene: Scene) -> list[dict[str, object]]:
    """The scene's cameras for a pack: pose (training frame), intrinsics in pixels, split and photograph name."""
    return [
        {
            "name": photograph.name, "split": split,
            "world_T_camera": np.asarray(photograph.camera.world_T_camera, float).tolist(),
            **{key: getattr(photograph.camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")},
            "distortion": list(photograph.camera.distortion),
        }
        for split, photographs in scene.splits.items()
        for photograph in photographs
    ]  # fmt: skip


FEW = 8  # photographs to train on
USES = {"train": "train on", "val": "validate with", "test": "test with"}


def few_line(scene: Scene) -> str | None:
    """What a user can expect of few photographs; None where there are enough of them to say nothing."""
    views = len(scene.splits["train"])
    if views == 1:
        return "one photograph to train on shows no depth: views from elsewhere will not look right"
    few = f"{views} photographs to train on are few: views far from them will not look right; 20 or more show a shape"
    return few if views < FEW else None


HELD_OUT_EVERY = 8
HELD_OUT_BY_NAME = f"every {HELD_OUT_EVERY}th by sorted name"


def split_line(scene: Scene) -> str:
    """How many photographs each split has, and why."""
    counts = [f"{len(photographs)} to {use}" for split, use in USES.items() if (photographs := scene.splits.get(split))]
    return f"photographs: {', '.join(counts)}; {scene.held_out or 'none held out'}"


def hold_out(photographs: Sequence[Photograph]) -> dict[str, tuple[Photograph, ...]]:
    """Splits of a capture without its own: every 8th photograph, from the first on, is for testing, unless it is alone."""
    if len(photographs) == 1:
        return {"train": tuple(photographs)}
    train = tuple(photograph for index, photograph in enumerate(photographs) if index % HELD_OUT_EVERY)
    return {"train": train, "test": tuple(photographs[::HELD_OUT_EVERY])}


def pixel_grid(camera: Camera, count: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y [count, count] of pixel coordinates spread evenly over a picture, from edge to edge."""
    x, y = (np.linspace(0.0, side, count) for side in (camera.width, camera.height))
    return np.meshgrid(x, y)  # type: ignore[return-value]


def camera_rays(camera: Camera, x: np.ndarray | None = None, y: np.ndarray | None = None):
    """origins, unit directions float64 [..., 3] through pixel coordinates x, y [...]; default: every pixel's centre [H, W]."""
    if x is None or y is None:
        y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    in_camera = directions_at((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, camera.distortion)
    directions = in_camera @ camera.world_T_camera[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.broadcast_to(camera.world_T_camera[:3, 3], directions.shape), directions


def shown_pixels(camera: Camera) -> np.ndarray:
    """bool [H, W]: the pixels in which the lens shows anything: not the corners of a circular fisheye, where the model ends."""
    y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    return shows((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, camera.distortion)


def pixels_of(camera: Camera, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel coordinates [..., 2] of places [..., 3] in the training frame, and which of them the lens shows [...]."""
    u, v, shown = image_of((places - camera.world_T_camera[:3, 3]) @ camera.world_T_camera[:3, :3], camera.distortion)
    return np.stack([camera.cx + camera.fx * u, camera.cy + camera.fy * v], axis=-1), shown


def ndc_rays(
    origins: Any, directions: Any, width: float, height: float, focal: float, xp: ModuleType = np
) -> tuple[Any, Any]:
    """NeRF's NDC warp (appendix C): rays [..., 3], not of unit length, so that t = 0 is the near plane z = -NDC_NEAR and t = 1 is
    infinity. width, height, focal: pixels of the reference camera. xp: the library of the arrays, NumPy or JAX's."""
    o = origins - ((NDC_NEAR + origins[..., 2]) / directions[..., 2])[..., None] * directions
    scale = xp.array([-2.0 * focal / width, -2.0 * focal / height], o.dtype)
    place, slope = o[..., :2] / o[..., 2:], directions[..., :2] / directions[..., 2:]
    depth = 2.0 * NDC_NEAR / o[..., 2:]
    warped_origins = xp.concatenate([scale * place, 1.0 + depth], axis=-1)
    return warped_origins, xp.concatenate([scale * (slope - place), -depth], axis=-1)
