"""A flight along keyframes: a spline through camera poses, and nerfstudio's camera-path JSON.

Keyframes are grid_T_camera matrices with a vertical field of view. Between them positions follow a Catmull-Rom spline,
and rotations the same spline over unit quaternions, brought back to unit length. The file holds camera-to-world
matrices in the training frame, row-major, as nerfstudio writes them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from math import floor
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from console import UserError
from console.atomic import write_file
from console.json_text import parse_json, read_json_file
from viewer.app.pose import FARTHEST

DEFAULT_SECONDS = 2.0


@dataclass(frozen=True)
class Keyframe:
    """grid_T_camera: float64 [4, 4]. fov: vertical, degrees. seconds: to the next keyframe."""

    grid_T_camera: np.ndarray
    fov: float
    seconds: float = DEFAULT_SECONDS


@dataclass
class CameraPath:
    """Keyframes in order; closed: the last leads back to the first."""

    keyframes: list[Keyframe] = field(default_factory=list)
    closed: bool = False

    def insert(self, keyframe: Keyframe, index: int | None = None) -> int:
        """Adds a keyframe after `index` (None: at the end); where it came to stand."""
        at = len(self.keyframes) if index is None else index + 1
        self.keyframes.insert(at, keyframe)
        return at

    def remove(self, index: int) -> None:
        del self.keyframes[index]

    def replace(self, index: int, **fields: Any) -> None:
        """Changes a keyframe."""
        self.keyframes[index] = replace(self.keyframes[index], **fields)

    def move(self, index: int, by: int) -> int:
        """Moves a keyframe earlier (-1) or later (1); its new index."""
        to = min(max(index + by, 0), len(self.keyframes) - 1)
        self.keyframes.insert(to, self.keyframes.pop(index))
        return to

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        legs = self.keyframes if self.closed and len(self.keyframes) > 1 else self.keyframes[:-1]
        return sum(keyframe.seconds for keyframe in legs)

    def at(self, seconds: float) -> tuple[np.ndarray, float]:
        """grid_T_camera (float64 [4, 4]) and vertical fov (degrees) at a time; held at the ends. ValueError if empty."""
        if not self.keyframes:
            raise ValueError("a path without keyframes leads nowhere")
        index, share = self._leg(seconds)
        near = [self.keyframes[self._index(index + i)] for i in (-1, 0, 1, 2)]
        matrix = np.eye(4)
        matrix[:3, 3] = _catmull_rom([k.grid_T_camera[:3, 3] for k in near], share)
        matrix[:3, :3] = _rotation([k.grid_T_camera[:3, :3] for k in near], share)
        fov = float(_catmull_rom([np.array(k.fov) for k in near], share))
        return matrix, min(max(fov, 1.0), 170.0)

    def start_of(self, index: int) -> float:
        """Seconds at which keyframe `index` is passed."""
        return sum(keyframe.seconds for keyframe in self.keyframes[:index])

    def _leg(self, seconds: float) -> tuple[int, float]:
        """The keyframe that was passed last, and the share 0 … 1 of the way to the next."""
        if self.duration <= 0:
            return 0, 0.0
        if self.closed:
            seconds -= self.duration * floor(seconds / self.duration)
        seconds = min(max(seconds, 0.0), self.duration)
        legs = len(self.keyframes) if self.closed else len(self.keyframes) - 1
        for index in range(legs):
            length = self.keyframes[index].seconds
            if seconds <= length or index == legs - 1:
                return index, min(seconds / max(length, 1e-9), 1.0)
            seconds -= length
        return 0, 0.0

    def _index(self, index: int) -> int:
        count = len(self.keyframes)
        return index % count if self.closed else min(max(index, 0), count - 1)

    def sample(self, fps: float) -> list[tuple[np.ndarray, float]]:
        """Matrix and fov of every frame of a film; a closed path does not repeat its first frame at the end."""
        count = max(1, round(self.duration * fps)) + (0 if self.closed else 1)
        return [self.at(i / fps) for i in range(count)]


def _catmull_rom(points: list[np.ndarray], t: float) -> np.ndarray:
    """The uniform Catmull-Rom spline between points 1 and 2 of four, t in 0 … 1."""
    a, b, c, d = points
    return 0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)


def _rotation(rotations: list[np.ndarray], t: float) -> np.ndarray:
    handed = np.sign(np.linalg.det(rotations[1]))  # mirrored frames hold reflections, all of one hand
    mirror = np.diag([handed, 1.0, 1.0])
    quaternions = Rotation.from_matrix(np.stack(rotations) @ mirror).as_quat()
    for i in (0, 2, 3):  # q and -q are the same rotation: take those on the side of the one before
        if quaternions[1] @ quaternions[i] < 0:
            quaternions[i] = -quaternions[i]
    if quaternions[2] @ quaternions[3] < 0:
        quaternions[3] = -quaternions[3]
    return Rotation.from_quat(_catmull_rom(list(quaternions), t)).as_matrix() @ mirror  # of unit length there


# nerfstudio's file


def save_path(path: CameraPath, file: Path, training_T_grid: np.ndarray, size: tuple[int, int], fps: float) -> None:
    """Writes nerfstudio's camera-path JSON. size: width, height of the film, pixels. OSError where it cannot."""
    aspect = size[0] / size[1]
    keyframes = [
        {
            "matrix": (training_T_grid @ key.grid_T_camera).ravel().tolist(),
            "fov": key.fov,
            "aspect": aspect,
            "override_transition_enabled": True,
            "override_transition_sec": key.seconds,
        }
        for key in path.keyframes
    ]
    frames = [
        {"camera_to_world": (training_T_grid @ matrix).ravel().tolist(), "fov": fov, "aspect": aspect}
        for matrix, fov in (path.sample(fps) if path.keyframes else [])
    ]
    document = {
        "default_fov": path.keyframes[0].fov if path.keyframes else 50.0,
        "default_transition_sec": DEFAULT_SECONDS,
        "keyframes": keyframes,
        "camera_type": "perspective",
        "render_height": size[1],
        "render_width": size[0],
        "fps": fps,
        "seconds": path.duration,
        "is_cycle": path.closed,
        "smoothness_value": 0.0,
        "camera_path": frames,
    }
    write_file(file, json.dumps(document, indent=1))


def load_path(file: Path, training_T_grid: np.ndarray) -> CameraPath:
    """Reads nerfstudio's camera-path JSON, from its present viewer or its older one. UserError for anything else."""
    try:
        document = read_json_file(file)
        grid_T_training = np.linalg.inv(training_T_grid)
        default = float(document.get("default_transition_sec", DEFAULT_SECONDS))
        keyframes = [_keyframe(entry, grid_T_training, default) for entry in document["keyframes"]]
        return CameraPath(keyframes, bool(document.get("is_cycle", False)))
    except OSError as error:
        raise UserError("cannot be read", where=file, found=error.strerror) from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise UserError(
            "is not a camera path", where=file, expected="nerfstudio's camera_path.json with keyframes", found=error
        ) from error


def _keyframe(entry: dict[str, Any], grid_T_training: np.ndarray, default: float) -> Keyframe:
    numbers = entry["matrix"]
    if isinstance(numbers, str):  # the older viewer wrote three.js's column-major arrays as text
        matrix = np.array(parse_json(numbers), np.float64).reshape(4, 4).T
    else:
        matrix = np.array(numbers, np.float64).reshape(4, 4)
    if not (np.abs(matrix) <= FARTHEST).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-9:
        raise ValueError("a keyframe's matrix is not a pose")
    seconds = float(entry.get("override_transition_sec") or default)
    fov = float(entry.get("fov", 50.0))
    if not 0 < seconds < 1e5 or not 1 <= fov <= 170:
        raise ValueError("a keyframe's time or field of view makes no sense")
    rotation, _, rows = np.linalg.svd(matrix[:3, :3])  # what is nearly a rotation becomes one
    matrix[:3, :3] = rotation @ rows
    return Keyframe(grid_T_training @ matrix, fov, seconds)
