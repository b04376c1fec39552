"""The sheet of thumbnails on the card: only cells that have arrived since the last frame travel."""

from __future__ import annotations

import moderngl
import numpy as np

from viewer.app.canvas_interface import Sheet

HALVINGS = 2  # mipmaps; cells are powers of two, so that neighbours do not mix at these sizes


class SheetTexture:
    """An RGB texture as large as a sheet. Textures that it no longer needs go to `retired`; see Canvas.sweep."""

    def __init__(self, ctx: moderngl.Context, retired: list[moderngl.Texture]) -> None:
        self.ctx, self._retired = ctx, retired
        self._texture: moderngl.Texture | None = None
        self._of: Sheet | None = None
        self._there: set[int] = set()

    def follow(self, sheet: Sheet) -> int:
        """OpenGL name of the texture with all of `sheet` that has arrived."""
        if self._texture is None or self._of is not sheet:
            self.release()
            height, width = sheet.sheet.shape[:2]
            self._texture, self._of = self.ctx.texture((width, height), 3, alignment=1), sheet
        arrived = [index for index in list(sheet.boxes) if index not in self._there]
        for index in arrived:
            x, y, width, height = sheet.boxes[index]
            pixels = np.ascontiguousarray(sheet.sheet[y : y + height, x : x + width])
            self._texture.write(pixels.tobytes(), (x, y, width, height), alignment=1)
        if arrived:
            self._there.update(arrived)
            self._texture.build_mipmaps(0, HALVINGS)
            self._texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        return self._texture.glo

    @property
    def gpu_bytes(self) -> int:
        """Texture memory in use, mipmaps included."""
        return 0 if self._texture is None else self._texture.width * self._texture.height * 4

    def release(self) -> None:
        """Frees the texture."""
        if self._texture is not None:
            self._retired.append(self._texture)
        self._texture, self._of, self._there = None, None, set()
