"""Cameras from the keys of transforms.json: focal lengths, principal point, size, distortion and lens model (docs/scenes.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from training.scenes.scene import Camera

LEAST_ANGLE = 1e-6  # radians
# Distortion as OpenCV has it; models that say no more than k1, k2, p1, p2.
LENSES = ("OPENCV", "PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
FURTHER_COEFFICIENTS = ("k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "sx1", "sy1", "omega", "xi", "alpha")
OTHER_LENSES = ("is_fisheye", "fisheye", "equirectangular", "latlong", "orthographic", "ftheta_p0", "ftheta_p1")
FOCAL_KEYS = ("fl_x", "fl_y", "x_fov", "y_fov", "camera_angle_x", "camera_angle_y")


def read_camera(world_T_camera: np.ndarray, values: dict[str, Any], size: tuple[int, int], where: str) -> Camera:
    """The camera of a frame, for pictures of the w x h that is named, else of `size`. UserError for lenses we cannot read."""
    model = values.get("camera_model") or LENSES[0]
    others = [key for key in OTHER_LENSES if values.get(key)]
    further = [key for key in FURTHER_COEFFICIENTS if values.get(key)]
    known = LENSES if further else (*LENSES, "FULL_OPENCV")
    if others or further or not isinstance(model, str) or model.upper() not in known:
        raise UserError("this lens model is not supported", where=where, expected=f"{', '.join(LENSES)}: k1, k2, p1, p2",
                        found=", ".join([str(model)[:40], *others, *further]), remedy="undistort the pictures first")  # fmt: skip
    width, height = (number(values, key, where, float(side)) for key, side in zip("wh", size, strict=True))
    if min(width, height) < 1:
        raise UserError("w and h must be pixels, at least 1", where=where, found=f"{width:g}x{height:g}")
    fx, fy = _focal_lengths(values, width, height, where)
    cx, cy = number(values, "cx", where, width / 2), number(values, "cy", where, height / 2)
    k1, k2, p1, p2 = (number(values, key, where, 0.0) for key in ("k1", "k2", "p1", "p2"))
    return Camera(world_T_camera, round(width), round(height), fx, fy, cx, cy, (k1, k2, p1, p2))


def _focal_lengths(values: dict[str, Any], width: float, height: float, where: str) -> tuple[float, float]:
    """fx and fy in pixels; one that is not named is as the other. Lengths win over angles."""
    found = [number(values, key, where) for key in ("fl_x", "fl_y") if key in values]
    found = found or [
        focal for axis, side in (("x", width), ("y", height)) for focal in _focal(values, axis, side, where)
    ]
    if not found:
        raise UserError("no focal length", where=where, expected="fl_x or camera_angle_x", found="neither")
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
