"""The photographs that a pack was made from: where they were taken, and their pixels while the scene is on disk.

Poses come with the pack (metadata "cameras"); pictures are read from the scene folder that its provenance names, or
from another that the user chooses. Where there is none on this computer, the small copies that a pack may bring along
stand in for them (scenepack.pictures).
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from console import UserError
from console.streams import one_line
from scenepack.pack import Pack
from scenepack.pictures import has_picture, picture_of
from training.scenes import load_scene
from training.scenes.scene import Camera, Photograph
from viewer.app.projection import frustum_points
from viewer.rendering.camera import ViewCamera

FARTHEST = 1e9  # from the origin, and any other number of a camera: what is beyond makes no sense
LONGEST_NAME = 200  # characters
LONGEST_SIDE = 1600  # pixels; larger photographs are shown smaller


@dataclass(frozen=True)
class Shot:
    """One photograph's camera. camera: in the training frame. view: the same as the renderer wants it. entry: all that
    the pack says of it.
    """

    name: str
    split: str
    camera: Camera
    view: ViewCamera
    entry: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def has_copy(self) -> bool:
        """Whether the pack brings a small copy of it along."""
        return has_picture(self.entry)


class Photographs:
    """Shots of a pack. folder: the scene's, None where it is not known. reachable: whether that is on this computer."""

    def __init__(self, pack: Pack) -> None:
        self.shots = shots_of(pack)
        provenance = pack.metadata.get("provenance")
        scene = provenance.get("scene") if isinstance(provenance, dict) else None
        self.folder = Path(scene) if isinstance(scene, str) and Path(scene).is_absolute() else None
        self.reachable = self.folder is not None and self.folder.is_dir()
        self._copies = any(shot.has_copy for shot in self.shots)
        self.background: tuple[float, ...] = (1.0, 1.0, 1.0)
        spherify, masks = (
            isinstance(provenance, dict) and provenance.get(key) is True for key in ("spherify", "masks")
        )
        self._options = {"spherify": spherify or None, "masks": masks}  # as the pack's maker read them
        self._found: dict[tuple[str, str], Photograph] | None = None
        self._reading = threading.Lock()  # thumbnails are read in a thread of their own
        self._cache: dict[int, np.ndarray] = {}
        self._frusta: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.shots)

    @property
    def found(self) -> bool:
        """Whether the scene's folder was read already, and is one."""
        return self._found is not None

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits, in the order of the shots."""
        return tuple(dict.fromkeys(shot.split for shot in self.shots))

    def named(self, name: str) -> int:
        """The shot of that name, or the first that begins or ends so. UserError where there is none."""
        for fits in (str.__eq__, str.startswith, str.endswith):
            for index, shot in enumerate(self.shots):
                if fits(shot.name, name):
                    return index
        known = ", ".join(shot.name for shot in self.shots[:3])
        raise UserError("the pack has no such photograph", expected=f"one such as {known}", found=repr(name))

    def frusta(self, depth: float) -> np.ndarray:
        """float64 [n, 5, 3]: eye and corners of each shot's picture at `depth` (grid units); see FRUSTUM_EDGES."""
        if self._frusta is None:
            self._frusta = np.array([frustum_points(shot.view, 1.0) for shot in self.shots]).reshape(-1, 5, 3)
        eyes = self._frusta[:, :1]
        return eyes + depth * (self._frusta - eyes)

    def look_in(self, folder: Path) -> None:
        """Takes pictures from another folder from now on. UserError where it is no scene."""
        with self._reading:
            self._read(folder)
            self.folder, self.reachable, self._cache = folder, True, {}

    def has_picture(self, index: int) -> bool:
        """Whether there is something to show of a shot: its file, as far as is known, or a small copy."""
        return self.reachable or self.shots[index].has_copy

    @property
    def any_pictures(self) -> bool:
        """Whether there is something to show of any."""
        return self.reachable or self._copies

    def copy(self, index: int) -> np.ndarray:
        """The small copy of a shot, uint8 [h, w, 3]. UserError where there is none."""
        picture = picture_of(self.shots[index].entry)
        if picture is None:
            raise UserError("the pack's copy of the photograph cannot be decoded", where=self.shots[index].name)
        return picture

    def photograph(self, index: int) -> Photograph:
        """The file behind a shot. UserError where it is not there; any thread may ask."""
        shot = self.shots[index]
        with self._reading:
            if self._found is None:
                if self.folder is None:
                    raise UserError("the pack does not say where its photographs are", remedy="choose the scene folder")
                self._read(self.folder)
            assert self._found is not None
            photograph = self._found.get((shot.split, shot.name)) or self._found.get(("", shot.name))
        if photograph is None:
            raise UserError("has no such photograph", where=self.folder, expected=f"{shot.split} {shot.name}")
        return photograph

    def pixels(self, index: int) -> np.ndarray:
        """The photograph over the scene's background, uint8 [h, w, 3], at most LONGEST_SIDE; the small copy of one that is not on
        this computer. UserError where there is neither.
        """
        if index not in self._cache:
            picture = Image.fromarray(self._pixels(index))
            picture.thumbnail((LONGEST_SIDE, LONGEST_SIDE), Image.Resampling.BOX)
            if len(self._cache) > 32:
                self._cache.pop(next(iter(self._cache)))
            self._cache[index] = np.asarray(picture)
        return self._cache[index]

    def _pixels(self, index: int) -> np.ndarray:
        if not self.reachable and self.shots[index].has_copy:
            return self.copy(index)
        rgba = self.photograph(index).load()
        rgb = rgba[..., :3] * rgba[..., 3:] + np.asarray(self.background) * (1 - rgba[..., 3:])
        return np.round(255 * np.clip(rgb, 0, 1)).astype(np.uint8)

    def _read(self, folder: Path) -> None:
        scene = load_scene(folder, **self._options)
        found: dict[tuple[str, str], Photograph] = {}
        for split, photographs in scene.splits.items():
            for photograph in photographs:
                name = _shown(photograph.name)
                found[(split, name)] = photograph
                found.setdefault(("", name), photograph)
        self.background, self._found = scene.background, found


def shots_of(pack: Pack) -> list[Shot]:
    """The cameras in the pack's metadata; entries that make no sense are left out."""
    entries = pack.metadata.get("cameras")
    shots = []
    for entry in entries if isinstance(entries, list) else []:
        camera = _camera(entry)
        if camera is not None:
            view = ViewCamera.from_scene_camera(pack, camera)
            shots.append(
                Shot(_shown(entry.get("name", len(shots))), _shown(entry.get("split", "train")), camera, view, entry)
            )
    return shots


def _shown(name: Any) -> str:
    """A name from a pack or a scene, fit for labels."""
    return one_line(str(name), LONGEST_NAME)


def _camera(entry: Any) -> Camera | None:
    try:
        matrix = np.asarray(entry["world_T_camera"], np.float64)
        numbers = [float(entry[name]) for name in ("fx", "fy", "cx", "cy")]
        width, height = int(entry["width"]), int(entry["height"])
        distortion = tuple(float(v) for v in entry.get("distortion") or (0.0,) * 4)
        good = matrix.shape == (4, 4) and (np.abs(matrix) < FARTHEST).all() and abs(np.linalg.det(matrix)) > 1e-9
        good = good and (np.abs([*numbers, *distortion]) < FARTHEST).all() and min(numbers[:2]) > 1 / FARTHEST
        if not (good and 0 < width < FARTHEST and 0 < height < FARTHEST):
            return None
        k1, k2, p1, p2 = distortion
        return Camera(matrix, width, height, *numbers, distortion=(k1, k2, p1, p2))
    except (KeyError, TypeError, ValueError, OverflowError):
        return None


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Peak signal-to-noise ratio (dB) of two pictures of one shape, uint8; infinite where they are the same."""
    error = float(np.mean((a.astype(np.float64) - b.astype(np.float64)) ** 2)) / 255.0**2
    return float("inf") if error == 0 else float(-10.0 * np.log10(error))
