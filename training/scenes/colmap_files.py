"""COLMAP's reconstruction on disk, binary or text, as plain arrays.

Notation: N posed images, M points. COLMAP's cameras look along +z with y down; its pixel centres lie at +0.5, its poses are
camera_T_world. The formats: COLMAP's documentation, "Output Format"; newer versions' rigs and frames add nothing to images.
Counts and lengths in a file are checked against its size.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from console import UserError
from training.scenes.lens import MODELS
from training.scenes.poses import pose
from training.scenes.scene import Camera, camera_of

PARTS = ("cameras", "images", "points3D")
SUFFIXES = (".bin", ".txt")
# Lens models by their numbers in cameras.bin.
NAMES = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
         "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION",
         "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR")  # fmt: skip
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # y down and z ahead become y up and z back
LONGEST_NAME = 4096  # bytes
BYTE_ORDER_MARK = b"\xef\xbb\xbf"  # UTF-8's, which editors on Windows write
NUMBER, TRACK_ELEMENT = np.dtype("<f8"), np.dtype([("image", "<u4"), ("keypoint", "<u4")])
KEYPOINT = np.dtype([("xy", "<f8", 2), ("point", "<i8")])


@dataclass(frozen=True)
class Reconstruction:
    """Posed images, sorted by name, and points, in COLMAP's own frame and units."""

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]  # OpenGL axes
    places: np.ndarray  # [M, 3] of the points
    colours: np.ndarray  # uint8 [M, 3]
    tracks: np.ndarray  # [M]: how many images show each
    seen: tuple[np.ndarray, ...]  # of each image the rows of `places` that it shows

    def only(self, rows: list[int]) -> Reconstruction:
        """The same points with these images alone."""
        names, cameras, seen = (tuple(values[row] for row in rows) for values in (self.names, self.cameras, self.seen))
        return replace(self, names=names, cameras=cameras, seen=seen)


class _Image(NamedTuple):
    name: str
    camera: int
    world_T_camera: np.ndarray  # OpenGL axes
    shown: np.ndarray  # ids of points


def model_suffix(folder: Path) -> str | None:
    """Whether `folder` holds a reconstruction, and how: ".bin", or else ".txt"."""
    return next((suffix for suffix in SUFFIXES if (folder / f"{PARTS[0]}{suffix}").is_file()), None)


def read_reconstruction(folder: Path) -> Reconstruction:
    """Reads cameras, images and points3D (which may be missing). UserError where a file is missing or damaged, a lens model is
    not supported, or nothing has a pose."""
    suffix = model_suffix(folder) or SUFFIXES[0]
    files = [folder / f"{part}{suffix}" for part in PARTS]
    for file in files[:2]:
        if not file.is_file():
            raise UserError("this part of the reconstruction is missing", where=file)
    stats = [file.stat() for file in files if file.is_file()]
    return _read(folder, suffix, tuple((stat.st_mtime_ns, stat.st_size) for stat in stats))


@lru_cache(maxsize=4)  # a scene is read once for each downscale that is considered
def _read(folder: Path, suffix: str, stamp: tuple[tuple[int, int], ...]) -> Reconstruction:
    cameras, posed, points3d = (folder / f"{part}{suffix}" for part in PARTS)
    read_lenses, read_images, read_points = READERS[suffix]
    lenses, images = dict(_all(read_lenses, cameras)), sorted(_all(read_images, posed), key=lambda image: image.name)
    points = sorted(_all(read_points, points3d)) if points3d.is_file() else []
    if not images:
        raise UserError("the reconstruction is empty: no image has a pose", where=folder,
                        remedy="COLMAP found nothing to match; photographs need more overlap")  # fmt: skip
    if missing := {image.camera for image in images} - set(lenses):
        raise _damaged(posed, f"an image of camera {min(missing)}, which {cameras.name} lacks")
    ids = np.array([point[0] for point in points], np.int64)
    table = np.array([point[1:] for point in points], np.float64).reshape(-1, 7)
    if not np.isfinite(table[:, :3]).all():
        raise _damaged(points3d, "a point at no finite place")
    return Reconstruction(
        names=tuple(image.name for image in images),
        cameras=tuple(replace(lenses[image.camera], world_T_camera=image.world_T_camera) for image in images),
        places=table[:, :3], colours=np.clip(table[:, 3:6], 0, 255).astype(np.uint8), tracks=table[:, 6],
        seen=tuple(_rows_of(image.shown, ids) for image in images),
    )  # fmt: skip


def _all(read: Callable[[Path], Iterator[Any]], file: Path) -> list[Any]:
    """What a reader yields. UserError for what Python and NumPy raise where the file is not as it should be."""
    try:
        return list(read(file))
    except (ValueError, IndexError, OverflowError, struct.error) as error:
        raise _damaged(file, str(error)[:80]) from error


def _rows_of(shown: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Where in `ids` (sorted) those of points stand, as far as they do."""
    rows = np.minimum(np.searchsorted(ids, shown), max(len(ids) - 1, 0))
    return rows[ids[rows] == shown] if len(ids) else rows[:0]


def _pose(file: Path, name: str, numbers: Sequence[float]) -> np.ndarray:
    """world_T_camera of COLMAP's w, x, y, z of a quaternion and translation of camera_T_world."""
    (w, x, y, z, *translation), where = numbers, f"{file} {name}"
    camera_T_world = np.column_stack([Rotation.from_quat([x, y, z, w]).as_matrix(), translation])
    return pose(np.linalg.inv(pose(camera_T_world, where)) @ OPENGL_FROM_OPENCV, where)


def _lens(number: int, model: str, size: tuple[float, float], values: np.ndarray, file: Path) -> tuple[int, Camera]:
    """A camera that stands nowhere yet."""
    if model not in MODELS:
        raise UserError("this lens model is not supported", where=file, expected=", ".join(MODELS), found=model[:40],
                        remedy="undistort the pictures with COLMAP first (colmap image_undistorter)")  # fmt: skip
    lens = MODELS[model]
    if len(values) != len(lens.parameters):
        raise ValueError(f"{len(values)} parameters of a {model}")
    named = dict(zip(lens.parameters, map(float, values), strict=True))
    return number, camera_of(lens, named, size, np.eye(4), f"{file} camera {number}")


# --- binary -----------------------------------------------------------------------------------------------------------


def _entries(file: Path) -> Iterator[io.BytesIO]:
    """The file at the beginning of each entry that it says it has; then it must end."""
    data = io.BytesIO(file.read_bytes())
    for _ in range(*_take(data, "<Q")):
        yield data
    if data.read(1):
        raise ValueError("bytes follow the last entry")


def _take(data: io.BytesIO, form: str) -> tuple:
    return struct.unpack(form, data.read(struct.calcsize(form)))


def _array(data: io.BytesIO, dtype: np.dtype, count: int) -> np.ndarray:
    return np.frombuffer(data.read(count * dtype.itemsize), dtype, count)


def _name(data: io.BytesIO) -> str:
    """UTF-8, ended by 0."""
    begin, whole = data.tell(), data.getvalue()
    name = whole[begin : whole.index(b"\0", begin, begin + LONGEST_NAME)]
    data.seek(begin + len(name) + 1)
    return name.decode()


def _lenses(file: Path) -> Iterator[tuple[int, Camera]]:
    """cameras.bin: count u64; each: id u32, model i32, width u64, height u64, parameters f64."""
    for data in _entries(file):
        number, model, width, height = _take(data, "<IiQQ")
        name = NAMES[model] if 0 <= model < len(NAMES) else f"model number {model}"
        values = _array(data, NUMBER, len(MODELS[name].parameters) if name in MODELS else 0)
        yield _lens(number, name, (width, height), values, file)


def _images(file: Path) -> Iterator[_Image]:
    """images.bin: count u64; each: id u32, pose 7 f64, camera u32, name ended by 0, count u64, each (x, y) f64 and id u64."""
    for data in _entries(file):
        _, *placed, camera = _take(data, "<I7dI")
        name, (count,) = _name(data), _take(data, "<Q")
        shown = _array(data, KEYPOINT, count)["point"]
        yield _Image(name, camera, _pose(file, name, placed), shown[shown >= 0])


def _points(file: Path) -> Iterator[tuple[float, ...]]:
    """points3D.bin: count u64; each: id u64, place 3 f64, colour 3 u8, error f64, count u64, each image u32 and index u32."""
    for data in _entries(file):
        *point, _, count = _take(data, "<q3d3BdQ")
        _array(data, TRACK_ELEMENT, count)
        yield (*point, count)


# --- text -------------------------------------------------------------------------------------------------------------


def _lines(file: Path) -> Iterator[bytes]:
    """The lines that say something; of images, also those that list no points."""
    data = file.read_bytes().removeprefix(BYTE_ORDER_MARK)
    yield from (line.strip() for line in data.split(b"\n") if not line.startswith(b"#"))


def _lenses_of_text(file: Path) -> Iterator[tuple[int, Camera]]:
    """cameras.txt: id, model, width, height, parameters."""
    for line in filter(None, _lines(file)):
        number, model, width, height, *values = line.split()
        number, width, height, *values = _numbers([number, width, height, *values])
        yield _lens(int(number), model.decode("ascii", errors="replace"), (width, height), np.array(values), file)


def _images_of_text(file: Path) -> Iterator[_Image]:
    """images.txt: id, pose, camera, name; and in the next line x, y, id of each point, if any."""
    lines = _lines(file)
    for line in lines:
        if line:
            *values, name = line.split(None, 9)
            if len(name) > LONGEST_NAME:
                raise ValueError(f"a name of {len(name)} bytes")
            _, *placed, camera = _numbers(values)
            shown = _numbers(next(lines, b"").split())[2::3].astype(np.int64)
            yield _Image(name.decode(), int(camera), _pose(file, name.decode(), placed), shown[shown >= 0])


def _points_of_text(file: Path) -> Iterator[tuple[float, ...]]:
    """points3D.txt: id, place, colour, error; image and index of each that shows it."""
    for line in filter(None, _lines(file)):
        words = line.split()
        number, x, y, z, red, green, blue, _ = _numbers(words[:8])
        yield number, x, y, z, red, green, blue, (len(words) - 8) // 2


def _numbers(words: list[bytes]) -> np.ndarray:
    numbers = np.array(words, np.float64)
    if not (np.abs(numbers) < 2**53).all():
        raise ValueError(f"a line with {b' '.join(words)[:40].decode(errors='replace')}")
    return numbers


READERS = {".bin": (_lenses, _images, _points), ".txt": (_lenses_of_text, _images_of_text, _points_of_text)}


def _damaged(where: Path, found: str) -> UserError:
    return UserError("not a COLMAP reconstruction, or a damaged one", where=where, found=found,
                     remedy="copy it again, or run COLMAP again")  # fmt: skip
