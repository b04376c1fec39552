"""COLMAP's binary reconstruction on disk, read through pycolmap into plain arrays.

Notation: N posed images, M points. COLMAP's cameras look along +z with y down, and their pixel centres lie at +0.5, as ours
do; its poses are camera_T_world. The file format is that of COLMAP's documentation, "Output Format", binary.

pycolmap believes counts and text lengths, so that a damaged file makes it hang or eat all memory. Before it is asked,
the lengths of the three files are held against what they say they contain.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from training.scenes.poses import pose

FILES = ("cameras.bin", "images.bin", "points3D.bin")
# model: (its number in cameras.bin, where fx, fy, cx, cy stand among its parameters, likewise k1, k2, p1, p2)
MODELS: dict[str, tuple[int, tuple[int, ...], tuple[int, ...]]] = {
    "SIMPLE_PINHOLE": (0, (0, 0, 1, 2), ()),
    "PINHOLE": (1, (0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": (2, (0, 0, 1, 2), (3,)),
    "RADIAL": (3, (0, 0, 1, 2), (3, 4)),
    "OPENCV": (4, (0, 1, 2, 3), (4, 5, 6, 7)),
}
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # y down and z ahead become y up and z back


@dataclass(frozen=True)
class Lens:
    """width, height, fx, fy, cx, cy: pixels. distortion: k1, k2, p1, p2."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float]


@dataclass(frozen=True)
class Reconstruction:
    """Posed images, sorted by name, and points, in COLMAP's own frame and units.

    names [N], lenses [N], world_T_camera [N, 4, 4] (OpenGL axes). points [M, 3]; tracks [M]: how many images show each.
    seen: of each image the rows of `points` that it shows. unposed: names of images that the files list without a pose.
    """

    names: tuple[str, ...]
    lenses: tuple[Lens, ...]
    world_T_camera: np.ndarray
    points: np.ndarray
    tracks: np.ndarray
    seen: tuple[np.ndarray, ...]
    unposed: tuple[str, ...]

    def only(self, rows: list[int]) -> Reconstruction:
        """The same points with these images alone."""
        names, lenses, seen = (tuple(values[row] for row in rows) for values in (self.names, self.lenses, self.seen))
        return replace(self, names=names, lenses=lenses, seen=seen, world_T_camera=self.world_T_camera[rows])


def read_reconstruction(folder: Path) -> Reconstruction:
    """What cameras.bin, images.bin and points3D.bin in `folder` say. UserError where pycolmap or a file is missing, a file
    is damaged, a lens model is none that we can undistort, or nothing has a pose.
    """
    for name in FILES:
        if not (folder / name).is_file():
            raise UserError("this part of the reconstruction is missing", where=folder / name)
    stats = [(folder / name).stat() for name in FILES]
    return _read(folder, tuple((stat.st_mtime_ns, stat.st_size) for stat in stats))


@lru_cache(maxsize=1)  # a scene is read once for each downscale that is considered
def _read(folder: Path, stamp: tuple[tuple[int, int], ...]) -> Reconstruction:
    pycolmap = _pycolmap(folder)
    _check_cameras(folder / "cameras.bin", pycolmap)
    _check_images(folder / "images.bin")
    _check_points(folder / "points3D.bin")
    try:
        read = pycolmap.Reconstruction(folder)
    except (ValueError, IndexError, KeyError, MemoryError, OSError, RuntimeError) as error:
        raise _damaged(folder, str(error).rsplit("] ", 1)[-1][:100]) from error
    images = sorted(read.images.values(), key=lambda image: image.name)
    posed = [image for image in images if image.has_pose]
    if not posed:
        raise UserError("the reconstruction is empty: no image has a pose", where=folder,
                        remedy="COLMAP found nothing to match; photographs need more overlap")  # fmt: skip
    ids = np.array(sorted(read.points3D), np.int64)
    points = [read.points3D[int(number)] for number in ids]
    return Reconstruction(
        names=tuple(image.name for image in posed),
        lenses=tuple(_lens(read.cameras[image.camera_id], folder / "cameras.bin") for image in posed),
        world_T_camera=np.stack([_world_T_camera(image, folder / "images.bin") for image in posed]),
        points=np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
        tracks=np.array([point.track.length() for point in points], np.float64),
        seen=tuple(_seen(image, ids) for image in posed),
        unposed=tuple(image.name for image in images if not image.has_pose),
    )


def _pycolmap(folder: Path) -> Any:
    try:
        import pycolmap
    except ImportError as error:
        raise UserError(
            "a COLMAP scene is read through pycolmap, which is not installed",
            where=folder,
            remedy="pip install 'snerg[colmap]'",
        ) from error
    return pycolmap


def _world_T_camera(image: Any, file: Path) -> np.ndarray:
    found = image.cam_from_world
    pose_found: Any = found() if callable(found) else found  # a method since pycolmap 3.12
    camera_T_world = np.eye(4)
    camera_T_world[:3] = pose_found.matrix()
    where = f"{file} {image.name}"
    return pose(np.linalg.inv(pose(camera_T_world, where)) @ OPENGL_FROM_OPENCV, where)


def _lens(camera: Any, file: Path) -> Lens:
    _, intrinsics, distortion = MODELS[camera.model.name]
    values = np.array(camera.params, np.float64)
    fx, fy, cx, cy = (float(values[i]) for i in intrinsics)
    if not np.isfinite(values).all() or min(fx, fy) <= 0 or min(camera.width, camera.height) < 1:
        raise UserError(
            f"size and focal length of camera {camera.camera_id} must be positive numbers",
            where=file,
            found=f"{camera.width}x{camera.height}, {camera.params_to_string()}",
        )
    k1, k2, p1, p2 = (*(float(values[i]) for i in distortion), 0.0, 0.0, 0.0, 0.0)[:4]
    return Lens(int(camera.width), int(camera.height), fx, fy, cx, cy, (k1, k2, p1, p2))


def _seen(image: Any, ids: np.ndarray) -> np.ndarray:
    """Rows in `ids` (sorted) of the points that an image shows."""
    shown = np.array([found.point3D_id for found in image.points2D if found.has_point3D()], np.int64)
    return np.searchsorted(ids, shown)


# --- do the files hold what they say? --------------------------------------------------------------------------------


def _check_cameras(file: Path, pycolmap: Any) -> None:
    """cameras.bin: count u64; each: id u32, model i32, width u64, height u64, parameters f64."""
    data = file.read_bytes()
    names = {number: name for name, (number, _, _) in MODELS.items()}
    at = 8
    for _ in range(_count(data, file)):
        (model,) = _unpack("<4xi16x", data, at, file)
        if model not in names:
            raise UserError(
                "this lens model is not supported",
                where=file,
                expected=", ".join(MODELS),
                found=_model_name(pycolmap, model),
                remedy="undistort the pictures with COLMAP first (colmap image_undistorter)",
            )
        _, intrinsics, distortion = MODELS[names[model]]
        at += 24 + 8 * (max(intrinsics) + 1 + len(distortion))
    _check_end(at, data, file)


def _model_name(pycolmap: Any, number: int) -> str:
    known = pycolmap.CameraModelId.__members__.values()
    return next((model.name for model in known if int(model) == number and number >= 0), f"model number {number}")


def _check_images(file: Path) -> None:
    """images.bin: count u64; each: id u32, pose 7 f64, camera u32, name ended by 0, count u64, each (x, y) f64 and id u64."""
    data = file.read_bytes()
    at = 8
    for _ in range(_count(data, file)):
        end = data.find(b"\0", at + 64)
        if end < 0:
            raise _damaged(file, "it ends within a name")
        (points,) = _unpack("<Q", data, end + 1, file)
        at = end + 9 + 24 * points
    _check_end(at, data, file)


def _check_points(file: Path) -> None:
    """points3D.bin: count u64; each: id u64, place 3 f64, colour 3 u8, error f64, count u64, each image u32 and index u32."""
    data = file.read_bytes()
    at = 8
    for _ in range(_count(data, file)):
        (track,) = _unpack("<43xQ", data, at, file)
        at += 51 + 8 * track
    _check_end(at, data, file)


def _count(data: bytes, file: Path) -> int:
    return _unpack("<Q", data, 0, file)[0]


def _unpack(form: str, data: bytes, at: int, file: Path) -> tuple[int, ...]:
    try:
        return struct.unpack_from(form, data, at)
    except (struct.error, OverflowError) as error:
        raise _damaged(file, "it ends too early") from error


def _check_end(at: int, data: bytes, file: Path) -> None:
    if at != len(data):
        raise _damaged(file, f"{len(data):,} bytes where its contents take {at:,}")


def _damaged(where: Path, found: str) -> UserError:
    return UserError("not a COLMAP reconstruction, or a damaged one", where=where, found=found,
                     remedy="copy it again, or run COLMAP again")  # fmt: skip
