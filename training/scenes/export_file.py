"""A file that another program exported: its numbers checked, its cameras and points as a Reconstruction, errors that name it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from console import UserError
from console.json_text import read_json_file
from training.scenes.colmap_files import LARGEST_SIDE, Reconstruction
from training.scenes.lens import EQUIRECTANGULAR, MODELS, Model
from training.scenes.poses import pose
from training.scenes.scene import Camera
from training.scenes.space import in_picture

MOST_JSON_BYTES = 512 << 20  # reconstructions of OpenSfM hold all points
PINHOLE = MODELS["PINHOLE"]
Numbers = Sequence[float] | np.ndarray


class ExportFile:
    """A file of a program, for errors that name both."""

    def __init__(self, program: str, file: Path) -> None:
        self.program, self.file = program, file

    def damaged(self, found: str, where: str = "") -> UserError:
        return UserError(f"not an export of {self.program}, or a damaged one", where=f"{self.file} {where}".strip(),
                         found=found[:80], remedy="export it again")  # fmt: skip

    def json(self, kind: type) -> Any:
        try:
            value = read_json_file(self.file, MOST_JSON_BYTES)
        except (ValueError, OSError) as error:
            raise self.damaged(str(error)) from error
        if not isinstance(value, kind):
            raise self.damaged(f"{type(value).__name__} at the top")
        return value

    def numbers(self, values: Any, count: int, what: str) -> np.ndarray:
        """Finite numbers float64 [count]."""
        try:
            numbers = np.array(values, np.float64).ravel()
        except (TypeError, ValueError):
            numbers = np.zeros(0)
        if len(numbers) != count or not np.isfinite(numbers).all():
            raise self.damaged(f"{what} is no list of {count} numbers" if count > 1 else f"{what} is no number")
        return numbers

    def number(self, values: Mapping[str, Any], key: str, default: float | None = None) -> float:
        value = values.get(key, default)
        return float(
            self.numbers([None if isinstance(value, bool) else value], 1, f"{key} of {values.get('name', 'a camera')}")[
                0
            ]
        )

    def entry(self, values: Any, key: str, kind: type) -> Any:
        """The entry of an object under a key, of that type and not empty."""
        value = values.get(key) if isinstance(values, dict) else None
        if not isinstance(value, kind) or not value:
            raise self.damaged(f"no {key}")
        return value

    def camera(
        self, name: str, world_T_camera: Any, size: Numbers, focal: Numbers, centre: Numbers,
        model: Model = PINHOLE, coefficients: Mapping[str, float] = MappingProxyType({}),
    ) -> Camera:  # fmt: skip
        """A camera; focal lengths and centre in pixels. UserError where its pose or its lens make no sense."""
        width, height = (float(side) for side in size)
        numbers = [width, height, *focal, *centre, *coefficients.values()]
        good = np.isfinite(numbers).all() and 1 <= min(width, height) <= max(width, height) <= LARGEST_SIDE
        if not good or (model.projection != EQUIRECTANGULAR and min(focal) <= 0):
            found = ", ".join(f"{number:g}" for number in numbers)
            raise self.damaged(f"size and focal length must be positive numbers: {found}", name)
        values = {"fx": float(focal[0]), "fy": float(focal[-1]), "cx": float(centre[0]), "cy": float(centre[1])}
        intrinsics = model.intrinsics(values, width, height)
        world_T_camera = pose(world_T_camera, f"{self.file} {name}")
        return Camera(world_T_camera, round(width), round(height), *intrinsics, model.lens(coefficients))

    def reconstruction(
        self, cameras: Mapping[str, Camera], points: Any = (), colours: Any = (), seen: Any = None
    ) -> Reconstruction:
        """Sorted by name. points, colours: [M, 3]; seen: by name, the rows of the points that it shows; or None."""
        if not cameras:
            raise self.damaged("no camera has a pose")
        names = sorted(cameras)
        places, rgb = (np.array(values, np.float64).reshape(-1, 3) for values in (points, colours))
        if not np.isfinite(places).all() or len(rgb) != len(places):
            raise self.damaged("a point at no finite place, or without a colour")
        shown = [np.flatnonzero(in_picture(cameras[name], places)) if seen is None else seen[name] for name in names]
        tracks = np.bincount(np.concatenate(shown), minlength=len(places)) if len(places) else np.zeros(0)
        return Reconstruction(tuple(names), tuple(cameras[name] for name in names), places,
                              np.clip(rgb, 0, 255).astype(np.uint8), tracks, tuple(shown))  # fmt: skip
