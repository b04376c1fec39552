"""A scene: posed photographs, as every reader returns them and as every other room sees them. No JAX here.

Frames: OpenGL camera-to-world (x right, y up, z back) from the reader on. Pixel centres lie at +0.5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

Kind = Literal[
    "object", "surroundings", "forward"
]  # what was photographed: cut out by alpha; from around; from one side


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with optional lens distortion (OpenCV's k1, k2, p1, p2 on normalised coordinates, y down).

    world_T_camera: float64 [4, 4], camera-to-world, OpenGL axes. fx, fy, cx, cy: pixels of this width ×
    height.
    """

    world_T_camera: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def resized(self, width: int, height: int) -> Camera:
        """The same camera for a picture of another size."""
        sx, sy = width / self.width, height / self.height
        intrinsics = {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}
        return replace(self, width=width, height=height, **intrinsics)


@dataclass(frozen=True)
class Photograph:
    """One posed picture. load() decodes it: float32 [H, W, 4], RGB not premultiplied and alpha (1 where
    opaque), in [0, 1].
    """

    name: str
    camera: Camera
    load: Callable[[], np.ndarray]


def picture_stems(photographs: Sequence[Photograph]) -> list[str]:
    """A file name without suffix for each of `photographs`, no two alike: r_3 of train/r_3.png, left-003 where right/003.png
    is there as well.
    """
    stems = [Path(photograph.name).stem for photograph in photographs]
    if len({stem.lower() for stem in stems}) < len(stems):  # some file systems take R_3 for r_3
        stems = ["-".join(part for part in Path(p.name).with_suffix("").parts if part.strip("./")) for p in photographs]
    taken: set[str] = set()
    for i, stem in enumerate(stems):
        while stems[i].lower() in taken:  # a.png and a.jpg
            stems[i] = f"{stem}-{i}"
        taken.add(stems[i].lower())
    return stems


Box = tuple[float, float, float, float, float, float]  # x0, y0, z0, x1, y1, z1
Direction = tuple[float, float, float]  # of any length above 0


@dataclass(frozen=True)
class SceneOptions:
    """How a folder is to be read; a run stores it to read the same photographs again."""

    downscale: int = 1
    """Divide width and height of the pictures by this whole number, averaging over areas."""
    spherify: bool | None = None
    """LLFF and COLMAP: True reads a 360° capture, False a forward-facing one; None tells by where the cameras look."""
    masks: bool = False
    """Captures: cut the object out by the masks beside the pictures (alpha 0 where black)."""
    aabb: Box | None = None
    """The box that holds the content, in the training frame, in place of the reader's own; not for NDC scenes."""
    up: Direction | None = None
    """COLMAP, seen from all around: what is up, in the training frame as it is without this; None: the cameras' own mean."""


@dataclass(frozen=True)
class Scene:
    """Posed photographs by split, and what a trainer must know of the space they show.

    kind: "blender", "llff", "transforms" or "colmap". near, far: along the unit-length ray (in NDC: 0, 1).
    aabb: float64 [2, 3] box that holds the content, in the training frame (NDC space where ndc).
    worldspace_T_opengl: float64 [4, 4], the pack's grid frame (y up) to the training frame.
    ndc_camera: width, height and focal length in pixels that define the NDC warp; None unless ndc.
    disparity: whether samples should be spread evenly in 1/t, as suits captures without a far end.
    background: the colour behind everything, sRGB in [0, 1].
    held_out: what decided which photographs are held out, for messages; "" where none are.
    """

    path: Path
    kind: str
    splits: Mapping[str, tuple[Photograph, ...]]
    near: float
    far: float
    aabb: np.ndarray
    worldspace_T_opengl: np.ndarray
    ndc: bool = False
    ndc_camera: tuple[int, int, float] | None = None
    disparity: bool = False
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    held_out: str = ""
    notes: Mapping[str, object] = field(default_factory=dict)


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
    if views < FEW:
        return (
            f"{views} photographs to train on are few: views far from them will not look right; 20 or more show a shape"
        )
    return None


HELD_OUT_EVERY = 8
HELD_OUT_BY_NAME = f"every {HELD_OUT_EVERY}th by sorted name"


def split_line(scene: Scene) -> str:
    """How many photographs each split has, and why."""
    counts = [f"{len(photographs)} to {use}" for split, use in USES.items() if (photographs := scene.splits.get(split))]
    return f"photographs: {', '.join(counts)}; {scene.held_out or 'none held out'}"


def hold_out(photographs: Sequence[Photograph]) -> dict[str, tuple[Photograph, ...]]:
    """Splits of a capture without splits of its own: every 8th photograph, from the first on, is for testing.

    One photograph alone is for training.
    """
    test = tuple(photographs[::HELD_OUT_EVERY]) if len(photographs) > 1 else ()
    train = tuple(p for index, p in enumerate(photographs) if index % HELD_OUT_EVERY or len(photographs) == 1)
    return {"train": train, "test": test} if test else {"train": train}
