"""Cameras of the photographs that a pack was made from, and small copies of these: "cameras" of its metadata (docs/format.md,
"Additional keys").

An entry may have a "picture": a data URI (RFC 2397) of an AVIF, WebP, JPEG or PNG file, the photograph over its scene's
background, in the shape of the camera's width and height but as small as its maker likes.
"""

import base64
import io
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from PIL import Image

from console.streams import one_line
from scenepack.codecs.decoder_sandbox import Decoders
from scenepack.codecs.images import FORMATS
from scenepack.pack import Pack

PROJECTIONS = PERSPECTIVE, FISHEYE, EQUIRECTANGULAR = (0, 1, 2)  # of lenses; see training.scenes.lens
LENS_SIZE = 12  # numbers of a lens that k1, k2, p1, p2 do not describe; the last is its projection
FARTHEST = 1e9  # from the origin, and any other number of a camera: what is beyond makes no sense
LONGEST_NAME = 200  # characters


@dataclass(frozen=True)
class Camera:
    """A camera and its lens. Intrinsics are pixels of this width × height, by (a, b) of training.scenes.lens."""

    world_T_camera: np.ndarray  # float64 [4, 4], training frame, OpenGL axes: x right, y up, z back
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0,) * 4  # k1, k2, p1, p2, or what training.scenes.lens calls a lens

    @property
    def is_panorama(self) -> bool:
        return projection_of(self.distortion) == EQUIRECTANGULAR

    def resized(self, width: int, height: int) -> Self:
        """The same camera for a picture of another size."""
        sx, sy = width / self.width, height / self.height
        intrinsics = {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}
        return replace(self, width=width, height=height, **intrinsics)


def projection_of(lens: tuple[float, ...]) -> int:
    """PERSPECTIVE, FISHEYE or EQUIRECTANGULAR."""
    return int(lens[-1]) if len(lens) == LENS_SIZE else PERSPECTIVE


@dataclass(frozen=True, kw_only=True)
class PhotographCamera(Camera):
    """A camera in the metadata of a pack."""

    name: str
    split: str
    entry: Mapping[str, Any] = field(repr=False, compare=False)  # all that the pack says of it


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
        camera = (matrix, width, height, fx, fy, cx, cy, distortion)
        return PhotographCamera(*camera, name=name, split=split, entry=entry) if known else None
    except (KeyError, TypeError, ValueError, OverflowError):
        return None


# --- Pictures ---

PICTURE = "picture"
# Of the demo's photographs, 200 × 200: 38.7 dB at 7.3 kB each. WebP, which halves the resolution of colours, ends at
# 34.5 dB; JPEG takes twice as much for 37.8 dB.
QUALITY: dict[str, Any] = {"quality": 80, "subsampling": "4:4:4"}
LARGEST_SIDE, LARGEST_TEXT = 4096, 16 << 20  # what is read: pixels, characters


def picture_uri(pixels: np.ndarray, side: int) -> str:
    """A data URI of `pixels` (uint8 [h, w, 3]) at no more than `side` pixels a side."""
    picture = Image.fromarray(pixels)
    picture.thumbnail((side, side), Image.Resampling.BOX)
    file = io.BytesIO()
    picture.save(file, "AVIF", **QUALITY)
    return "data:image/avif;base64," + base64.b64encode(file.getvalue()).decode()


def has_picture(camera: Any) -> bool:
    """Whether an entry of "cameras" brings its photograph along, as far as is known without decoding it."""
    text = camera.get(PICTURE) if isinstance(camera, Mapping) else None
    return isinstance(text, str) and text.startswith("data:image/") and len(text) <= LARGEST_TEXT


def picture_of(camera: Mapping[str, Any]) -> np.ndarray | None:
    """The picture of an entry of "cameras", uint8 [h, w, 3]; None where it has none, or none that can be decoded."""
    if not has_picture(camera):
        return None
    head, _, data = str(camera[PICTURE]).partition(",")
    if not head.endswith(";base64"):
        return None
    try:
        content = base64.b64decode(data, validate=True)
        with Image.open(io.BytesIO(content), formats=FORMATS) as opened:
            width, height = opened.size  # from the header
        if max(width, height) > LARGEST_SIDE:
            return None
        with closing(Decoders()) as decoders:
            (rgba,) = decoders.decode(PICTURE, {PICTURE: content}, (PICTURE,), (1, height, width), False)
        return rgba[0, ..., :3]
    except MemoryError:
        raise
    except Exception:  # Pillow raises a dozen unrelated types
        return None
