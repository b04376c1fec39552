"""A step of tuning from rays to cells, by compiled loops: samples that contribute, and the slopes that go back along them.

Notation: R rays of a step, in chunks of CHUNK; C samples of a chunk contribute; K cells.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from baker.tuning.cells import cell_at
from baker.tuning.marcher import LISTED, MAX_ALPHA, Tables, list_contributing
from scenepack.constants import TRANSMITTANCE_STOP
from training.multires.fused.compiled import kernel

CHUNK = 256  # rays
MOST_CORNERS = 8  # cells that a sample may touch
# d alpha / d log density of a stored alpha, where alpha = 1 - exp(-depth): depth exp(-depth); 0 where it is empty.
LOG_DENSITY = (
    -np.log1p(-np.minimum(np.arange(256) / 255, MAX_ALPHA)) * (1 - np.arange(256) / 255) / np.maximum(np.arange(256) / 255, 1e-6)
).astype(np.float32)  # fmt: skip


class Work(NamedTuple):
    """What a step lists. Of samples: at int64 [chunks, C] the lowest corner in the atlas; slot int32, local int32 [., 3] its cell
    in the copy; weights float32 [., 8] of the corners; before float32: T. first int32 [chunks, CHUNK + 1]: where a ray's begin.

    Of cells: cells int32 [chunks, 8 C], slopes float32 [., 8]; entries int64 [chunks]: how many. Of rays: sums float32 [R, 8],
    colour, features, T behind; whole bool [R]: which had room; supported int64 [chunks]: samples.
    """

    at: np.ndarray
    slot: np.ndarray
    local: np.ndarray
    weights: np.ndarray
    before: np.ndarray
    first: np.ndarray
    cells: np.ndarray
    slopes: np.ndarray
    entries: np.ndarray
    sums: np.ndarray
    whole: np.ndarray
    supported: np.ndarray


def work_for(rays: int, room: int) -> Work:
    """Unfilled arrays for `rays` rays, with up to `room` contributing samples a chunk."""
    chunks = -(-rays // CHUNK)
    listed = (chunks, room)
    return Work(
        np.empty(listed, np.int64), np.empty(listed, np.int32), np.empty((*listed, 3), np.int32),
        np.empty((*listed, 8), np.float32), np.empty(listed, np.float32), np.zeros((chunks, CHUNK + 1), np.int32),
        np.empty((chunks, MOST_CORNERS * room), np.int32), np.empty((chunks, MOST_CORNERS * room, 8), np.float32),
        np.zeros(chunks, np.int64), np.zeros((rays, 8), np.float32), np.zeros(rays, bool), np.zeros(chunks, np.int64),
    )  # fmt: skip


@njit(nogil=True, cache=True)
def gather_chunk(tables: Tables, rays, chunk, low, high, found, work):
    """Lists the contributing samples of rays low … high - 1, and accumulates them; rays without room count for nothing."""
    rgba, features, row, layer = tables.rgba, tables.features, np.int64(tables.row), np.int64(tables.layer)
    coloured, one, room = features.shape[0] > 0, np.float32(1.0), work.at.shape[1]
    total, n, supported = np.empty(8, np.float32), 0, 0
    for ray in range(low, high):
        work.first[chunk, ray - low] = n
        passed, k, listed, own = one, np.int64(0), LISTED, n
        total[:] = np.float32(0.0)
        while listed == LISTED and passed > np.float32(TRANSMITTANCE_STOP) and own <= room:
            count, k, listed = list_contributing(tables, rays, ray, k, found)
            supported += listed
            for i in range(count):
                if own == room:
                    own = room + 1
                    break
                scale = passed * np.float32(1 / 255)
                for corner in range(8):
                    place = found.at[i] + (corner >> 2) * layer + (corner >> 1 & 1) * row + (corner & 1)
                    share = found.weights[i, corner] * scale
                    work.weights[chunk, own, corner] = found.weights[i, corner]
                    for c in range(3):
                        total[c] += share * np.float32(rgba[place, c])
                    if coloured:
                        for c in range(4):
                            total[3 + c] += share * np.float32(features[place, c])
                work.at[chunk, own], work.slot[chunk, own], work.before[chunk, own] = found.at[i], found.slot[i], passed
                for axis in range(3):
                    work.local[chunk, own, axis] = found.cell[i, axis]
                own += 1
                passed *= one - min(found.alpha[i], np.float32(MAX_ALPHA))
                if passed <= np.float32(TRANSMITTANCE_STOP):
                    break
        work.whole[ray] = own <= room
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
    rgba, features, coloured = tables.rgba, tables.features, tables.features.shape[0] > 0
    value[:] = np.float32(0.0)
    for corner in range(8):
        place = at + (corner >> 2) * tables.layer + (corner >> 1 & 1) * tables.row + (corner & 1)
        share = weights[corner] * np.float32(1 / 255)
        for c in range(4):
            value[c] += share * np.float32(rgba[place, c])
            if coloured:
                value[4 + c] += share * np.float32(features[place, c])


@kernel
def _list_cells(tables, cells, log_density, of_value, chunk, n, entries, work):
    """Lists, from `entries` on, what the slopes of a sample's value float32 [8] say of the cells of its eight voxels; where
    others go. A stored voxel is alpha (colour, 1, features); delta adds to what is in brackets."""
    rgba, features, coloured = tables.rgba, tables.features, tables.features.shape[0] > 0
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
        cell = cell_at(cells.numbers, cells.dims, cells.side, x, y, z)
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
        for c in range(8 if coloured else 4):
            density += of_value[c] * np.float32(rgba[place, c] if c < 4 else features[place, c - 4]) * unit
            if c != 3:
                own[c] += share * of_value[c] * opacity
        own[3] += share * density * log_density[alpha]
    return entries
