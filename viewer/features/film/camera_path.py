"""A flight along keyframes: a spline through camera poses, and nerfstudio's camera-path JSON.

Keyframes are grid_T_camera matrices with a vertical field of view. Between them positions follow a Catmull-Rom spline,
and rotations the same spline over unit quaternions, brought back to unit length. The file holds camera-to-world
matrices in the training frame, row-major, as nerfstudio writes them.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from console import UserError
from console.atomic import write_file
from console.json_text import parse_json, read_json_file
from viewer.core.pose import FARTHEST, POSSIBLE_FOVS

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

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        count = len(self.keyframes)
        return self.start_of(count if self.closed and count > 1 else count - 1)

    def at(self, seconds: float) -> tuple[np.ndarray, float]:
        """grid_T_camera (float64 [4, 4]) and vertical fov (degrees) at a time; held at the ends."""
        matrices, fov = self.poses(np.array([seconds]))
        return matrices[0], float(fov[0])

    def poses(self, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same at N times: float64 [N, 4, 4] and [N]."""
        count = len(self.keyframes)
        starts = np.cumsum([0.0, *(key.seconds for key in self.keyframes)])[: count + self.closed]
        place = np.interp(seconds % starts[-1] if self.closed else seconds, starts, np.arange(len(starts)))
        near = np.arange(-1, count + 2)  # keyframe i, and those around it, from place i on
        near = near % count if self.closed else np.clip(near, 0, count - 1)
        keys = np.array([key.grid_T_camera for key in self.keyframes])[near]
        handed = np.sign(np.linalg.det(keys[0, :3, :3]))  # mirrored frames hold reflections, all of one hand
        mirror = np.diag([handed, 1.0, 1.0])
        quaternions = Rotation.from_matrix(keys[:, :3, :3] @ mirror).as_quat()
        # q and -q are the same rotation: take those on the side of the one before
        opposite = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
        quaternions[1:] *= np.cumprod(np.where(opposite, -1.0, 1.0))[:, None]
        fov = np.array([key.fov for key in self.keyframes])[near]
        last = np.minimum(place.astype(int), count - 1)
        values = np.column_stack([keys[:, :3, 3], quaternions, fov])[last[:, None] + np.arange(4)]
        found = _catmull_rom(values, place - last)
        matrices = np.tile(np.eye(4), (len(place), 1, 1))
        matrices[:, :3, 3] = found[:, :3]
        matrices[:, :3, :3] = Rotation.from_quat(found[:, 3:7]).as_matrix() @ mirror  # of unit length there
        return matrices, np.clip(found[:, 7], *POSSIBLE_FOVS)

    def start_of(self, index: int) -> float:
        """Seconds at which keyframe `index` is passed."""
        return sum(keyframe.seconds for keyframe in self.keyframes[:index])

    def sample(self, fps: float) -> list[tuple[np.ndarray, float]]:
        """Matrix and fov of every frame of a film; a closed path does not repeat its first frame at the end."""
        count = max(1, round(self.duration * fps)) + (0 if self.closed else 1)
        matrices, fov = self.poses(np.arange(count) / fps)
        return list(zip(matrices, fov.tolist(), strict=True))


def _catmull_rom(points: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The uniform Catmull-Rom spline between points 1 and 2 of four, [N, 4, C], at t [N] in 0 … 1: [N, C]."""
    a, b, c, d = np.moveaxis(points, 1, 0)
    t = t[:, None]
    return 0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)


# nerfstudio's file


def save_path(path: CameraPath, file: Path, training_T_grid: np.ndarray, size: tuple[int, int], fps: float) -> None:
    """Writes a path with keyframes as nerfstudio's camera-path JSON. size: width, height of the film, pixels. Raises OSError."""
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
        for matrix, fov in path.sample(fps)
    ]
    document = {
        "default_fov": path.keyframes[0].fov,
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
        if len({np.linalg.det(key.grid_T_camera[:3, :3]) > 0 for key in keyframes}) > 1:
            raise ValueError("some of its keyframes are mirrored and others are not")
        return CameraPath(keyframes, bool(document.get("is_cycle", False)))
    except OSError as error:
        raise UserError("cannot be read", where=file, found=error.strerror) from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        expected = "nerfstudio's camera_path.json with keyframes"
        raise UserError("is not a camera path", where=file, expected=expected, found=error) from error


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
    if not 0 < seconds < 1e5 or not POSSIBLE_FOVS[0] <= fov <= POSSIBLE_FOVS[1]:
        raise ValueError("a keyframe's time or field of view makes no sense")
    rotation, _, rows = np.linalg.svd(matrix[:3, :3])  # what is nearly a rotation becomes one
    matrix[:3, :3] = rotation @ rows
    return Keyframe(grid_T_training @ matrix, fov, seconds)
