"""Cutting the atlas into pieces for codecs, and putting it together again.

Notation: bs data voxels a side of a macroblock, B = bs + 2; a piece is uint8 [D, H, W, 4]. Two layouts:
- "atlas": some consecutive planes of the atlas, as they are.
- "grid": the data voxels of some consecutive layers of macroblocks where they lie in the grid, cropped to the
  macroblocks in use. Content continues from macroblock to macroblock, which predicts far better than the
  atlas's patchwork; the padding, 18 % of the voxels at bs = 30, is left out and copied again by
  scenepack.padding; what is empty costs next to nothing.
A pack keeps the layout and the planes of a piece; all else follows from its indirection grid, in any reader.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from scenepack.codecs.base import Layout, Shape
from scenepack.pack import Pack
from scenepack.padding import restore_padding


class Piece(Protocol):
    """Where in the atlas a piece's voxels lie."""

    @property
    def shape(self) -> Shape:
        """Its planes, rows and columns."""
        ...

    def gather(self, atlas: np.ndarray) -> np.ndarray:
        """The piece of an atlas [D, H, W, 4]."""
        ...

    def scatter(self, values: np.ndarray, atlas: np.ndarray) -> None:
        """Writes the piece back. Pieces of one pack touch different voxels, so threads may do it."""
        ...


@dataclass(frozen=True)
class AtlasPiece:
    """Planes z0 … z0 + shape[0] of the atlas; those past its end are zeros."""

    z0: int
    shape: Shape

    def gather(self, atlas: np.ndarray) -> np.ndarray:
        planes = atlas[self.z0 : self.z0 + self.shape[0]]
        return np.pad(planes, [(0, self.shape[0] - len(planes)), (0, 0), (0, 0), (0, 0)])

    def scatter(self, values: np.ndarray, atlas: np.ndarray) -> None:
        target = atlas[self.z0 : self.z0 + self.shape[0]]
        target[...] = values[: len(target)]


@dataclass(frozen=True)
class GridPiece:
    """Layers of the grid. where: int [n, 3], the macroblocks' places (z, y, x) in the piece, in blocks; slots: int
    [n, 3], theirs (z, y, x) in the atlas.
    """

    shape: Shape
    block_size: int
    where: np.ndarray
    slots: np.ndarray

    def gather(self, atlas: np.ndarray) -> np.ndarray:
        values = np.zeros((*self.shape, atlas.shape[3]), np.uint8)
        for inside, data in self._places():
            values[inside] = atlas[data]
        return values

    def scatter(self, values: np.ndarray, atlas: np.ndarray) -> None:
        for inside, data in self._places():
            atlas[data] = values[inside]

    def _places(self) -> list[tuple[tuple[slice, ...], tuple[slice, ...]]]:
        size = self.block_size
        return [
            (
                tuple(slice(i * size, (i + 1) * size) for i in block),
                tuple(slice(i * (size + 2) + 1, (i + 1) * (size + 2) - 1) for i in slot),
            )
            for block, slot in zip(self.where.tolist(), self.slots.tolist(), strict=True)
        ]


def cut(pack: Pack, layout: Layout, planes: int) -> list[Piece]:
    """All pieces of a pack, or of its outline; `planes` in each, but fewer in the last of the "grid" layout."""
    depth, height, width = pack.atlas_rgba.shape[:3]
    if layout == "atlas":
        return [AtlasPiece(z, (planes, height, width)) for z in range(0, depth, planes)]
    size = pack.block_size
    step = planes // size
    pieces: list[Piece] = []
    for start in range(0, pack.occupied.shape[0], step):
        where = np.argwhere(pack.occupied[start : start + step])
        if not len(where):
            continue
        low = where.min(axis=0)
        counts = where.max(axis=0) + 1 - low
        slots = pack.atlas_indices[start : start + step][tuple(where.T)].astype(np.intp)[:, ::-1]
        d, h, w = (int(n) * size for n in counts)
        pieces.append(GridPiece((d, h, w), size, where - low, slots))
    return pieces


def follows_grid(pack: Pack, atlas: np.ndarray) -> bool:
    """Whether the "grid" layout brings `atlas` back exactly: nothing outside of macroblocks, all padding a copy."""
    again = np.zeros_like(atlas)
    for piece in cut(pack, "grid", pack.block_size):
        piece.scatter(piece.gather(atlas), again)
    restore_padding(again, pack.atlas_indices, pack.block_size)
    return np.array_equal(atlas, again)
