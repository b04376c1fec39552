"""The grid as bricks of 4³: what the fused loop looks rows, occupancy and depths up in.

Notation: padded coordinates as in training.voxels.sparse_grid: voxel i of an axis is padded voxel i + 1, and cell c is
interpolated from padded voxels c and c + 1. Brick b of an axis covers padded 4b … 4b + 3, of voxels and of cells alike. The
bricks that hold a voxel or a cell with support own a slot, numbered along a Morton curve; within a slot, x is fastest.

A lookup of a row is base + popcount of the presence bits below: 12 bytes a brick, where a dense table takes 256.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from training.arrays import aligned
from training.voxels.fused.vectors import population_count

SIDE = 4  # voxels of a brick along each axis
VOLUME = SIDE**3
BLOCK = 4  # bricks of a block along each axis: the coarse level of skipping


class Bricks(NamedTuple):
    """B slots over a box of dims (x, y, z) voxels, (bx, by, bz) bricks, (cx, cy, cz) blocks.

    dims int32 [3]; shape int32 [3] = (bx, by, bz). slots int32 [bz*by*bx], -1 where nothing is. blocks uint8 [cz*cy*cx]: 1
    where a brick of the block has support; block_shape int32 [3]. base int32 [B]: row of the brick's first present voxel.
    bits uint64 [B]: which voxels are present. support uint8 [B, 64]: as GridLayout.support, by cell. supported uint8 [B]:
    whether any cell of the brick has support. corners int32 [B, 3]: padded (x, y, z) of each brick's first voxel.
    coordinates int16 [V + 1, 3]: padded (x, y, z) of each row; row 0 is 0.
    """

    dims: np.ndarray
    shape: np.ndarray
    slots: np.ndarray
    blocks: np.ndarray
    block_shape: np.ndarray
    base: np.ndarray
    bits: np.ndarray
    support: np.ndarray
    supported: np.ndarray
    corners: np.ndarray
    coordinates: np.ndarray


def build_bricks(cells: np.ndarray, support: np.ndarray, dims: np.ndarray) -> tuple[Bricks, np.ndarray]:
    """The bricks of a layout, and int32 [V + 1] the row of the layout that each of their rows is.

    cells int [V]: padded flat indices of the present voxels, in the layout's row order. support uint8: GridLayout.support.
    """
    cells, support = np.asarray(cells, np.int32).view(), np.asarray(support).view()
    for table in (cells, support):  # as JAX's arrays are, so that the loops compile once
        table.setflags(write=False)
    dims = np.asarray(dims, np.int64)
    shape = -(-(dims + 2) // SIDE)
    used = np.zeros(int(np.prod(shape)), np.uint8)
    _mark_used(cells, support, dims, shape, used)
    (bricks,) = np.nonzero(used)
    bricks = bricks[np.argsort(_morton(*_unflatten(bricks, shape)), kind="stable")]
    slots = np.full(used.size, -1, np.int32)
    slots[bricks] = np.arange(len(bricks), dtype=np.int32)

    base, bits = np.empty(len(bricks), np.int32), np.zeros(len(bricks), np.uint64)
    by_cell = np.zeros((len(bricks), VOLUME), np.uint8)
    rows, coordinates = np.zeros(len(cells) + 1, np.int32), np.zeros((len(cells) + 1, 3), np.int16)
    _fill(cells, support, dims, shape, slots, base, bits, by_cell, rows, coordinates)
    supported = by_cell.any(1)
    block_shape = -(-shape // BLOCK)
    blocks = np.zeros(int(np.prod(block_shape)), np.uint8)
    bx, by, bz = _unflatten(bricks[supported], shape)
    blocks[_flatten(bx // BLOCK, by // BLOCK, bz // BLOCK, block_shape)] = 1
    corners = np.ascontiguousarray(np.stack(_unflatten(bricks, shape), axis=-1) * SIDE, np.int32)
    made = Bricks(
        dims.astype(np.int32), shape.astype(np.int32), slots, blocks, block_shape.astype(np.int32), base, bits, by_cell,
        np.asarray(supported, np.uint8), corners, coordinates,
    )  # fmt: skip
    return made, rows


@njit(nogil=True, cache=True)
def _mark_used(cells, support, dims, shape, used):
    """used [bricks of the box]: 1 where a brick holds a voxel, or a cell with support."""
    width, height, depth = dims[0] + 2, dims[1] + 2, dims[2] + 2
    for cell in cells:
        x, y, z = cell % width, cell // width % height, cell // (width * height)
        used[((z >> 2) * shape[1] + (y >> 2)) * shape[0] + (x >> 2)] = 1
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                if support[(z * height + y) * width + x] != 0:
                    used[((z >> 2) * shape[1] + (y >> 2)) * shape[0] + (x >> 2)] = 1


@njit(nogil=True, cache=True)
def _fill(cells, support, dims, shape, slots, base, bits, by_cell, rows, coordinates):
    """What a grid's bricks hold. rows [V + 1]: the layout's row of each of ours; the rest as in Bricks."""
    width, height, depth = dims[0] + 2, dims[1] + 2, dims[2] + 2
    for cell in cells:
        x, y, z = cell % width, cell // width % height, cell // (width * height)
        slot = slots[((z >> 2) * shape[1] + (y >> 2)) * shape[0] + (x >> 2)]
        bits[slot] |= np.uint64(1) << np.uint64(((z & 3) * 4 + (y & 3)) * 4 + (x & 3))
    before = 1
    for slot in range(len(base)):
        base[slot] = before
        before += population_count(bits[slot])
    for i in range(len(cells)):
        cell = cells[i]
        x, y, z = cell % width, cell // width % height, cell // (width * height)
        slot = slots[((z >> 2) * shape[1] + (y >> 2)) * shape[0] + (x >> 2)]
        row = row_in(bits[slot], base[slot], ((z & 3) * 4 + (y & 3)) * 4 + (x & 3))
        rows[row] = i + 1
        coordinates[row, 0], coordinates[row, 1], coordinates[row, 2] = x, y, z
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                code = support[(z * height + y) * width + x]
                if code != 0:
                    slot = slots[((z >> 2) * shape[1] + (y >> 2)) * shape[0] + (x >> 2)]
                    by_cell[slot, ((z & 3) * 4 + (y & 3)) * 4 + (x & 3)] = code


def support_of(bricks: Bricks) -> np.ndarray:
    """uint8, flat over padded cells: the support of a layout, from that of its bricks."""
    padded = bricks.dims.astype(np.int64) + 2
    corners = bricks.corners.astype(np.int64)
    flat = aligned((int(np.prod(padded)),), np.uint8)
    for local in range(VOLUME):
        x, y, z = (corners + np.array([local % SIDE, local // SIDE % SIDE, local // SIDE**2])).T
        values = bricks.support[:, local]
        held = values > 0
        flat[_flatten(x[held], y[held], z[held], padded)] = values[held]
    return flat


def present_of(bricks: Bricks) -> np.ndarray:
    """bool [Dz, Dy, Dx]: which voxels are present."""
    present = np.zeros(bricks.dims[::-1], bool)
    x, y, z = (bricks.coordinates[1:] - np.int16(1)).T
    present[z, y, x] = True
    return present


def _flatten(x: np.ndarray, y: np.ndarray, z: np.ndarray, shape: np.ndarray) -> np.ndarray:
    return (z * shape[1] + y) * shape[0] + x


def _unflatten(flat: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return flat % shape[0], flat // shape[0] % shape[1], flat // (shape[0] * shape[1])


def _morton(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The place of cells along a Morton curve: the bits of their coordinates, interleaved."""

    def spread(values: np.ndarray) -> np.ndarray:
        values = values.astype(np.uint64)
        for shift, mask in ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F),
                            (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249)):  # fmt: skip
            values = (values | (values << np.uint64(shift))) & np.uint64(mask)
        return values

    return spread(x) | spread(y) << np.uint64(1) | spread(z) << np.uint64(2)


@njit(nogil=True, cache=True, inline="always")
def row_in(bits, base, local):
    """int32: the row of voxel `local` of a brick with these presence bits and first row; 0 where it is absent."""
    bit = np.uint64(1) << np.uint64(local)
    if bits & bit == np.uint64(0):
        return np.int32(0)
    return np.int32(base + population_count(bits & (bit - np.uint64(1))))


@njit(nogil=True, cache=True, inline="always")
def row_of(slots, bits, base, width, height, x, y, z):
    """int32: the row of padded voxel (x, y, z) in `height` × `width` bricks a layer; 0 where it is absent."""
    slot = slots[((z >> 2) * height + (y >> 2)) * width + (x >> 2)]
    if slot < 0:
        return np.int32(0)
    return row_in(bits[slot], base[slot], ((z & 3) * 4 + (y & 3)) * 4 + (x & 3))
