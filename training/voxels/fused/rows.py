"""From the slopes of samples to the rows of the grid: total variation, scatter, Adam.

Every worker owns a range of rows and walks over all samples in their order, so each row's sum runs in one order, whatever
the number of workers: results do not depend on threads, one accumulator is enough, and nothing is merged.

Notation: rows [V + 1, 8], row 0 stands for absent voxels and never learns; P voxels whose variation is looked at.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from training.voxels.fused.bricks import Bricks, row_of
from training.voxels.fused.vectors import adam_row, add_scaled, population_count
from training.voxels.settings import ADAM_BETAS

BETA1, BETA2 = ADAM_BETAS
WORD = 64  # rows of one word of marks; ranges begin at multiples of it


class Variation(NamedTuple):
    """near int32 [P, 4]: rows of voxels and of their neighbours along +x, +y, +z. slopes float32 [P * 4, 8]. sums float64 [T, 2]:
    norms of raw density and of raw colours, by worker's part."""

    near: np.ndarray
    slopes: np.ndarray
    sums: np.ndarray


@njit(nogil=True, cache=True)
def variation(bricks: Bricks, rows, picked, weights, part, variation, low, high):
    """Total variation of picked voxels low … high - 1 and its slopes: weights [8] per channel, of the sum of norms."""
    slots, bits, base = bricks.slots, bricks.bits, bricks.base
    width, height = np.int64(bricks.shape[0]), np.int64(bricks.shape[1])
    density, colours = 0.0, 0.0
    for p in range(low, high):
        row = picked[p]
        x, y, z = bricks.coordinates[row, 0], bricks.coordinates[row, 1], bricks.coordinates[row, 2]
        near = variation.near[p]
        near[0] = row
        near[1] = row_of(slots, bits, base, width, height, x + 1, y, z)
        near[2] = row_of(slots, bits, base, width, height, x, y + 1, z)
        near[3] = row_of(slots, bits, base, width, height, x, y, z + 1)
        for c in range(8):
            total = np.float32(1e-6)
            for axis in range(1, 4):
                change = rows[near[axis], c] - rows[row, c] if near[axis] > 0 else np.float32(0.0)
                variation.slopes[4 * p + axis, c] = change
                total += change * change
            norm = np.sqrt(total)
            scale = weights[c] / norm
            own = np.float32(0.0)
            for axis in range(1, 4):
                slope = variation.slopes[4 * p + axis, c] * scale
                variation.slopes[4 * p + axis, c] = slope
                own -= slope
            variation.slopes[4 * p, c] = own
            if c == 0:
                density += norm
            else:
                colours += norm
    variation.sums[part, 0], variation.sums[part, 1] = density, colours


@njit(nogil=True, cache=True)
def gather_slopes(work, room, variation, scale, slopes, marks, low, high):
    """slopes[row] += what samples and variation say of rows low … high - 1; marks a bit for each row that is touched.

    scale: of the variation's slopes, which are a mean where the samples' are a sum over rays.
    """
    width = np.uint32(high - low)
    ids, weights, values, near, rough = work.ids, work.weights, work.slopes, variation.near, variation.slopes
    for chunk in range(work.counts.shape[0]):
        for n in range(chunk * room, chunk * room + work.counts[chunk]):
            for corner in range(8):
                row = ids[n, corner]
                if np.uint32(row - low) < width and row > 0:
                    add_scaled(slopes, row, weights[n, corner], values, n)
                    marks[row >> 6] |= np.uint64(1) << np.uint64(row & 63)
    for p in range(near.shape[0]):
        for k in range(4):
            row = near[p, k]
            if np.uint32(row - low) < width and row > 0:
                add_scaled(slopes, row, scale, rough, 4 * p + k)
                marks[row >> 6] |= np.uint64(1) << np.uint64(row & 63)


@njit(nogil=True, cache=True)
def adam_rows(rows, first, second, slopes, marks, rates, scale, low, high):
    """Adam for the marked rows low … high - 1 whose density has a slope (DVGO's masked Adam); clears slopes and marks."""
    keep1, keep2, one = np.float32(BETA1), np.float32(BETA2), np.uint64(1)
    for word in range(low >> 6, (high + 63) >> 6):
        bits = marks[word]
        marks[word] = np.uint64(0)
        while bits != np.uint64(0):
            row = np.int64(word) * WORD + population_count(~bits & (bits - one))  # the lowest bit that is set
            bits &= bits - one
            if slopes[row, 0] != 0:
                adam_row(rows, first, second, slopes, row, rates, scale, keep1, keep2)
            else:
                slopes[row, :] = np.float32(0.0)


@njit(nogil=True, cache=True)
def remember(bricks: Bricks, rows, shift, reference, thickness, units, deepest, low, high):
    """Writes the optical depth of a step into the support of slots low … high - 1, as sparse_grid.with_depths does."""
    slots, bits, base = bricks.slots, bricks.bits, bricks.base
    width, height = np.int64(bricks.shape[0]), np.int64(bricks.shape[1])
    for slot in range(low, high):
        if bricks.supported[slot] == 0:
            continue
        brick = bricks.corners[slot]
        for local in range(64):
            if bricks.support[slot, local] == 0:
                continue
            x, y, z = brick[0] + (local & 3), brick[1] + (local >> 2 & 3), brick[2] + (local >> 4)
            total = np.float32(0.0)
            for corner in range(8):
                right, down, deeper = x + (corner & 1), y + (corner >> 1 & 1), z + (corner >> 2)
                total += rows[row_of(slots, bits, base, width, height, right, down, deeper), 0]
            value = total * np.float32(0.125) + shift
            sigma = (max(value, np.float32(0.0)) + np.log1p(np.exp(-abs(value)))) / reference
            bricks.support[slot, local] = np.uint8(1 + min(max(np.int64(sigma * thickness * units), 0), deepest))
