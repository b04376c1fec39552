"""Rejected photographs: those without a camera pose and those that were not used, with reasons and thumbnails.

training.posing writes the list beside the poses, or in its working folder if it failed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from console import UserError
from console.json_text import read_json_file
from training.scenes.pictures import UNREADABLE, small_picture
from viewer.app.background import Task
from viewer.app.files import POSED, REPORT

UNFINISHED = Path("posing") / "left_out.json"
CELL, MOST = 128, 24  # pixels of the longer side; number of thumbnails
Box = tuple[int, int, int, int]


class RejectedPhotographs(Task[None]):
    """Reads the thumbnails in a thread.

    why: reason by name, in order.
    sheet: uint8 [CELL, width, 3]; None before all are read.
    boxes: x, y, width, height in the sheet by name; unreadable pictures have none.
    """

    def __init__(self, why: Mapping[str, str], files: Mapping[str, Path]) -> None:
        self.why = why
        self.sheet: np.ndarray | None = None
        self.boxes: dict[str, Box] = {}
        self._files = files
        super().__init__(self._read)

    def _read(self) -> None:
        pictures: list[np.ndarray] = []
        x = 0
        for name in list(self.why)[:MOST]:
            try:
                picture = np.asarray(small_picture(self._files[name], CELL, "RGB"))
            except (UserError, *UNREADABLE):  # gone since, or one that only the program that finds poses can read
                continue
            height, width = picture.shape[:2]
            self.boxes[name] = (x, 0, width, height)
            pictures.append(np.pad(picture, ((0, CELL - height), (0, 0), (0, 0))))
            x += width
        if pictures:
            self.sheet = np.concatenate(pictures, axis=1)


def rejected_photographs_of(out: Path) -> RejectedPhotographs | None:
    """Those listed in the folder for the results; None if there is no list or it is empty."""
    for file in (out / POSED / REPORT, out / UNFINISHED):
        try:
            said = read_json_file(file)
            why = {str(name): str(reason) for name, reason in said["left_out"].items()}
            source, kept = Path(said["photographs"]), dict(said.get("files", {}))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        files = {name: Path(kept[name]) if name in kept else source / name for name in why}
        return RejectedPhotographs(why, files) if why else None
    return None
