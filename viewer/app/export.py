"""Pictures and films written to disk while the window stays alive.

An Export is stepped by the main thread (it needs OpenGL): each step renders tiles for a few milliseconds. Files are
written aside and renamed when they are whole; what is cancelled or fails leaves nothing behind.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from console import UserError, not_written
from console.atomic import Replacement
from viewer.app.films import FilmWriter, films_possible
from viewer.rendering.camera import ViewCamera
from viewer.rendering.dynamic_resolution import tiles
from viewer.rendering.settings import RenderSettings

__all__ = ["Export", "films_possible"]

Snapshot = Callable[[ViewCamera, RenderSettings], np.ndarray]
FILM_SUFFIX, STILL_SUFFIX = ".mp4", ".png"
CENTRES = (
    256  # to a pixel, that principal points are rounded to: cards then hold them exactly, whatever a tile's corner
)


@dataclass
class Export:
    """cameras: one a frame. target: a .png (one frame), an .mp4, or a folder for numbered PNGs.

    tile_side: pixels a side of what is rendered at once; it changes no pixel.
    """

    cameras: list[ViewCamera]
    settings: RenderSettings
    target: Path
    snapshot: Snapshot
    fps: float = 30.0
    tile_side: int = 256

    def __post_init__(self) -> None:
        if not self.cameras:
            raise UserError("there is nothing to export", where=self.target)
        self.done_tiles = 0
        self.started = time.monotonic()
        self.finished = False
        self.cameras = [
            replace(camera, cx=round(CENTRES * camera.cx) / CENTRES, cy=round(CENTRES * camera.cy) / CENTRES)
            for camera in self.cameras
        ]
        width, height = self.cameras[0].width, self.cameras[0].height
        self._boxes = tiles(width, height, self.tile_side)
        self._frame = np.zeros((height, width, 3), np.uint8)
        self._sink: Any = None

    @property
    def share(self) -> float:
        """0 … 1 of the work is done."""
        return self.done_tiles / (len(self._boxes) * len(self.cameras))

    @property
    def seconds_left(self) -> float | None:
        """An estimate; None while it is too early for one."""
        passed = time.monotonic() - self.started
        return passed * (1 / self.share - 1) if self.share > 0 and passed > 0.5 else None

    def step(self, seconds: float) -> None:
        """Works for about `seconds`. Raises UserError, after cleaning up, where the disk is full and the like."""
        end = time.monotonic() + seconds
        try:
            if self._sink is None:
                self._sink = _sink(self.target, self._frame.shape[1], self._frame.shape[0], self.fps)
            while not self.finished:
                self._next_tile()
                if time.monotonic() >= end:
                    break
        except BaseException as error:
            self.cancel()
            if isinstance(error, OSError):
                words, remedy = not_written(error)
                remedy = f"the unfinished file was removed; {remedy}, then export again"
                raise UserError(words, where=self.target, remedy=remedy) from error
            raise

    def _next_tile(self) -> None:
        frame, tile = divmod(self.done_tiles, len(self._boxes))
        camera = self.cameras[frame]
        x, y, w, h = self._boxes[tile]
        part = replace(camera, width=w, height=h, cx=camera.cx - x, cy=camera.cy - y)
        self._frame[y : y + h, x : x + w] = self.snapshot(part, self.settings)
        self.done_tiles += 1
        if tile == len(self._boxes) - 1:
            self._sink.add(self._frame)
        if self.done_tiles == len(self._boxes) * len(self.cameras):
            self._sink.finish()
            self.finished = True

    def cancel(self) -> None:
        """Stops, and removes what was written so far."""
        if self._sink is not None and not self.finished:
            self._sink.discard()
        self.finished = True


def _sink(target: Path, width: int, height: int, fps: float):
    target.parent.mkdir(parents=True, exist_ok=True)
    suffix = target.suffix.lower()
    if suffix == STILL_SUFFIX:
        return _Still(target)
    return FilmWriter(target, (width, height), round(fps)) if suffix == FILM_SUFFIX else _Sequence(target)


class _Still:
    def __init__(self, target: Path) -> None:
        self.aside = Replacement(target, alone=True)

    def add(self, picture: np.ndarray) -> None:
        Image.fromarray(picture).save(self.aside.path, format="PNG")

    def finish(self) -> None:
        self.aside.finish()
        self.aside.discard()

    def discard(self) -> None:
        self.aside.discard()


class _Sequence:
    def __init__(self, target: Path) -> None:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise UserError("is not empty", where=target, remedy="choose a new folder for the pictures")
        self.aside, self.count = Replacement(target, folder=True, alone=True), 0

    def add(self, picture: np.ndarray) -> None:
        Image.fromarray(picture).save(self.aside.path / f"frame_{self.count:05d}.png", compress_level=4)
        self.count += 1

    def finish(self) -> None:
        if self.aside.target.exists():
            self.aside.target.rmdir()  # refuses where something was put there since
        self.aside.finish()
        self.aside.discard()

    def discard(self) -> None:
        self.aside.discard()
