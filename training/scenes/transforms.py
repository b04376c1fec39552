"""nerfstudio and instant-ngp scenes: transforms.json with fl_x, fl_y, cx, cy, w, h and lens distortion k1, k2, p1, p2.

Intrinsics stand at the top or in a frame, which wins. Poses are OpenGL camera-to-world. We move the point that the
cameras look at to the origin, turn their mean up direction to z, and make their mean distance 1. Distortion stays
with the cameras: rays are undistorted, pictures are not. Frames whose picture is gone are left out (instant-ngp's
own do that).
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from console import Notice, UserError
from training.scenes.blender import WORLDSPACE_T_OPENGL
from training.scenes.pictures import PictureLoader, picture_size, shrunk_size
from training.scenes.poses import (
    field_of_view,
    focus_point,
    frames_of,
    number,
    pose,
    read_json,
    similarity,
    upright_axes,
)
from training.scenes.scene import Camera, Photograph, Scene, SceneOptions, hold_out

LOOKED_FOR = "transforms.json (nerfstudio, instant-ngp)"
NEAR, FAR = 0.1, 100.0  # in units of the cameras' mean distance
HALF_SIDE = 1.5  # of the box that holds the content, likewise, where the file does not say
NGP_SCALE = 0.33  # instant-ngp's units per unit of the file; its box has aabb_scale of its units a side
PICTURES = (".png", ".jpg", ".jpeg")
UNSUPPORTED = ("k3", "k4")


def recognises(path: Path) -> bool:
    """Whether the folder looks like a nerfstudio or instant-ngp scene."""
    return (path / "transforms.json").is_file()


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads the frames that have a picture; every 8th is held out unless the file names its splits."""
    description = path / "transforms.json"
    document = read_json(description)
    frames = sorted(frames_of(document, description), key=lambda frame: frame["file_path"])
    found = [(frame, picture) for frame in frames if (picture := _picture_path(path, frame["file_path"])) is not None]
    if not found:
        raise UserError("picture not found", where=path / frames[0]["file_path"], remedy="no frame has its picture")
    if len(found) < len(frames):
        message = f"{description}: {len(frames) - len(found)} of {len(frames)} frames have no picture and are left out"
        warnings.warn(Notice(message), stacklevel=2)
    P = np.stack([pose(f.get("transform_matrix"), f"{description} frame {f['file_path']}") for f, _ in found])
    P, scale, centre, axes = normalise(P)
    photographs = []
    for matrix, (frame, picture) in zip(P, found, strict=True):
        stored = picture_size(picture)
        size = shrunk_size(*stored, options.downscale)
        camera = read_camera(matrix, {**document, **frame}, stored, f"{description} frame {frame['file_path']}")
        mask = _mask_path(path, frame) if options.masks else None
        loader = PictureLoader(picture, stored, size, mask)
        photographs.append(Photograph(Path(frame["file_path"]).as_posix(), camera.resized(*size), loader))
    return Scene(
        path=path,
        kind="transforms",
        splits=_splits(document, photographs),
        near=NEAR,
        far=FAR,
        disparity=True,
        aabb=_box(document, description, scale, centre, axes),
        worldspace_T_opengl=WORLDSPACE_T_OPENGL,
        notes=vars(options),
    )


def normalise(P: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Poses about the point they look at, z up, at mean distance 1; and the scale, centre and axes [3, 3] used."""
    positions = P[:, :3, 3]
    try:
        centre = focus_point(P)
    except np.linalg.LinAlgError:
        centre = None
    # a focus behind the cameras is none: take the middle of them then
    if centre is None or np.mean(((centre - positions) * -P[:, :3, 2]).sum(-1) > 0) < 0.5:
        centre = positions.mean(0)
    distance = np.linalg.norm(positions - centre, axis=-1).mean()
    scale = 1.0 / distance if distance > 1e-9 else 1.0
    axes = upright_axes(P[:, :3, 1].mean(0)) if np.linalg.norm(P[:, :3, 1].mean(0)) > 1e-3 else np.eye(3)
    return similarity(axes, centre, scale, P), scale, centre, axes


def read_camera(world_T_camera: np.ndarray, values: dict[str, Any], stored: tuple[int, int], where: str) -> Camera:
    """The camera of a frame for its stored picture, whose size may be a whole fraction of the w x h that is named."""
    model = str(values.get("camera_model", "OPENCV")).upper()
    if "FISHEYE" in model or values.get("is_fisheye") or any(values.get(k) for k in UNSUPPORTED):
        raise UserError(
            "this lens model is not supported",
            where=where,
            expected="k1, k2, p1, p2",
            found=model,
            remedy="undistort the pictures first",
        )
    place = Path(where)
    width, height = (number(values, key, place, float(size)) for key, size in zip("wh", stored, strict=True))
    if min(width, height) < 1:
        raise UserError("w and h must be pixels, at least 1", where=where, found=f"{width:g}x{height:g}")
    if abs(stored[0] / stored[1] - width / height) > 0.01 * width / height:
        raise UserError(
            "the picture is of another size",
            where=where,
            expected=f"{width:.0f}x{height:.0f}",
            found=f"{stored[0]}x{stored[1]}",
        )
    fx, fy = _focal_lengths(values, width, height, place)
    camera = Camera(
        world_T_camera,
        round(width),
        round(height),
        fx,
        fy,
        number(values, "cx", place, width / 2),
        number(values, "cy", place, height / 2),
        tuple(number(values, key, place, 0.0) for key in ("k1", "k2", "p1", "p2")),  # type: ignore[arg-type]
    )
    return camera.resized(*stored)


def _focal_lengths(values: dict[str, Any], width: float, height: float, place: Path) -> tuple[float, float]:
    if "fl_x" in values:
        fx = number(values, "fl_x", place)
        fy = number(values, "fl_y", place, fx)
    else:
        fx = 0.5 * width / np.tan(0.5 * field_of_view(values, "camera_angle_x", place))
        tall = "camera_angle_y" in values
        fy = 0.5 * height / np.tan(0.5 * field_of_view(values, "camera_angle_y", place)) if tall else fx
    if fx <= 0 or fy <= 0:
        raise UserError("the focal length must be positive", where=place, found=f"{fx:g}, {fy:g}")
    return float(fx), float(fy)


def _box(document: dict, description: Path, scale: float, centre: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The box of the content: instant-ngp's where aabb_scale names it, else a cube about the focus."""
    if "aabb_scale" not in document:
        return np.array([[-HALF_SIDE] * 3, [HALF_SIDE] * 3])
    half = 0.5 * number(document, "aabb_scale", description) / NGP_SCALE * scale
    middle = -scale * centre @ axes  # instant-ngp's box stands about the file's origin
    return np.stack([middle - half, middle + half])


def _splits(document: dict[str, Any], photographs: list[Photograph]) -> dict[str, tuple[Photograph, ...]]:
    named = {s: document.get(f"{s}_filenames") for s in ("train", "val", "test")}
    if not isinstance(named["train"], list):
        return hold_out(photographs)
    splits = {}
    for split, names in named.items():
        chosen = tuple(p for p in photographs if isinstance(names, list) and p.name in names)
        if chosen:
            splits[split] = chosen
    return splits if "train" in splits else hold_out(photographs)


def _picture_path(path: Path, file_path: str) -> Path | None:
    named = path / file_path
    candidates = [named] if named.suffix.lower() in PICTURES else [named.with_name(named.name + s) for s in PICTURES]
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def _mask_path(path: Path, frame: dict[str, Any]) -> Path:
    mask = frame.get("mask_path")
    if not isinstance(mask, str) or not (path / mask).is_file():
        raise UserError("a frame without a mask", where=frame["file_path"], remedy="leave out --masks")
    return path / mask
