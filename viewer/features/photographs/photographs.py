"""Photographs that the open pack was made from: their cameras, pixels and thumbnails, and the state of their page.

Poses come with the pack (metadata "cameras"); pictures are read from the scene folder that its provenance names, or
from another that the user chooses. Where there is none on this computer, the small copies that a pack may bring along
stand in for them (scenepack.cameras).

Notation: the sheet is cut into square cells of `cell` pixels, `columns` a row; shot i has cell i. The cell is as large as
lets the whole sheet fit into LARGEST_SHEET pixels a side, so that memory is bounded whatever the number of photographs.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from console import UserError
from scenepack.cameras import PhotographCamera, has_picture, label_of, photograph_cameras, picture_of
from scenepack.pack import Pack
from training.scenes import load_scene
from training.scenes.pictures import PictureLoader, as_bytes, as_floats, over_background
from training.scenes.scene import Photograph
from training.scenes.scene_options import recorded_options
from viewer.core.pose import frustum_points
from viewer.core.tasks import Task
from viewer.rendering.camera import ViewCamera
from viewer.rendering.targets import Sheet

if TYPE_CHECKING:
    from viewer.app.application import App

LONGEST_SIDE = 1600  # pixels; larger photographs are shown smaller


@dataclass(frozen=True)
class Shot:
    """One photograph's camera, in the training frame; view: as the renderer wants it."""

    name: str
    split: str
    camera: PhotographCamera
    view: ViewCamera

    @property
    def has_copy(self) -> bool:
        return has_picture(self.camera.entry)


class Photographs:
    """Shots of a pack (None: of none). folder: the scene's, None where it is not known. reachable: that is on this computer."""

    def __init__(self, pack: Pack | None) -> None:
        self.shots = [] if pack is None else shots_of(pack)
        self._provenance = None if pack is None else pack.metadata.get("provenance")
        scene = self._provenance.get("scene") if isinstance(self._provenance, dict) else None
        self.folder = Path(scene) if isinstance(scene, str) and Path(scene).is_absolute() else None
        self.reachable = self.folder is not None and self.folder.is_dir()
        self._copies = any(shot.has_copy for shot in self.shots)
        self.background: tuple[float, ...] = (1.0, 1.0, 1.0)
        # by split and name, and by "" and name; once the folder was read
        self.found: dict[tuple[str, str], Photograph] = {}
        self._reading = threading.Lock()  # thumbnails are read in a thread of their own
        self._cache: dict[int, np.ndarray] = {}
        self._frusta: np.ndarray | None = None

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

    @property
    def any_pictures(self) -> bool:
        """Whether there is something to show of any."""
        return self.reachable or self._copies

    def copy(self, index: int) -> np.ndarray:
        """The small copy of a shot, uint8 [h, w, 3]. UserError where there is none."""
        picture = picture_of(self.shots[index].camera.entry)
        if picture is None:
            raise UserError("the pack's copy of the photograph cannot be decoded", where=self.shots[index].name)
        return picture

    def photograph(self, index: int) -> Photograph:
        """The file behind a shot. UserError where it is not there; any thread may ask."""
        shot = self.shots[index]
        with self._reading:
            if not self.found:
                if self.folder is None:
                    raise UserError("the pack does not say where its photographs are", remedy="choose the scene folder")
                self._read(self.folder)
            photograph = self.found.get((shot.split, shot.name)) or self.found.get(("", shot.name))
        if photograph is None:
            raise UserError("has no such photograph", where=self.folder, expected=f"{shot.split} {shot.name}")
        return photograph

    def pixels(self, index: int) -> np.ndarray:
        """A photograph over its background, uint8 [h, w, 3], at most LONGEST_SIDE, or its small copy. UserError for neither."""
        if index not in self._cache:
            if not self.reachable and self.shots[index].has_copy:
                pixels = self.copy(index)
            else:
                pixels = as_bytes(over_background(self.photograph(index).load(), self.background))
            if len(self._cache) > 32:
                self._cache.pop(next(iter(self._cache)))
            self._cache[index] = _shrunk(pixels, LONGEST_SIDE)
        return self._cache[index]

    def _read(self, folder: Path) -> None:
        scene = load_scene(folder, **recorded_options(self._provenance))
        found: dict[tuple[str, str], Photograph] = {}
        for split, photographs in scene.splits.items():
            for photograph in photographs:
                found[(split, label_of(photograph.name))] = photograph
                found.setdefault(("", label_of(photograph.name)), photograph)
        self.background, self.found = scene.background, found


def shots_of(pack: Pack) -> list[Shot]:
    """The cameras in the pack's metadata; entries that make no sense are left out."""
    views = ((camera, ViewCamera.from_scene_camera(pack, camera)) for camera in photograph_cameras(pack))
    return [Shot(camera.name, camera.split, camera, view) for camera, view in views]


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Peak signal-to-noise ratio (dB) of two pictures of one shape, uint8; infinite where they are the same."""
    error = float(np.mean((a.astype(np.float64) - b.astype(np.float64)) ** 2)) / 255.0**2
    return float("inf") if error == 0 else float(-10.0 * np.log10(error))


# --- All photographs of a pack ---

LARGEST_SHEET = 2048  # pixels a side: 12 MiB in memory
CELLS = (128, 64, 32)  # powers of two, so that the sheet can be halved for drawing without mixing neighbours


class Thumbnails(Task[None], Sheet):
    """Small pictures of `photographs`, from the moment this is made. Poll `news` from the main thread."""

    def __init__(self, photographs: Photographs) -> None:
        self.photographs, self.folder = photographs, photographs.folder
        count = len(photographs.shots)
        cell = next((cell for cell in CELLS if (LARGEST_SHEET // cell) ** 2 >= count), CELLS[-1])
        side = LARGEST_SHEET // cell
        self.shown = min(count, side**2)  # later ones get no picture
        Sheet.__init__(self, cell, min(max(count, 1), side), max(ceil(self.shown / side), 1))
        self.problem = ""  # why the first that failed did
        super().__init__(self._read)

    def state(self) -> object:
        return len(self.boxes)

    def _read(self) -> None:
        for index in range(self.shown):
            if self.cancelled:
                return
            try:
                self.put(index, self._small(index))
            except Exception as error:  # one photograph that is gone or broken leaves its cell empty
                self.problem = self.problem or (str(error) if isinstance(error, UserError) else "it cannot be read")
                if self.photographs.reachable and not self.photographs.found:
                    return  # the scene cannot be read, nor could the others

    def _small(self, index: int) -> np.ndarray:
        """uint8 [h, w, 3], over the scene's background, at most `cell` pixels a side."""
        if not self.photographs.reachable:
            return _shrunk(self.photographs.copy(index), self.cell)
        load = self.photographs.photograph(index).load
        assert isinstance(load, PictureLoader)
        picture = as_floats(np.asarray(load.thumbnail(self.cell).convert("RGBA")))
        return as_bytes(over_background(picture, self.photographs.background))


def _shrunk(pixels: np.ndarray, side: int) -> np.ndarray:
    """A picture uint8 [h, w, C] with at most `side` pixels a side."""
    picture = Image.fromarray(pixels)
    picture.thumbnail((side, side), Image.Resampling.BOX)
    return np.asarray(picture)


# --- Gallery ---


@dataclass
class Gallery:
    photographs: Photographs = field(default_factory=lambda: Photographs(None))  # of the open pack
    chosen: int | None = None  # index of the shot chosen last; it stays chosen when the camera moves away
    reveal: bool = False  # the list has yet to scroll to it
    split_shown: str = ""  # only shots of this split are listed; "" is all
    thumbnails: Thumbnails | None = None
    frusta: bool = False  # they are drawn in the scene
    frusta_size: float = 1.0  # over the usual one
    frusta_opacity: float = 0.9  # 0 … 1, of the pictures in them

    def scene_changed(self, pack: Pack) -> None:
        self.photographs = Photographs(pack)
        self.chosen, self.frusta, self.split_shown = None, False, ""

    def visible(self) -> list[int]:
        return [index for index, shot in enumerate(self.photographs.shots) if self.split_shown in ("", shot.split)]

    def stand_in(self, app: App, index: int) -> None:
        """Moves the camera to a photograph's pose and compares with the photograph if it can be read."""
        shot = self.photographs.shots[index]
        app.open_scene.rig.remember()
        app.open_scene.rig.hold(shot.view)
        if self.split_shown != shot.split:
            self.split_shown = ""
        self.chosen, self.reveal = index, True
        app.comparison.stop()
        if self.photographs.reachable or shot.has_copy:  # else its place is all there is to see
            app.comparison.pixels, app.comparison.against = self.photographs.pixels(index), "photograph"

    def step(self, app: App, by: int) -> None:
        """Chooses the next listed photograph, or the previous one."""
        if visible := self.visible():
            first = 0 if by > 0 else -1
            place = visible.index(self.chosen) + by if self.chosen in visible else first
            self.stand_in(app, visible[place % len(visible)])

    def tick(self, app: App) -> None:
        """Reads thumbnails while they are visible and redraws when they arrive."""
        of = None if app.scene is None else (self.photographs, self.photographs.folder)
        if self.thumbnails is not None and of != (self.thumbnails.photographs, self.thumbnails.folder):
            self.thumbnails.cancel()
            self.thumbnails = None
        if self.thumbnails is not None and self.thumbnails.news():
            app.touch(1)
        wanted = self.frusta or app.interface.shows("photographs")
        if self.thumbnails is None and wanted and of is not None and self.photographs.any_pictures:
            self.thumbnails = Thumbnails(self.photographs)
