"""Compiled loops of a step of joint tuning (joint_tuning): from rays to cells of a pack's voxels, and from cells to the atlas.

Notation: K cells of `side` voxels a side that hold any voxel with alpha, numbered from 1 in the grid's order; every copy in the
atlas of such a voxel is a place, and belongs to the voxel's cell. R rays of a step, in chunks of CHUNK; C samples of a chunk
contribute.
"""

# pyright: reportCallIssue=false

from typing import NamedTuple

import numpy as np
from numba import njit

from baker.tuning.marcher import LISTED, MAX_ALPHA, Tables, list_contributing
from scenepack.constants import TRANSMITTANCE_STOP
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
    """The cells of a pack's voxels, and their places."""

    side: int  # voxels
    dims: np.ndarray  # int64 [3]: cells along x, y, z
    numbers: np.ndarray  # int32 [z y x]: of each, 0 where no voxel has alpha
    first: np.ndarray  # int64 [K + 2]: where the places of each cell begin
    places: np.ndarray  # int64: flat indices in the atlas, cell by cell
    content: np.ndarray  # uint8 [places, 8]: rgb, alpha, features as they were, premultiplied
    odd: np.ndarray  # uint8 [places]: index into DITHER
    corners: np.ndarray  # int64 [slots, 3]: grid voxel (x, y, z) of the first voxel of each macroblock's copy

    @property
    def occupied(self) -> int:
        """How many cells have a voxel with alpha."""
        return len(self.first) - 2


def cells_of(pack: Pack, tables: Tables, side: int) -> Cells:
    corners = np.argwhere(pack.occupied)[:, ::-1].astype(np.int64) * pack.block_size - 1
    dims = -(-np.array(pack.grid_blocks, np.int64) * pack.block_size // side)
    numbers, nothing = np.zeros(int(dims.prod()), np.int32), np.zeros(0, np.int64)
    counted = Cells(side, dims, numbers, nothing, nothing, np.zeros((0, 8), np.uint8), np.zeros(0, np.uint8), corners)
    _visit(tables, counted, nothing)
    some = numbers > 0
    first = np.concatenate([np.zeros(2, np.int64), np.cumsum(numbers[some], dtype=np.int64)])
    numbers[some] = np.arange(1, len(first) - 1, dtype=np.int32)
    places, content = np.empty(first[-1], np.int64), np.zeros((first[-1], 8), np.uint8)
    cells = counted._replace(first=first, places=places, content=content, odd=np.zeros(first[-1], np.uint8))
    _visit(tables, cells, first[:-1].copy())
    return cells


@kernel(inline="always")
def _index(cells, x, y, z):
    """Where in cells.numbers the cell of a grid voxel is, -1 outside of the grid."""
    dims, side = cells.dims, cells.side
    if x < 0 or y < 0 or z < 0:
        return -1
    x, y, z = x // side, y // side, z // side
    if x >= dims[0] or y >= dims[1] or z >= dims[2]:
        return -1
    return (z * dims[1] + y) * dims[0] + x


@kernel
def _visit(tables, cells, free):
    """Counts the places of each cell in cells.numbers; padding has alpha where the voxel that it copies has. With free [K + 1],
    where each cell's next place goes, fills places, content and odd instead."""
    wide, corners = tables.size + 2, cells.corners
    for slot in range(len(corners)):
        for z in range(wide):
            for y in range(wide):
                for x in range(wide):
                    at = tables.first[slot] + z * tables.layer + y * tables.row + x
                    if tables.rgba[at, 3] == 0:
                        continue
                    i, j, k = corners[slot, 0] + x, corners[slot, 1] + y, corners[slot, 2] + z
                    index = _index(cells, i, j, k)
                    if index < 0:
                        continue
                    if len(free) == 0:
                        cells.numbers[index] += 1
                        continue
                    place = free[cells.numbers[index]]
                    free[cells.numbers[index]] += 1
                    cells.places[place], cells.odd[place] = at, (i & 1) + 2 * (j & 1) + 4 * (k & 1)
                    for c in range(4):
                        cells.content[place, c] = tables.rgba[at, c]
                        cells.content[place, 4 + c] = tables.features[at, c]


# --- From rays to cells: samples that contribute, and the slopes that go back along them ---

CHUNK = 256  # rays
MOST_CORNERS = 8  # cells that a sample may touch
# d alpha / d log density of a stored alpha, where alpha = 1 - exp(-depth): depth exp(-depth); 0 where it is empty.
LOG_DENSITY = (
    -np.log1p(-np.minimum(np.arange(256) / 255, MAX_ALPHA)) * (1 - np.arange(256) / 255) / np.maximum(np.arange(256) / 255, 1e-6)
).astype(np.float32)  # fmt: skip


class Work(NamedTuple):
    """What a step lists of samples [chunks, C], of cells, and of rays."""

    at: np.ndarray  # int64 [chunks, C]: a sample's lowest corner in the atlas
    slot: np.ndarray  # int32 [chunks, C]
    local: np.ndarray  # int32 [chunks, C, 3]: its cell in the copy
    weights: np.ndarray  # float32 [chunks, C, 8], of the corners
    before: np.ndarray  # float32 [chunks, C]: T
    first: np.ndarray  # int32 [chunks, CHUNK + 1]: where a ray's samples begin
    cells: np.ndarray  # int32 [chunks, 8 C]
    slopes: np.ndarray  # float32 [chunks, 8 C, 8]
    entries: np.ndarray  # int64 [chunks]: how many cells are listed
    sums: np.ndarray  # float32 [R, 8]: colour, features, T behind
    whole: np.ndarray  # bool [R]: which rays fitted into the capacity
    supported: np.ndarray  # int64 [chunks]: samples with support


def work_for(rays: int, capacity: int) -> Work:
    """Unfilled arrays for `rays` rays, with up to `capacity` contributing samples a chunk."""
    chunks = -(-rays // CHUNK)
    listed = (chunks, capacity)
    return Work(
        np.empty(listed, np.int64), np.empty(listed, np.int32), np.empty((*listed, 3), np.int32),
        np.empty((*listed, 8), np.float32), np.empty(listed, np.float32), np.zeros((chunks, CHUNK + 1), np.int32),
        np.empty((chunks, MOST_CORNERS * capacity), np.int32), np.empty((chunks, MOST_CORNERS * capacity, 8), np.float32),
        np.zeros(chunks, np.int64), np.zeros((rays, 8), np.float32), np.zeros(rays, bool), np.zeros(chunks, np.int64),
    )  # fmt: skip


@njit(nogil=True, cache=True)
def gather_chunk(tables: Tables, rays, chunk, low, high, found, work):
    """Lists the contributing samples of rays low … high - 1, and accumulates them; of rays beyond the capacity, nothing."""
    rgba, features, row, layer = tables.rgba, tables.features, np.int64(tables.row), np.int64(tables.layer)
    one, capacity, total, n, supported = np.float32(1.0), work.at.shape[1], np.empty(8, np.float32), 0, 0
    for ray in range(low, high):
        work.first[chunk, ray - low] = n
        passed, k, listed, own = one, np.int64(0), LISTED, n
        total[:] = np.float32(0.0)
        while listed == LISTED and passed > np.float32(TRANSMITTANCE_STOP) and own <= capacity:
            count, k, listed = list_contributing(tables, rays, ray, k, found)
            supported += listed
            for i in range(count):
                if own == capacity:
                    own = capacity + 1
                    break
                scale = passed * np.float32(1 / 255)
                for corner in range(8):
                    place = found.at[i] + (corner >> 2) * layer + (corner >> 1 & 1) * row + (corner & 1)
                    share = found.weights[i, corner] * scale
                    work.weights[chunk, own, corner] = found.weights[i, corner]
                    for c in range(3):
                        total[c] += share * np.float32(rgba[place, c])
                    for c in range(4):
                        total[3 + c] += share * np.float32(features[place, c])
                work.at[chunk, own], work.slot[chunk, own], work.before[chunk, own] = found.at[i], found.slot[i], passed
                for axis in range(3):
                    work.local[chunk, own, axis] = found.cell[i, axis]
                own += 1
                passed *= one - min(found.alpha[i], np.float32(MAX_ALPHA))
                if passed <= np.float32(TRANSMITTANCE_STOP):
                    break
        work.whole[ray] = own <= capacity
        if work.whole[ray]:
            n = own
            for c in range(7):
                work.sums[ray, c] = total[c]
            work.sums[ray, 7] = passed
        else:
            work.sums[ray, :7] = np.float32(0.0)
            work.sums[ray, 7] = one
    work.first[chunk, high - low] = n
    work.supported[chunk] = supported


@njit(nogil=True, cache=True)
def slope_chunk(tables: Tables, cells, log_density, slopes, chunk, low, high, work):
    """Lists what the loss's slopes float32 [R, 8] of sums of rays low … high - 1 say of cells.

    Back along a ray: with G = dL/dT behind a sample of v = (colour, features) and alpha, dL/dv = T s, dL/d alpha = -T G, and
    dL/dT before it = (1 - alpha) G + v · s.
    """
    one, most = np.float32(1.0), np.float32(MAX_ALPHA)
    value, of_value, entries = np.empty(8, np.float32), np.empty(8, np.float32), 0
    for ray in range(low, high):
        behind = slopes[ray, 7]
        for n in range(work.first[chunk, ray - low + 1] - 1, work.first[chunk, ray - low] - 1, -1):
            _interpolate(tables, work.at[chunk, n], work.weights[chunk, n], value)
            passed, change = work.before[chunk, n], np.float32(0.0)
            for c in range(7):
                channel = c if c < 3 else c + 1  # alpha lies between
                of_value[channel] = passed * slopes[ray, c]
                change += slopes[ray, c] * value[channel]
            of_value[3] = -passed * behind if value[3] < most else np.float32(0.0)
            entries = _list_cells(tables, cells, log_density, of_value, chunk, n, entries, work)
            behind = (one - min(value[3], most)) * behind + change
    work.entries[chunk] = entries


@kernel
def _interpolate(tables, at, weights, value):
    """value float32 [8]: colour, alpha, features between the eight voxels from `at` on."""
    value[:] = np.float32(0.0)
    for corner in range(8):
        place = at + (corner >> 2) * tables.layer + (corner >> 1 & 1) * tables.row + (corner & 1)
        share = weights[corner] * np.float32(1 / 255)
        for c in range(4):
            value[c] += share * np.float32(tables.rgba[place, c])
            value[4 + c] += share * np.float32(tables.features[place, c])


@kernel
def _list_cells(tables, cells, log_density, of_value, chunk, n, entries, work):
    """Lists, from `entries` on, what the slopes of a sample's value float32 [8] say of the cells of its eight voxels; where
    others go. A stored voxel is alpha (colour, 1, features); delta adds to what is in brackets."""
    rgba, features = tables.rgba, tables.features
    corners, local, slot, unit = cells.corners, work.local, work.slot[chunk, n], np.float32(1 / 255)
    begun = entries
    for corner in range(8):
        right, down, deeper = corner & 1, corner >> 1 & 1, corner >> 2
        place = work.at[chunk, n] + deeper * tables.layer + down * tables.row + right
        alpha, share = rgba[place, 3], work.weights[chunk, n, corner]
        if alpha == 0 or share == 0:
            continue
        x, y = corners[slot, 0] + local[chunk, n, 0] + right, corners[slot, 1] + local[chunk, n, 1] + down
        z = corners[slot, 2] + local[chunk, n, 2] + deeper
        index = _index(cells, x, y, z)
        cell = cells.numbers[index] if index >= 0 else 0
        if cell == 0:
            continue
        entry = begun
        while entry < entries and work.cells[chunk, entry] != cell:
            entry += 1
        if entry == entries:
            entries += 1
            work.cells[chunk, entry] = cell
            work.slopes[chunk, entry] = np.float32(0.0)
        own, opacity, density = work.slopes[chunk, entry], np.float32(alpha) * unit, np.float32(0.0)
        for c in range(8):
            density += of_value[c] * np.float32(rgba[place, c] if c < 4 else features[place, c - 4]) * unit
            if c != 3:
                own[c] += share * of_value[c] * opacity
        own[3] += share * density * log_density[alpha]
    return entries


# --- From cells to the atlas ---


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
            for c in range(4):
                straight = np.float32(content[place, 4 + c]) * share + delta[cell, 4 + c]
                features[at, c] = _rounded(min(max(straight, np.float32(0)), ONE) * alpha, steps[4 + c], HALF, alpha)


@kernel
def add_slopes(work, slopes, met, low, high):
    """slopes [K + 1, 8] += what Work lists of cells low … high - 1; met uint8 [K + 1]: which any is
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
