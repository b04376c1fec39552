"""What is asked of a state besides its steps: which rays meet content, which voxels are seen, values between voxels, and
what rays gather on their way.

Notation: N rays of a batch in grid coordinates; V voxels; T workers.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

import numpy as np
from numba import njit

from training.voxels.fused.bricks import Bricks, row_of
from training.voxels.fused.render import (
    CHUNK,
    CLOSE,
    composite_chunk,
    fetch_chunk,
    leaving,
    march_chunk,
    sigmoid_in_place,
)


@njit(nogil=True, cache=True)
def rays_meet(bricks: Bricks, batch, step, meets, low, high):
    """meets[n]: whether ray n of low … high - 1 has support at any of its samples, `step` voxels apart."""
    slots, blocks, support, supported = bricks.slots, bricks.blocks, bricks.support, bricks.supported
    most_x, most_y, most_z = np.int64(bricks.dims[0]), np.int64(bricks.dims[1]), np.int64(bricks.dims[2])
    width, height = np.int64(bricks.shape[0]), np.int64(bricks.shape[1])
    blocks_wide, blocks_high = np.int64(bricks.block_shape[0]), np.int64(bricks.block_shape[1])
    half, close = np.float32(0.5), np.float32(CLOSE)
    for ray in range(low, high):
        ox, oy, oz = batch.origins[ray, 0], batch.origins[ray, 1], batch.origins[ray, 2]
        dx, dy, dz = batch.directions[ray, 0], batch.directions[ray, 1], batch.directions[ray, 2]
        along, stop = batch.start[ray], batch.end[ray]
        meets[ray] = False
        while along < stop:
            x = min(max(np.int64(np.floor(ox + along * dx - half)) + 1, 0), most_x)
            y = min(max(np.int64(np.floor(oy + along * dy - half)) + 1, 0), most_y)
            z = min(max(np.int64(np.floor(oz + along * dz - half)) + 1, 0), most_z)
            slot = slots[((z >> 2) * height + (y >> 2)) * width + (x >> 2)]
            if slot < 0 or supported[slot] == 0:
                side = 4 if blocks[((z >> 4) * blocks_high + (y >> 4)) * blocks_wide + (x >> 4)] == 0 else 2
                out = min(leaving(ox, dx, x, side), leaving(oy, dy, y, side), leaving(oz, dz, z, side))
                along = max(out + close, along + close)
                continue
            if support[slot, ((z & 3) * 4 + (y & 3)) * 4 + (x & 3)] != 0:
                meets[ray] = True
                break
            along += step


@njit(nogil=True, cache=True)
def raise_weights(low, high, bricks, rows, batch, numbers, work, scratch, best):
    """Raises best [V + 1] to the weights of the samples of ray chunks low … high - 1, by the voxel that each lies in."""
    one = np.float32(1.0)
    for chunk in range(low, high):
        march_chunk(chunk, bricks, batch, numbers, work, scratch)
        offset, first = chunk * scratch.t.shape[0], scratch.first
        for r in range(min(CHUNK, batch.start.shape[0] - chunk * CHUNK)):
            transmitted, thickness = one, numbers.step * batch.length[chunk * CHUNK + r]
            for n in range(offset + first[r], offset + first[r + 1]):
                raw, nearest = numbers.shift, 0
                for corner in range(8):
                    raw += work.weights[n, corner] * rows[work.ids[n, corner], 0]
                    if work.weights[n, corner] > work.weights[n, nearest]:
                        nearest = corner
                sigma = (max(raw, np.float32(0.0)) + np.log1p(np.exp(-abs(raw)))) / numbers.reference
                weight = transmitted * (one - np.exp(-sigma * thickness))
                transmitted -= weight
                row = work.ids[n, nearest]
                best[row] = max(best[row], weight)


@njit(nogil=True, cache=True)
def interpolate(bricks: Bricks, rows, origin, voxel, points, values, low, high):
    """Raw values [N, 8] at world points low … high - 1 of [N, 3], as training.voxels.sparse_grid.interpolate."""
    slots, bits, base = bricks.slots, bricks.bits, bricks.base
    width, height = np.int64(bricks.shape[0]), np.int64(bricks.shape[1])
    cell, fraction = np.zeros(3, np.int64), np.zeros(3, np.float32)
    for n in range(low, high):
        for axis in range(3):
            g = (np.float64(points[n, axis]) - origin[axis]) / voxel[axis] - 0.5
            lower = np.floor(g)
            cell[axis] = min(max(np.int64(lower) + 1, 0), np.int64(bricks.dims[axis]))
            fraction[axis] = g - lower
        for channel in range(8):
            values[n, channel] = np.float32(0.0)
        for corner in range(8):
            row = row_of(slots, bits, base, width, height, cell[0] + (corner & 1), cell[1] + (corner >> 1 & 1),
                         cell[2] + (corner >> 2))  # fmt: skip
            if row == 0:
                continue
            weight = np.float32(1.0)
            for axis in range(3):
                weight *= fraction[axis] if corner >> axis & 1 else np.float32(1.0) - fraction[axis]
            for channel in range(8):
                values[n, channel] += weight * rows[row, channel]


@njit(nogil=True, cache=True)
def gather_rays(low, high, bricks, rows, batch, numbers, work, scratch, shading, gathered):
    """gathered [N, 9]: what the rays of chunks low … high - 1 gather: colours and features (7), T behind all, weights times t."""
    for chunk in range(low, high):
        march_chunk(chunk, bricks, batch, numbers, work, scratch)
        first_ray, last_ray = chunk * CHUNK, min((chunk + 1) * CHUNK, batch.start.shape[0])
        offset = chunk * scratch.t.shape[0]
        fetch_chunk(offset, work.counts[chunk], rows, work.ids, work.weights, work.slopes, numbers.shift, scratch.pre)
        composite_chunk(first_ray, last_ray, offset, batch.length, work.slopes, numbers, scratch, shading.sums,
                        work.metrics[chunk])  # fmt: skip
        for r in range(last_ray - first_ray):
            for c in range(7):
                gathered[first_ray + r, c] = shading.sums[c, r]
            gathered[first_ray + r, 7] = scratch.behind[r]
            total = np.float32(0.0)
            for n in range(scratch.first[r], scratch.first[r + 1]):
                total += scratch.weight[n] * scratch.t[n]
            gathered[first_ray + r, 8] = total


@njit(nogil=True, cache=True)
def activate(bricks: Bricks, origin, voxel, points, shift, reference, values, low, high):
    """Raw values low … high - 1 of [N, 8] at points [N, 3] become density, 0 without support, colours and features."""
    slots, support = bricks.slots, bricks.support
    width, height = np.int64(bricks.shape[0]), np.int64(bricks.shape[1])
    cell = np.zeros(3, np.int64)
    for n in range(low, high):
        values[n, 0] += shift
    for n in range(low, high):
        inside = True
        for axis in range(3):
            g = (np.float64(points[n, axis]) - origin[axis]) / voxel[axis]
            inside = inside and g >= 0 and g <= bricks.dims[axis]
            cell[axis] = min(max(np.int64(np.floor(g - 0.5)) + 1, 0), np.int64(bricks.dims[axis]))
        x, y, z = cell[0], cell[1], cell[2]
        slot = slots[((z >> 2) * height + (y >> 2)) * width + (x >> 2)]
        density = np.float32(0.0)
        if inside and slot >= 0 and support[slot, ((z & 3) * 4 + (y & 3)) * 4 + (x & 3)] != 0:
            raw = np.float64(values[n, 0])
            density = np.float32((max(raw, 0.0) + np.log1p(np.exp(-abs(raw)))) / reference)
        sigmoid_in_place(values[n, 1:], 7)
        values[n, 0] = density
