"""Cameras from the keys of transforms.json: focal lengths, principal point, size, distortion and lens model (docs/scenes.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from training.scenes.lens import EQUIRECTANGULAR, FISHEYE, MODELS, PERSPECTIVE
from training.scenes.scene import Camera

LEAST_ANGLE = 1e-6  # radians
LENSES = MODELS | {"PERSPECTIVE": MODELS["OPENCV"]}
# The keys of a lens's coefficients, by projection; a model's parameters beyond these are those of FULL_OPENCV.
KEYS = {
    PERSPECTIVE: {"k1": "k1", "k2": "k2", "p1": "p1", "p2": "p2", "k3": "k3"},
    FISHEYE: {"k1": "k1", "k2": "k2", "p1": "p1", "p2": "p2", "k3": "k3", "k4": "k4", "s1": "sx1", "s2": "sy1"},
    EQUIRECTANGULAR: {},
}
RATIONAL = {"q1": "k4", "q2": "k5", "q3": "k6"}
ALL_COEFFICIENTS = (
    "k1",
    "k2",
    "p1",
    "p2",
    "k3",
    "k4",
    "k5",
    "k6",
    "s1",
    "s2",
    "s3",
    "s4",
    "sx1",
    "sy1",
    "omega",
    "xi",
    "alpha",
)
OTHER_LENSES = ("fisheye", "equirectangular", "latlong", "orthographic", "ftheta_p0", "ftheta_p1")
FOCAL_KEYS = ("fl_x", "fl_y", "x_fov", "y_fov", "camera_angle_x", "camera_angle_y")


def read_camera(world_T_camera: np.ndarray, values: dict[str, Any], size: tuple[int, int], where: str) -> Camera:
    """The camera of a frame, for pictures of the w x h that is named, else of `size`. UserError for lenses we cannot read."""
    name = values.get("camera_model") or ("OPENCV_FISHEYE" if values.get("is_fisheye") else "OPENCV")
    model = LENSES.get(name.upper()) if isinstance(name, str) else None
    keys = KEYS[model.projection] if model is not None else {}
    keys = keys | RATIONAL if model is MODELS["FULL_OPENCV"] else keys
    others = [key for key in OTHER_LENSES if values.get(key)]
    others += [key for key in ALL_COEFFICIENTS if key not in keys.values() and values.get(key)]
    if model is None or others:
        raise UserError("this lens model is not supported", where=where, expected=", ".join(LENSES),
                        found=", ".join([str(name)[:40], *others]), remedy="undistort the pictures first")  # fmt: skip
    width, height = (number(values, key, where, float(side)) for key, side in zip("wh", size, strict=True))
    if min(width, height) < 1:
        raise UserError("w and h must be pixels, at least 1", where=where, found=f"{width:g}x{height:g}")
    named = {name: number(values, key, where, 0.0) for name, key in keys.items()}
    named |= {"cx": number(values, "cx", where, width / 2), "cy": number(values, "cy", where, height / 2)}
    if model.projection != EQUIRECTANGULAR:
        lengths = (
            values if model.projection == PERSPECTIVE else {k: v for k, v in values.items() if k in ("fl_x", "fl_y")}
        )
        named["fx"], named["fy"] = _focal_lengths(lengths, width, height, where)
    intrinsics = model.intrinsics(named, width, height)
    return Camera(world_T_camera, round(width), round(height), *intrinsics, model.lens(named))


def _focal_lengths(values: dict[str, Any], width: float, height: float, where: str) -> tuple[float, float]:
    """fx and fy in pixels; one that is not named is as the other. Lengths win over angles."""
    found = [number(values, key, where) for key in ("fl_x", "fl_y") if key in values]
    found = found or [
        focal for axis, side in (("x", width), ("y", height)) for focal in _focal(values, axis, side, where)
    ]
    if not found:
        expected = "fl_x, or of a perspective lens camera_angle_x"
        raise UserError("no focal length", where=where, expected=expected, found="neither")
    fx, fy = found[0], found[-1]
    if fx <= 0 or fy <= 0:
        raise UserError("the focal length must be positive", where=where, found=f"{fx:g}, {fy:g}")
    return fx, fy


def _focal(values: dict[str, Any], axis: str, side: float, where: str) -> list[float]:
    """The focal length in pixels by the first angle of view across `side` pixels that is named, if any."""
    for key, unit, most in ((f"{axis}_fov", np.pi / 180, 180.0), (f"camera_angle_{axis}", 1.0, np.pi)):
        if key in values:
            angle = number(values, key, where)
            if not LEAST_ANGLE < angle < most - LEAST_ANGLE:
                raise UserError(f"{key} is not a field of view", where=where, expected=f"0 to {most:.4g}", found=angle)
            return [0.5 * side / float(np.tan(0.5 * unit * angle))]
    return []


def number(values: dict[str, Any], key: str, where: str | Path, default: float | None = None) -> float:
    """A finite number under a key. UserError where it is missing (without default) or no number."""
    value = values.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise UserError(f'"{key}" is not a number', where=where, found="nothing" if value is None else repr(value)[:60])
    return float(value)
