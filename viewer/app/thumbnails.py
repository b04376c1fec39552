"""All photographs of a pack, very small, side by side on one sheet; read by a thread.

Notation: the sheet is cut into square cells of `cell` pixels, `columns` a row; shot i has cell i. The cell is as large as
lets the whole sheet fit into LARGEST_SHEET pixels a side, so that memory is bounded whatever the number of photographs.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from PIL import Image

from console import UserError
from training.scenes.pictures import PictureLoader
from viewer.app.background import Task
from viewer.app.photographs import Photographs

LARGEST_SHEET = 2048  # pixels a side: 12 MiB in memory
CELLS = (128, 64, 32)  # powers of two, so that the sheet can be halved for drawing without mixing neighbours
Box = tuple[int, int, int, int]


class Thumbnails(Task[None]):
    """Small pictures of `photographs`, from the moment this is made. Poll `news` from the main thread.

    sheet: uint8 [rows, columns, 3]. boxes: by shot, x, y, width, height of its picture on the sheet; a shot appears here
    once its pixels are there. problem: why the first that failed did.
    """

    def __init__(self, photographs: Photographs) -> None:
        self.photographs, self.folder = photographs, photographs.folder
        count = len(photographs)
        self.cell = next((cell for cell in CELLS if (LARGEST_SHEET // cell) ** 2 >= count), CELLS[-1])
        self.columns = LARGEST_SHEET // self.cell
        self.shown = min(count, self.columns**2)  # later ones get no picture
        rows = max(1, ceil(self.shown / self.columns))
        self.sheet = np.zeros((rows * self.cell, min(self.columns, max(count, 1)) * self.cell, 3), np.uint8)
        self.boxes: dict[int, Box] = {}
        self.problem = ""
        self._cancelled = False
        super().__init__(self._read)

    def state(self) -> object:
        return len(self.boxes)

    def cancel(self) -> None:
        """Gives up at the next photograph."""
        self._cancelled = True

    def _read(self) -> None:
        for index in range(self.shown):
            if self._cancelled:
                return
            try:
                picture = self._small(index)
            except Exception as error:  # one photograph that is gone or broken leaves its cell empty
                self.problem = self.problem or (str(error) if isinstance(error, UserError) else "it cannot be read")
                if self.photographs.reachable and not self.photographs.found:
                    return  # the scene cannot be read, nor could the others
                continue
            height, width = picture.shape[:2]
            x, y = index % self.columns * self.cell, index // self.columns * self.cell
            self.sheet[y : y + height, x : x + width] = picture
            self.boxes[index] = (x, y, width, height)

    def _small(self, index: int) -> np.ndarray:
        """uint8 [h, w, 3], over the scene's background, at most `cell` pixels a side."""
        if not self.photographs.reachable:
            picture = Image.fromarray(self.photographs.copy(index))
            picture.thumbnail((self.cell, self.cell), Image.Resampling.BOX)
            return np.asarray(picture)
        photograph = self.photographs.photograph(index)
        if isinstance(photograph.load, PictureLoader):
            picture = photograph.load.thumbnail(self.cell)
        else:
            picture = Image.fromarray(np.round(255 * photograph.load()).astype(np.uint8))
            picture.thumbnail((self.cell, self.cell), Image.Resampling.BOX)
        colour = tuple(round(255 * v) for v in self.photographs.background)
        behind = Image.new("RGBA", picture.size, (*colour, 255))
        return np.asarray(Image.alpha_composite(behind, picture.convert("RGBA")).convert("RGB"))
