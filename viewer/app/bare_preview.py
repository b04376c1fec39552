"""Preview of photographs without poses, or of a film: thumbnails, rejected pictures, and an estimate of the time for poses.

A child process (training.posing.preview) reads them, because a decoder may crash and COLMAP cannot be interrupted.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from training.scenes.pictures import UNREADABLE
from training.scenes.sources import Source
from viewer.app.background import JsonTask
from viewer.app.command_process import temporary_folder

CELL = 160  # pixels a side: no small picture is larger
COLUMNS, ROWS = 16, 16  # of the sheet; later pictures are counted, and not shown
MODULE = "training.posing.preview"
Box = tuple[int, int, int, int]


class BarePreview(JsonTask):
    """Starts to read `source` at once. Poll `news` from the main thread; close it in the end.

    of_film: whether the source is a film.
    count: number of photographs, or of frames that would be used; None before it is known.
    names: of the pictures read so far, in order.
    sheet, boxes: their thumbnails; see viewer.app.canvas_interface.Sheet.
    aside: reasons for rejected pictures, by name; None before they are known.
    seconds: estimated time by stage; None before there is one.
    error: why reading stopped early; "" if it did not.
    """

    def __init__(self, source: Source) -> None:
        self.of_film = source.kind == "film"
        self.count: int | None = None
        self.names: list[str] = []
        self.sheet = np.zeros((ROWS * CELL, COLUMNS * CELL, 3), np.uint8)
        self.boxes: dict[int, Box] = {}
        self.aside: Mapping[str, str] | None = None
        self.seconds: Mapping[str, float] | None = None
        self.error = ""
        self._folder = temporary_folder("snerg-preview-")
        words = [str(source.path.resolve()), str(self._folder)]
        super().__init__(MODULE, words, self._take)

    def after(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def state(self) -> object:
        return self.count, len(self.names), self.aside is None, self.seconds is None

    def _take(self, said: Mapping[str, Any]) -> None:
        if "name" in said:
            self._place(len(self.names), self._folder / said["file"] if said["file"] else None)
            self.names.append(said["name"])
        for fact in ("count", "aside", "seconds", "error"):
            if fact in said:
                setattr(self, fact, said[fact])

    def _place(self, index: int, file: Path | None) -> None:
        if file is None or index >= ROWS * COLUMNS:
            return
        try:
            with Image.open(file, formats=["JPEG"]) as opened:
                picture = np.asarray(opened.convert("RGB"))[:CELL, :CELL]
        except UNREADABLE:
            return
        height, width = picture.shape[:2]
        x, y = index % COLUMNS * CELL, index // COLUMNS * CELL
        self.sheet[y : y + height, x : x + width] = picture
        self.boxes[index] = (x, y, width, height)

    @property
    def used(self) -> int | None:
        """How many pictures would be used; None before it is known."""
        return None if self.count is None or self.aside is None else self.count - len(self.aside)

    @property
    def seconds_in_all(self) -> float | None:
        """An estimate for finding the poses; None before there is one."""
        return None if self.seconds is None else sum(self.seconds.values())
