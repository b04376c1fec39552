"""The cells of a pack's voxels, and how they change what the atlas stores, by compiled loops; see baker.tuning.tuner.

Notation: K cells of `side` voxels a side that hold any voxel with alpha, numbered from 1 in the grid's order; every copy in the
atlas of such a voxel is a place, and belongs to the voxel's cell.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baker.tuning.marcher import Tables
from scenepack.pack import Pack
from training.multires.fused.compiled import kernel

BETAS = (0.9, 0.99)
TINY = 1e-12  # keeps Adam's denominator from zero
TOP = 254.75  # stands for an alpha of 255, whose optical depth would be infinite
# What is added to a voxel's colour, in coarse steps, before it is rounded down (ordered dithering, in three dimensions), by
# whether its place in the grid is odd: x + 2 y + 4 z. What is rounded up and down cancels along a ray: on the demo, errors of
# steps of 4 are 2.6 dB below those of plain rounding. Features, which a view MLP bends, gain nothing by that.
DITHER = ((np.array([0, 4, 6, 2, 5, 1, 3, 7]) + 0.5) / 8).astype(np.float32)
DEPTHS = -np.log1p(-np.minimum(np.arange(256), TOP) / 255).astype(np.float32)  # optical depth of a stored alpha
BETA1, BETA2 = (np.float32(beta) for beta in BETAS)
HALF, ONE = np.float32(0.5), np.float32(1.0)


class Cells(NamedTuple):
    """side: voxels. dims int64 [3]: cells along x, y, z. numbers int32 [z y x]: of each, 0 where no voxel has alpha.

    first int64 [K + 2]: where the places of each cell begin; places int64: flat indices in the atlas, cell by cell. content
    uint8 [places, 8]: rgb, alpha, features as they were, premultiplied. odd uint8 [places]: index into DITHER. corners int64
    [slots, 3]: grid voxel (x, y, z) of the first voxel of each macroblock's copy.
    """

    side: int
    dims: np.ndarray
    numbers: np.ndarray
    first: np.ndarray
    places: np.ndarray
    content: np.ndarray
    odd: np.ndarray
    corners: np.ndarray

    @property
    def count(self) -> int:
        return len(self.first) - 2


def cells_of(pack: Pack, tables: Tables, side: int) -> Cells:
    """The cells of a pack's voxels."""
    corners = np.argwhere(pack.occupied)[:, ::-1].astype(np.int64) * pack.block_size - 1
    dims = -(-np.array(pack.grid_blocks, np.int64) * pack.block_size // side)
    numbers = np.zeros(int(dims.prod()), np.int32)
    _count(tables, corners, side, dims, numbers)
    some = numbers > 0
    first = np.concatenate([np.zeros(2, np.int64), np.cumsum(numbers[some], dtype=np.int64)])
    numbers[some] = np.arange(1, len(first) - 1, dtype=np.int32)
    places = np.empty(first[-1], np.int64)
    content = np.zeros((first[-1], 8), np.uint8)
    cells = Cells(side, dims, numbers, first, places, content, np.zeros(first[-1], np.uint8), corners)
    _place(tables, cells, first[:-1].copy())
    return cells


@kernel(inline="always")
def _index(dims, side, x, y, z):
    """Where in Cells.numbers the cell of a grid voxel is, -1 outside of the grid."""
    if x < 0 or y < 0 or z < 0:
        return -1
    x, y, z = x // side, y // side, z // side
    if x >= dims[0] or y >= dims[1] or z >= dims[2]:
        return -1
    return (z * dims[1] + y) * dims[0] + x


@kernel(inline="always")
def cell_at(numbers, dims, side, x, y, z):
    """The cell of a grid voxel, 0 outside of the grid."""
    index = _index(dims, side, x, y, z)
    return numbers[index] if index >= 0 else 0


@kernel
def _count(tables, corners, side, dims, counts):
    """counts int32 [z y x]: places of each cell. Where padding has alpha, so has the voxel that it copies."""
    wide = tables.size + 2
    for slot in range(len(corners)):
        for z in range(wide):
            for y in range(wide):
                for x in range(wide):
                    if tables.rgba[tables.first[slot] + z * tables.layer + y * tables.row + x, 3] != 0:
                        i, j, k = corners[slot, 0] + x, corners[slot, 1] + y, corners[slot, 2] + z
                        index = _index(dims, side, i, j, k)
                        if index >= 0:
                            counts[index] += 1


@kernel
def _place(tables, cells, free):
    """Fills places, content and odd; free [K + 1]: where each cell's next place goes."""
    wide, corners = tables.size + 2, cells.corners
    coloured = tables.features.shape[0] > 0
    for slot in range(len(corners)):
        for z in range(wide):
            for y in range(wide):
                for x in range(wide):
                    at = tables.first[slot] + z * tables.layer + y * tables.row + x
                    if tables.rgba[at, 3] == 0:
                        continue
                    i, j, k = corners[slot, 0] + x, corners[slot, 1] + y, corners[slot, 2] + z
                    cell = cell_at(cells.numbers, cells.dims, cells.side, i, j, k)
                    if cell > 0:
                        place = free[cell]
                        free[cell] += 1
                        cells.places[place], cells.odd[place] = at, (i & 1) + 2 * (j & 1) + 4 * (k & 1)
                        for c in range(4):
                            cells.content[place, c] = tables.rgba[at, c]
                            if coloured:
                                cells.content[place, 4 + c] = tables.features[at, c]


@kernel(inline="always")
def _rounded(value, step, up, alpha):
    """The value in units, or as one of the two levels beside it: multiples of `step`, and alpha, for all is premultiplied.
    up: what is added, in levels, before it is rounded down."""
    if step == ONE:
        return np.uint8(np.rint(value))
    low = np.floor(value / step) * step
    high = min(low + step, alpha)
    return np.uint8(high if value - low + up * (high - low) >= high - low else low)


@kernel
def store_cells(cells, depths, delta, steps, some, rgba, features, low, high):
    """Writes the voxels of cells some[low … high - 1], moved by delta float32 [K + 1, 8], to all their places in the atlas, in
    multiples of steps float32 [8]."""
    first, places, content = cells.first, cells.places, cells.content
    coloured = features.shape[0] > 0
    for n in range(low, high):
        cell = some[n]
        thicker = np.exp(delta[cell, 3])
        for place in range(first[cell], first[cell + 1]):
            at, before, up = places[place], content[place, 3], DITHER[cells.odd[place]]
            alpha = min(-np.expm1(-depths[before] * thicker) * np.float32(255), np.float32(TOP))
            alpha = np.float32(max(_rounded(alpha, steps[3], HALF, np.float32(255)), steps[3]))
            share = ONE / np.float32(before)
            rgba[at, 3] = np.uint8(alpha)
            for c in range(3):
                straight = np.float32(content[place, c]) * share + delta[cell, c]
                rgba[at, c] = _rounded(min(max(straight, np.float32(0)), ONE) * alpha, steps[c], up, alpha)
            if coloured:
                for c in range(4):
                    straight = np.float32(content[place, 4 + c]) * share + delta[cell, 4 + c]
                    value = min(max(straight, np.float32(0)), ONE) * alpha
                    features[at, c] = _rounded(value, steps[4 + c], HALF, alpha)


@kernel
def add_slopes(work, slopes, met, low, high):
    """slopes [K + 1, 8] += what baker.tuning.gradients.Work lists of cells low … high - 1; met uint8 [K + 1]: which any is
    listed of. In the work's order, however many threads share the cells."""
    for chunk in range(len(work.entries)):
        for n in range(work.entries[chunk]):
            cell = work.cells[chunk, n]
            if low <= cell < high:
                met[cell] = 1
                for c in range(8):
                    slopes[cell, c] += work.slopes[chunk, n, c]


@kernel
def move_moments(slopes, met, first, second, sums, part, low, high):
    """First and second moments of cells low … high - 1 that were met; sums float64 [parts, 2, 8]: of all second moments, and how
    many are not 0, both kept from step to step."""
    for cell in range(low, high):
        if met[cell]:
            met[cell] = 0
            for c in range(8):
                if slopes[cell, c] != 0:
                    met[cell] = 1
        if met[cell]:
            for c in range(8):
                slope, before = slopes[cell, c], second[cell, c]
                first[cell, c] = BETA1 * first[cell, c] + (ONE - BETA1) * slope
                second[cell, c] = BETA2 * before + (ONE - BETA2) * slope * slope
                sums[part, 0, c] += second[cell, c] - before
                sums[part, 1, c] += (second[cell, c] > 0) - (before > 0)


@kernel
def move_cells(delta, slopes, first, second, floor, rates, some, low, high):
    """A step of Adam on cells some[low … high - 1], whose slopes are then 0; rates, floor float32 [8]."""
    for n in range(low, high):
        cell = some[n]
        for c in range(8):
            delta[cell, c] -= rates[c] * first[cell, c] / (np.sqrt(second[cell, c]) + floor[c] + np.float32(TINY))
            slopes[cell, c] = 0.0
