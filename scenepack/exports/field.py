"""A pack's voxels as a field that is read box by box: opacity and colour, cropped, and coarser where that is asked for.

Notation: f: voxels of the pack along the side of one of the field's; *cells* are the field's voxels, whose centre i is at grid
position f (i + 0.5). A coarser cell takes the mean of its f^3 voxels; a ray meets 1/f as many, so that its opacity a becomes
1 - (1 - a)^f, as in scenepack.coarse, rounded to 8 bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from scenepack.blocks import block_copy
from scenepack.pack import Pack

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
Place = tuple[int, int, int]


class Field:
    """crop: corners (min, max) of a box in the grid frame; voxels whose centre is not in it are empty."""

    def __init__(self, pack: Pack, coarser: int = 1, crop: Corners | None = None) -> None:
        if coarser < 1 or pack.block_size % coarser:
            raise ValueError(f"{coarser} does not divide the block size {pack.block_size}")
        self.pack, self.coarser = pack, coarser
        self.side = pack.block_size // coarser  # of a macroblock, in cells
        self._low, self._high = np.zeros(3, int), np.asarray(pack.grid_size[::-1])
        self._coarse: dict[Place, np.ndarray] = {}  # small, and each is asked for up to eight times
        if crop is not None:
            corners = (np.sort(np.asarray(crop, np.float64), axis=0) - pack.min_xyz) / pack.voxel_size
            inside = np.ceil(corners - 0.5).astype(np.int64)[:, ::-1]
            self._low, self._high = np.maximum(inside[0], self._low), np.minimum(inside[1], self._high)

    @property
    def occupied(self) -> list[Place]:
        """Macroblocks (z, y, x) that hold something within the crop box."""
        size = self.pack.block_size
        places = np.argwhere(self.pack.occupied)
        reached = np.all((places * size < self._high) & ((places + 1) * size > self._low), axis=1)
        return [(z, y, x) for z, y, x in places[reached].tolist()]

    def block(self, place: Place) -> np.ndarray | None:
        """Premultiplied rgba, float32 [side, side, side, 4] in 0 ... 1, of a macroblock; None where it is empty or outside."""
        blocks = self.pack.occupied
        if any(not 0 <= i < n for i, n in zip(place, blocks.shape, strict=True)) or not blocks[place]:
            return None
        if place in self._coarse:
            return self._coarse[place]
        voxels = block_copy(self.pack, self.pack.atlas_rgba, place)[1:-1, 1:-1, 1:-1].astype(np.float32) / 255.0
        size, f = self.pack.block_size, self.coarser
        for axis in range(3):
            index = place[axis] * size + np.arange(size)
            outside = (index < self._low[axis]) | (index >= self._high[axis])
            if outside.any():
                voxels[(slice(None),) * axis + (outside,)] = 0.0
        if f == 1:
            return voxels
        mean = voxels / f**3
        for axis in range(3):  # strided sums are several times as fast as a mean over three axes
            mean = np.add.reduce([mean[(slice(None),) * axis + (slice(i, None, f),)] for i in range(f)])
        alpha = mean[..., 3:]
        grown = np.rint(255.0 * (1.0 - (1.0 - np.minimum(alpha, 1.0)) ** f)) / 255.0
        self._coarse[place] = (mean * grown / np.maximum(alpha, 1e-9)).astype(np.float32)
        return self._coarse[place]

    def with_next(self, place: Place) -> np.ndarray | None:
        """The macroblock's cells and one more on its far sides, float32 [side + 1, ...]; None where all of them are empty."""
        box: np.ndarray | None = None
        for step in product((0, 1), repeat=3):
            cells = self.block((place[0] + step[0], place[1] + step[1], place[2] + step[2]))
            if cells is None:
                continue
            if box is None:
                box = np.zeros((*(self.side + 1,) * 3, 4), np.float32)
            to = tuple(slice(self.side, None) if s else slice(0, self.side) for s in step)
            of = tuple(slice(0, 1) if s else slice(None) for s in step)
            box[to] = cells[of]
        return box

    def boxes(self) -> Iterator[tuple[Place, np.ndarray]]:
        """Boxes whose cubes of neighbouring cells are all cubes that something lies in, each once: see with_next."""
        places = {(z - dz, y - dy, x - dx) for z, y, x in self.occupied for dz, dy, dx in product((0, 1), repeat=3)}
        for place in sorted(places):
            box = self.with_next(place)
            if box is not None:
                yield place, box

    @property
    def count(self) -> int:
        """How many boxes there are, about: for progress."""
        return max(2 * len(self.occupied), 1)

    def crossings(self, level: float) -> int:
        """How often opacity passes `level` between neighbours along x: a measure of the surface, in cells. Reads all voxels."""
        total = 0
        for place in self.occupied:
            cells = self.block(place)
            if cells is not None:
                above = cells[..., 3] > level
                total += int(np.count_nonzero(above[:, :, 1:] != above[:, :, :-1]))
        return total
