"""Cameras of the photographs that a pack was made from: "cameras" of its metadata (docs/format.md, "Additional keys")."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from console.streams import one_line
from scenepack.pack import Pack

PROJECTIONS = PERSPECTIVE, FISHEYE, EQUIRECTANGULAR = (0, 1, 2)  # of lenses; see training.scenes.lens
LENS_SIZE = 12  # numbers of a lens that k1, k2, p1, p2 do not describe; the last is its projection
FARTHEST = 1e9  # from the origin, and any other number of a camera: what is beyond makes no sense
LONGEST_NAME = 200  # characters


@dataclass(frozen=True)
class PhotographCamera:
    name: str
    split: str
    world_T_camera: np.ndarray  # float64 [4, 4], training frame; axes x right, y up, z back
    width: int  # pixels, as all that follow
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0,) * 4  # k1, k2, p1, p2, or what training.scenes.lens calls a lens
    entry: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)  # all that the pack says of it

    @property
    def is_perspective(self) -> bool:
        """Whether it is no fisheye and no panorama."""
        return len(self.distortion) != LENS_SIZE or self.distortion[-1] == PERSPECTIVE


def photograph_cameras(pack: Pack) -> list[PhotographCamera]:
    """The cameras in the pack's metadata; entries that make no sense are left out."""
    entries = pack.metadata.get("cameras")
    cameras: list[PhotographCamera] = []
    for entry in entries if isinstance(entries, list) else []:
        if (camera := _camera(entry, len(cameras))) is not None:
            cameras.append(camera)
    return cameras


def label_of(name: Any) -> str:
    """A name from a pack or a scene, fit for labels."""
    return one_line(str(name), LONGEST_NAME)


def _camera(entry: Any, number: int) -> PhotographCamera | None:
    try:
        matrix = np.asarray(entry["world_T_camera"], np.float64)
        fx, fy, cx, cy = (float(entry[name]) for name in ("fx", "fy", "cx", "cy"))
        width, height = int(entry["width"]), int(entry["height"])
        distortion = tuple(float(v) for v in entry.get("distortion") or (0.0,) * 4)
        name, split = label_of(entry.get("name", number)), label_of(entry.get("split", "train"))
        good = matrix.shape == (4, 4) and (np.abs(matrix) < FARTHEST).all() and abs(np.linalg.det(matrix)) > 1e-9
        good = good and (np.abs([fx, fy, cx, cy, *distortion]) < FARTHEST).all() and min(fx, fy) > 1 / FARTHEST
        if not (good and 0 < width < FARTHEST and 0 < height < FARTHEST):
            return None
        known = len(distortion) == 4 or (len(distortion) == LENS_SIZE and distortion[-1] in PROJECTIONS)
        lens = (width, height, fx, fy, cx, cy, distortion)
        return PhotographCamera(name, split, matrix, *lens, entry) if known else None
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
