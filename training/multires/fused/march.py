"""Samples of rays, wave by wave: only where the occupancy grid is on, and only while light is left.

Notation: rays of a chunk in grid coordinates, cells of the occupancy grid (training.multires.occupancy); sample k of a ray lies
at start + (phase + k) step. A skipped stretch never moves a sample: all lie at whole k.
"""

# pyright: reportCallIssue=false

from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_cdt

from training.multires.fused.compiled import kernel

COARSE_BITS = 2  # a coarse cell is 4³ cells
FLAT = np.float32(1e-12)  # a direction's component this small leaves no cell
U = np.uintp  # of indices, which Numba then does not turn around
CLOSE = 1e-3  # steps: a stretch that is skipped ends so much early, for rounding


class Grid(NamedTuple):
    """The occupancy grid for compiled loops, by coarse cells, x fastest."""

    distances: np.ndarray  # uint8: coarse cells, also diagonally, to the next that holds anything; 0 where it does
    cells: np.ndarray  # uint64: a bit for each cell within, x fastest
    side: int  # cells along each axis


def grid_of(occupied: np.ndarray) -> Grid:
    """The grid of bool [R, R, R]; R is a multiple of 8."""
    side, size = occupied.shape[0], 1 << COARSE_BITS
    coarse = side // size
    within = occupied.reshape(coarse, size, coarse, size, coarse, size).transpose(0, 2, 4, 1, 3, 5)
    cells = np.packbits(within.reshape(-1, size**3), axis=1, bitorder="little").view(np.uint64).ravel()
    empty = (cells == 0).reshape(coarse, coarse, coarse)
    distances = distance_transform_cdt(empty, "chessboard") if not empty.all() else np.full(empty.shape, coarse)
    return Grid(np.ascontiguousarray(distances, np.uint8).ravel(), cells, side)


@kernel(inline="always")
def _inverse(direction):
    """1 / direction, finite."""
    return np.float32(1.0) / direction if abs(direction) > FLAT else np.float32(3e38)


@kernel(inline="always")
def _leaving(origin, inverse, cell, bits, distance):
    """t where a ray leaves, along one axis, the cube of 2 distance - 1 blocks of 2^bits cells around the block of `cell`;
    inverse: of its direction."""
    block = (cell >> bits) + (distance if inverse > 0 else 1 - distance)
    return (np.float32(block << bits) - origin) * inverse


@kernel(inline="always")
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


@kernel
def march_ray(grid, batch, ray, chunk_ray, step, most, scratch, count, capacity):
    """Adds at most so many samples of a ray in occupied cells to scratch, from its scratch.next_k on; their number then, -1 where
    the capacity does not suffice. scratch: see training.multires.fused.chunk; scratch.alive is false where the ray has ended."""
    distances, cells, side = grid.distances, grid.cells, np.int64(grid.side)
    unit, close, one, last = np.float32(1.0) / np.float32(side), np.float32(CLOSE), np.float32(1.0), side - 1
    coarse, bits, three = side >> COARSE_BITS, np.int64(COARSE_BITS), np.int64(3)
    start, stop, phase, k = batch.start[ray], batch.end[ray], batch.phase[ray], scratch.next_k[chunk_ray]
    t = start + (phase + np.float32(k)) * step
    piece, until, ox, oy, oz, dx, dy, dz = piece_from(batch, ray, 0, t)
    ix, iy, iz = _inverse(dx), _inverse(dy), _inverse(dz)
    per_step, full = one / step, count + most
    while t < stop:
        if t >= until:
            piece, until, ox, oy, oz, dx, dy, dz = piece_from(batch, ray, piece, t)
            ix, iy, iz = _inverse(dx), _inverse(dy), _inverse(dz)
        px, py, pz = ox + t * dx, oy + t * dy, oz + t * dz
        x, y, z = min(max(np.int64(px), 0), last), min(max(np.int64(py), 0), last), min(max(np.int64(pz), 0), last)
        place = U(((z >> bits) * coarse + (y >> bits)) * coarse + (x >> bits))
        size, distance = bits, np.int64(distances[place])
        if distance == 0:
            within = np.uint64(((z & three) << 4) + ((y & three) << 2) + (x & three))
            if cells[place] >> within & np.uint64(1):
                if count >= capacity:
                    return -1
                at = U(count)
                scratch.ray[at], scratch.t[at] = chunk_ray, t
                scratch.xs[at], scratch.ys[at], scratch.zs[at] = px * unit, py * unit, pz * unit
                count += 1
                k += 1
                if count == full:
                    scratch.next_k[chunk_ray] = k
                    return count
                t = start + (phase + np.float32(k)) * step
                continue
            size, distance = np.int64(0), np.int64(1)
        out = min(
            _leaving(ox, ix, x, size, distance), _leaving(oy, iy, y, size, distance), _leaving(oz, iz, z, size, distance), until
        )  # fmt: skip
        k = max(k + 1, np.int64((out - start) * per_step - phase - close) + 1)
        t = start + (phase + np.float32(k)) * step
    scratch.alive[chunk_ray] = False
    return count
