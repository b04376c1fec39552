"""Samples of rays, wave by wave: only where the occupancy grid is on, and only while light is left.

Notation: rays of a chunk in grid coordinates, cells of the occupancy grid (training.multires.occupancy); sample k of a ray lies
at start + (phase + k) step. A skipped stretch never moves a sample: all lie at whole k.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

BLOCK_BITS = 3  # blocks of 8³ cells are skipped at once where all are off
CLOSE = 1e-3  # steps: a stretch that is skipped ends so much early, for rounding


class Grid(NamedTuple):
    """The occupancy grid for compiled loops: bits uint32, one bit a cell, x fastest; blocks uint8, 1 where any of 8³ cells is
    on; side: cells along each axis.
    """

    bits: np.ndarray
    blocks: np.ndarray
    side: int


def grid_of(occupied: np.ndarray) -> Grid:
    """The grid of bool [R, R, R]; R is a multiple of 8."""
    side, block = occupied.shape[0], 1 << BLOCK_BITS
    coarse = side // block
    blocks = occupied.reshape(coarse, block, coarse, block, coarse, block).any((1, 3, 5))
    bits = np.packbits(occupied.ravel(), bitorder="little").view(np.uint32)
    return Grid(bits, np.ascontiguousarray(blocks.ravel(), np.uint8), side)


@njit(nogil=True, cache=True, inline="always")
def _leaving(origin, direction, cell, bits):
    """t where a ray leaves, along one axis, the block of 2^bits cells around `cell`."""
    if direction == 0:
        return np.float32(3e38)
    block = cell >> bits
    wall = ((block + 1) << bits) if direction > 0 else (block << bits)
    return (np.float32(wall) - origin) / direction


@njit(nogil=True, cache=True, inline="always")
def piece_from(rays, ray, piece, t):
    """The piece of a ray that holds t, found from `piece` on: its number, its end, origin (x, y, z) and direction (x, y, z).

    rays: origins, directions, begins and end as in training.multires.fused.rays.Batch.
    """
    origins, directions, begins = rays.origins, rays.directions, rays.begins
    last = begins.shape[1] - 1
    while piece < last and begins[ray, piece + 1] <= t:
        piece += 1
    until = rays.end[ray] if piece == last else min(begins[ray, piece + 1], rays.end[ray])
    return (
        piece, until, origins[ray, piece, 0], origins[ray, piece, 1], origins[ray, piece, 2],
        directions[ray, piece, 0], directions[ray, piece, 1], directions[ray, piece, 2],
    )  # fmt: skip


@njit(nogil=True, cache=True)
def next_sample(grid, batch, ray, k, step):
    """(k of the next sample at or after k in an occupied cell, its t, its piece of the ray); k is -1 where there is none before
    the ray's end."""
    bits, blocks, side = grid.bits, grid.blocks, np.int64(grid.side)
    coarse = side >> BLOCK_BITS
    start, stop, phase = batch.start[ray], batch.end[ray], batch.phase[ray]
    t = start + (phase + np.float32(k)) * step
    piece, until, ox, oy, oz, dx, dy, dz = piece_from(batch, ray, 0, t)
    while t < stop:
        if t >= until:
            piece, until, ox, oy, oz, dx, dy, dz = piece_from(batch, ray, piece, t)
        x = min(max(np.int64(ox + t * dx), 0), side - 1)
        y = min(max(np.int64(oy + t * dy), 0), side - 1)
        z = min(max(np.int64(oz + t * dz), 0), side - 1)
        size = 0
        if blocks[((z >> BLOCK_BITS) * coarse + (y >> BLOCK_BITS)) * coarse + (x >> BLOCK_BITS)] == 0:
            size = BLOCK_BITS
        else:
            cell = (z * side + y) * side + x
            if bits[cell >> 5] >> np.uint32(cell & 31) & np.uint32(1):
                return k, t, piece
        out = min(_leaving(ox, dx, x, size), _leaving(oy, dy, y, size), _leaving(oz, dz, z, size), until)
        k = max(k + 1, np.int64((out - start) / step - phase - np.float32(CLOSE)) + 1)
        t = start + (phase + np.float32(k)) * step
    return -1, t, piece
