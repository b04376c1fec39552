"""Scenes in transforms.json (nerfstudio, instant-ngp) and transforms_{train,val,test}.json (NeRF-synthetic, Blender).

A description lists frames: picture, pose (OpenGL camera-to-world) and camera. A frame's own keys win over those at the top.
Its keys are focal lengths, principal point, size, distortion and lens model. Lenses and options that are not understood are
refused by name. docs/scenes.md has the table of keys.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from plyfile import PlyData, PlyParseError

from console import UserError
from console.json_text import read_json_file
from training.scenes import space
from training.scenes.files import FileFinder, clean_name, few, find_masks, notice, without_suffix
from training.scenes.lens import EQUIRECTANGULAR, FISHEYE, MODELS, PERSPECTIVE
from training.scenes.photographs import moved, photograph_of, tell_turned
from training.scenes.pictures import PictureLoader
from training.scenes.pixels import may_be_transparent
from training.scenes.poses import finite_numbers, pose
from training.scenes.scene import HELD_OUT_BY_NAME, Camera, Photograph, Scene, camera_of, hold_out
from training.scenes.scene_options import SceneOptions
from training.scenes.space import Frame, PointCloud

LEAST_ANGLE = 1e-6  # radians
LENSES = MODELS | {"PERSPECTIVE": MODELS["OPENCV"]}
# The keys of a lens's coefficients, by projection; a model's parameters beyond these are those of FULL_OPENCV.
KEYS = {
    PERSPECTIVE: {"k1": "k1", "k2": "k2", "p1": "p1", "p2": "p2", "k3": "k3"},
    FISHEYE: {"k1": "k1", "k2": "k2", "p1": "p1", "p2": "p2", "k3": "k3", "k4": "k4", "s1": "sx1", "s2": "sy1"},
    EQUIRECTANGULAR: {},
}
RATIONAL = {"q1": "k4", "q2": "k5", "q3": "k6"}
# All keys that change a lens, in the files of any program.
ALL_KEYS = (
    "fisheye", "equirectangular", "latlong", "orthographic", "ftheta_p0", "ftheta_p1",
    "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "sx1", "sy1", "omega", "xi", "alpha",
)  # fmt: skip
FOCAL_KEYS = ("fl_x", "fl_y", "x_fov", "y_fov", "camera_angle_x", "camera_angle_y")


def read_camera(world_T_camera: np.ndarray, values: dict[str, Any], size: tuple[int, int], where: str) -> Camera:
    """The camera of a frame, for pictures of the w x h that is named, else of `size`. UserError for lenses we cannot read."""
    name = values.get("camera_model") or ("OPENCV_FISHEYE" if values.get("is_fisheye") else "OPENCV")
    model = LENSES.get(name.upper()) if isinstance(name, str) else None
    keys = KEYS[model.projection] if model is not None else {}
    keys = keys | RATIONAL if model is MODELS["FULL_OPENCV"] else keys
    others = [key for key in ALL_KEYS if key not in keys.values() and values.get(key)]
    if model is None or others:
        raise UserError("this lens model is not supported", where=where, expected=", ".join(LENSES),
                        found=", ".join([str(name)[:40], *others]), remedy="undistort the pictures first")  # fmt: skip
    width, height = (number(values, key, where, float(side)) for key, side in zip("wh", size, strict=True))
    named = {name: number(values, key, where, 0.0) for name, key in keys.items()}
    named |= {"cx": number(values, "cx", where, width / 2), "cy": number(values, "cy", where, height / 2)}
    if model.projection != EQUIRECTANGULAR:
        is_flat = model.projection == PERSPECTIVE
        lengths = {key: value for key, value in values.items() if is_flat or key in ("fl_x", "fl_y")}
        named["fx"], named["fy"] = _focal_lengths(lengths, width, height, where)
    return camera_of(model, named, (width, height), world_T_camera, where)


def _focal_lengths(values: dict[str, Any], width: float, height: float, where: str) -> tuple[float, float]:
    """fx and fy in pixels; one that is not named is as the other. Lengths win over angles of view, degrees over radians."""
    found = [number(values, key, where) for key in ("fl_x", "fl_y") if key in values]
    for axis, side in (("x", width), ("y", height)) if not found else ():
        key, unit, most = f"{axis}_fov", np.pi / 180, 180.0
        if key not in values:
            key, unit, most = f"camera_angle_{axis}", 1.0, np.pi
        if key in values:
            angle = number(values, key, where)
            if not LEAST_ANGLE < angle < most - LEAST_ANGLE:
                raise UserError(f"{key} is not a field of view", where=where, expected=f"0 to {most:.4g}", found=angle)
            found.append(0.5 * side / float(np.tan(0.5 * unit * angle)))
    if not found:
        expected = "fl_x, or of a perspective lens camera_angle_x"
        raise UserError("no focal length", where=where, expected=expected, found="neither")
    return found[0], found[-1]


def number(values: dict[str, Any], key: str, where: str | Path, default: float | None = None) -> float:
    """A finite number under a key. UserError where it is missing (without default) or no number."""
    value = values.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise UserError(f'"{key}" is not a number', where=where, found="nothing" if value is None else repr(value)[:60])
    return float(value)


LOOKED_FOR = "transforms_train.json (Blender), transforms.json (nerfstudio, instant-ngp)"
SPLITS = ("train", "val", "test")
MOST_POINTS = 50_000  # that near, far and box are derived from
MOST_PLY_BYTES = 1 << 30
NGP_SCALE, NGP_OFFSET = 0.33, 0.5  # instant-ngp's box has the side aabb_scale about 0.5, in units of p · scale + offset

OTHER_POSES = ("from_mitsuba", "from_na")  # instant-ngp: matrices of another convention
UNREAD = {
    **dict.fromkeys(("transform_matrix_start", "transform_matrix_end"), "motion during the exposure"),
    "rolling_shutter": "rolling shutter",
    "white_transparent": "white as transparent",
    "black_transparent": "black as transparent",
    "mask_color": "a colour as transparent",
}


class _Frame(NamedTuple):
    """A frame whose picture is there."""

    name: str
    picture: Path
    world_T_camera: np.ndarray
    values: dict[str, Any]  # its own keys over those at the top
    own_focal: bool  # whether it names its own focal length


def recognises(path: Path) -> bool:
    """Whether the folder looks like a scene of either layout; LLFF's own poses win over transforms.json."""
    captured = (path / "transforms.json").is_file() and not (path / "poses_bounds.npy").is_file()
    return (path / "transforms_train.json").is_file() or captured


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads the cameras and the headers of the pictures; these are decoded when asked for."""
    return (_read_synthetic if (path / "transforms_train.json").is_file() else _read_capture)(path, options)


def _read_synthetic(path: Path, options: SceneOptions) -> Scene:
    """NeRF-synthetic: a description for each split, an object before nothing."""
    splits: dict[str, tuple[Photograph, ...]] = {}
    finder, trained_on = FileFinder(path), set()
    for split in SPLITS:
        description = path / f"transforms_{split}.json"
        if not description.is_file():
            continue
        try:
            frames = _read_frames(description, _read_json(description), finder)
        except _NothingThere as nothing:
            if split == "train":
                raise
            notice(None, f"{nothing}; there is no split {split}")
            continue
        repeated = [frame.name for frame in frames if frame.picture in trained_on]
        notice(description, f"{len(repeated)} of {len(frames)} frames are trained on and not held out", repeated)
        frames = [frame for frame in frames if frame.picture not in trained_on]
        if split == "train":
            trained_on = {frame.picture for frame in frames}
        if frames:
            photographs = _photographs(path, description, frames, options)
            splits[split] = tuple(replace(one, name=without_suffix(one.name)) for one in photographs)
    frame = space.frame_of_object([photograph.camera for photograph in splits["train"]])
    splits = {split: moved(photographs, frame) for split, photographs in splits.items()}
    cameras = [photograph.camera for photograph in splits["train"]]
    found = space.space_of_object(cameras, opaque=not may_be_transparent(splits["train"]))
    held_out = "as transforms_test.json lists them" if "test" in splits else ""
    return Scene(**vars(found), path=path, kind="blender", splits=splits, held_out=held_out)


def _read_capture(path: Path, options: SceneOptions) -> Scene:
    """nerfstudio and instant-ngp: one description, with splits or without."""
    description = path / "transforms.json"
    document = _read_json(description)
    frames = _read_frames(description, document, FileFinder(path, path / "images"))
    photographs = _photographs(path, description, sorted(frames, key=lambda frame: frame.name), options)
    frame = space.frame_about_focus(space.viewing_poses([photograph.camera for photograph in photographs]))
    photographs = moved(photographs, frame)
    cameras = [photograph.camera for photograph in photographs]
    file_box = _box_of_file(document, description, frame)
    points = _points(path, document, cameras, frame)
    opaque = not may_be_transparent(photographs)
    found = space.space_of_capture(cameras, points, opaque=opaque, file_box=file_box)
    if file_box is not None and points is None and not ((file_box[0] < 0).all() and (file_box[1] > 0).all()):
        notice(description, "its aabb, scale and offset name a box that the cameras do not look at, which is not used")
    splits, held_out = _split(description, document, photographs)
    return Scene(**vars(found), path=path, kind="transforms", splits=splits, held_out=held_out)


class _NothingThere(UserError):
    """A description without frames, or without pictures or poses of them."""


def _read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file. UserError where there is none, naming line and column."""
    try:
        document = read_json_file(path)
    except (ValueError, OSError) as error:
        raise UserError("not JSON", where=path, found=error) from error
    if not isinstance(document, dict):
        raise UserError("not a scene description", where=path, expected="an object", found=type(document).__name__)
    return document


def _read_frames(description: Path, document: dict[str, Any], finder: FileFinder) -> list[_Frame]:
    """The frames that have a pose and a picture, each picture once; a Notice of the others, and of what is not read."""
    listed = document.get("frames")
    if not isinstance(listed, list) or not listed:
        found = "none" if not listed else type(listed).__name__
        raise _NothingThere("no frames", where=description, expected='a list under "frames"', found=found)
    names = []
    for index, frame in enumerate(listed):
        name = frame.get("file_path") if isinstance(frame, dict) else None
        if not isinstance(name, str) or not clean_name(name):
            raise UserError("a frame without file_path", where=f"{description} frame {index}", found=repr(name)[:60])
        names.append(clean_name(name))
    pictures = finder.find_all([frame["file_path"] for frame in listed])
    _tell_unread(description, document, listed, pictures)
    gone = [name for name, picture in zip(names, pictures, strict=True) if picture is None]
    if len(gone) == len(listed):
        raise _NothingThere("picture not found", where=description.parent / gone[0], remedy="no frame has its picture")
    notice(description, f"{len(gone)} of {len(listed)} frames have no picture and are left out", gone)
    posed = [frame.get("transform_matrix") is not None for frame in listed]
    if not any(has_pose and picture for has_pose, picture in zip(posed, pictures, strict=True)):
        raise _NothingThere("no picture has a pose", where=description, expected="a transform_matrix of each frame")
    unposed = [name for name, has_pose in zip(names, posed, strict=True) if not has_pose]
    notice(description, f"{len(unposed)} of {len(listed)} frames have no transform_matrix and are left out", unposed)
    frames: dict[Path, _Frame] = {}
    repeated = []
    for index, (name, picture, listed_frame) in enumerate(zip(names, pictures, listed, strict=True)):
        if picture is None or not posed[index]:
            continue
        where = f"{description} frame {index} ({name})"
        own_focal = any(key in listed_frame for key in FOCAL_KEYS)
        above = {key: value for key, value in document.items() if not (own_focal and key in FOCAL_KEYS)}
        world_T_camera = pose(listed_frame.get("transform_matrix"), where)
        frame = _Frame(name, picture, world_T_camera, above | listed_frame, own_focal)
        known = frames.setdefault(picture, frame)
        if not np.allclose(known.world_T_camera, world_T_camera, atol=1e-6):
            raise UserError("two frames have one picture and different poses", where=where, found=str(picture))
        if known is not frame:
            repeated.append(name)
    notice(description, f"{len(repeated)} frames repeat another and are left out", repeated)
    return list(frames.values())


def _tell_unread(description: Path, document: dict, frames: Sequence[dict], pictures: Sequence[Path | None]) -> None:
    """UserError where poses are of another convention; a Notice of what is known and not read."""
    for key in filter(document.get, OTHER_POSES):
        raise UserError(f'"{key}" is not read', where=description, expected="OpenGL camera-to-world matrices",
                        remedy="convert the matrices and remove the key")  # fmt: skip
    texts = [document, *frames]
    used = [key for key in UNREAD if any(np.any(np.asarray(text.get(key), object)) for text in texts)]
    unread = [f'"{key}" ({UNREAD[key]})' for key in used]
    folders = {picture.parent for picture in pictures if picture is not None}
    if any(next(folder.glob("dynamic_mask_*"), None) is not None for folder in folders):
        unread.append("dynamic_mask_* (masks of what moves)")
    if unread:
        notice(description, f"not read, and ignored: {', '.join(unread)}")


def _photographs(path: Path, description: Path, frames: list[_Frame], options: SceneOptions) -> tuple[Photograph, ...]:
    masks = _masks(path, frames) if options.masks else [None] * len(frames)
    photographs, shape = [], None
    for frame, mask in zip(frames, masks, strict=True):
        read = partial(read_camera, frame.world_T_camera, frame.values, where=f"{description} frame {frame.name}")
        own_shape = frame.own_focal or {"w", "h"} <= frame.values.keys()
        one = photograph_of(frame.name, frame.picture, read, mask, 1, options.downscale, None if own_shape else shape)
        photographs.append(one)
        if not own_shape:  # one focal length without a size is of pictures of one shape
            assert isinstance(one.load, PictureLoader)
            shape = shape or one.load.source_size
    tell_turned(description, photographs)
    return tuple(photographs)


def _masks(path: Path, frames: Sequence[_Frame]) -> list[Path | None]:
    """The mask of each frame, by its mask_path or in the folder masks. UserError where one has none."""
    named = [mask if isinstance(mask := frame.values.get("mask_path"), str) else "" for frame in frames]
    beside = find_masks(path / "masks", [frame.name.removeprefix("images/") for frame in frames])
    masks = [mask or other for mask, other in zip(FileFinder(path).find_all(named), beside, strict=True)]
    if None in masks:
        without = path / frames[masks.index(None)].name
        raise UserError("a frame without a mask", where=without, remedy="leave out --masks")
    return masks


def _box_of_file(document: dict[str, Any], description: Path, frame: Frame) -> np.ndarray | None:
    """instant-ngp's box [2, 3] in the training frame, where the file names any of aabb, scale, offset and aabb_scale."""
    if not any(key in document for key in ("aabb", "scale", "offset", "aabb_scale")):
        return None
    scale, offset = number(document, "scale", description, NGP_SCALE), np.full(3, NGP_OFFSET)
    if "offset" in document:
        offset = _triples(document["offset"], 1, "offset", description)[0]
    if "aabb" in document:  # becomes the unit cube
        low, high = _triples(document["aabb"], 2, "aabb", description)
        scale = 1.0 / max(float(np.abs(high - low).max()), 1e-6)
        offset = 0.5 - 0.5 * (low + high) * scale
    side = number(document, "aabb_scale", description, 1.0)
    if scale <= 0 or side <= 0:
        raise UserError("scale and aabb_scale must be positive", where=description, found=f"{scale:g}, {side:g}")
    half = 0.5 * side / scale * frame.scale
    middle = frame.points((0.5 - offset) / scale)
    return np.stack([middle - half, middle + half])


def _triples(value: Any, count: int, key: str, description: Path) -> np.ndarray:
    """`count` triples of finite numbers [count, 3] under a key. UserError for anything else."""
    if (numbers := finite_numbers(value, 3 * count)) is None:
        raise UserError(f'"{key}" is no list of {3 * count} numbers', where=description, found=repr(value)[:60])
    return numbers.reshape(count, 3)


def _points(path: Path, document: dict[str, Any], cameras: Sequence[Camera], frame: Frame) -> PointCloud | None:
    """The sparse points that the file names (nerfstudio's ply_file_path), in the training frame; None where they tell nothing."""
    named = document.get("ply_file_path")
    if not isinstance(named, str) or not os.path.isfile(path / named):  # Path.is_file raises where a name is too long
        return None
    try:
        places = read_ply(path / named)
    except UserError as error:
        notice(None, f"{error}; its points are not used")
        return None
    places = frame.points(places[:: -(-len(places) // MOST_POINTS) or 1])
    points = PointCloud(places, np.ones(len(places)), [space.rows_in_picture(camera, places) for camera in cameras])
    return points if points.suffices else None


def read_ply(path: Path) -> np.ndarray:
    """The finite places float64 [M, 3] of the vertices of a PLY file. UserError for anything else."""
    try:
        if path.stat().st_size > MOST_PLY_BYTES:
            raise ValueError(f"more than {MOST_PLY_BYTES >> 20} MiB")
        vertices = PlyData.read(str(path))["vertex"]
        places = np.stack([vertices[axis] for axis in "xyz"], axis=-1).astype(np.float64)
    except (OSError, ValueError, LookupError, TypeError, ArithmeticError, MemoryError, PlyParseError) as error:
        raise UserError("not a PLY file of points, or a damaged one", where=path, found=str(error)[:80]) from error
    return places[np.isfinite(places).all(-1)]


def _split(
    description: Path, document: dict[str, Any], photographs: tuple[Photograph, ...]
) -> tuple[dict[str, tuple[Photograph, ...]], str]:
    """The photographs by split, and what decided: lists of the file, else names."""
    lists = {split: document[f"{split}_filenames"] for split in SPLITS if document.get(f"{split}_filenames")}
    if not lists:
        return hold_out(photographs), HELD_OUT_BY_NAME
    known = {photograph.name for photograph in photographs}
    listed: dict[str, set[str]] = {}
    for split, names in lists.items():
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise UserError(f'"{split}_filenames" is no list of names', where=description, found=repr(names)[:60])
        cleaned = [clean_name(name) for name in names]
        unknown = [name for name in cleaned if name not in known]
        if len(unknown) == len(names) and split == "train":
            raise UserError('"train_filenames" names no frame', where=description, found=few(unknown),
                            expected=f"names such as {photographs[0].name}")  # fmt: skip
        notice(description, f"{len(unknown)} of {len(names)} {split}_filenames name no frame", unknown)
        listed[split] = known.intersection(cleaned)
    held_out = {name for split, names in listed.items() if split != "train" for name in names}
    train = listed.get("train", known - held_out)
    both = sorted(held_out & train)
    notice(description, f"{len(both)} frames are listed for training and for testing, and are trained on", both)
    if left_out := len(known - train - held_out):
        notice(description, f"{left_out} frames are in no split and are left out")
    if not train:
        raise UserError("no frame is left to train on", where=description, expected="some in no other split")
    kept = {split: names - train for split, names in listed.items()} | {"train": train}
    splits = {s: tuple(one for one in photographs if one.name in kept[s]) for s in SPLITS if kept.get(s)}
    return splits, f"as {description.name} lists them"
