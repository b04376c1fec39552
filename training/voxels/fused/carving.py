"""What rays pass on their way, cell by cell: the loops of training.voxels.holes.

Notation: cells [z, y, x] of `side` voxels; N rays in grid coordinates, from start to stop [N], looked at every half cell.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

import numpy as np
from numba import njit


@njit(nogil=True, cache=True, inline="always")
def _cell_at(shape, side, origins, directions, ray, t):
    """int64: the flat index of the cell where a ray is at t; -1 outside."""
    x = np.int64(np.floor((origins[ray, 0] + t * directions[ray, 0]) / side))
    y = np.int64(np.floor((origins[ray, 1] + t * directions[ray, 1]) / side))
    z = np.int64(np.floor((origins[ray, 2] + t * directions[ray, 2]) / side))
    if x < 0 or y < 0 or z < 0 or z >= shape[0] or y >= shape[1] or x >= shape[2]:
        return np.int64(-1)
    return (z * shape[1] + y) * shape[2] + x


@njit(nogil=True, cache=True)
def carve(seen, side, origins, directions, start, stop):
    """Sets `seen` where the rays pass."""
    flat, half = seen.reshape(-1), np.float32(0.5) * side
    for ray in range(start.shape[0]):
        t = start[ray]
        while t < stop[ray]:
            cell = _cell_at(seen.shape, side, origins, directions, ray, t)
            if cell >= 0:
                flat[cell] = True
            t += half


@njit(nogil=True, cache=True)
def enter(seen, side, origins, directions, start, stop, enters):
    """enters[n]: whether ray n is twice in a row in cells that are not `seen`, once may be rounding, behind some that are."""
    flat, half = seen.reshape(-1), np.float32(0.5) * side
    for ray in range(start.shape[0]):
        t, run, begun = start[ray], 0, False
        enters[ray] = False
        while t < stop[ray] and not enters[ray]:
            cell = _cell_at(seen.shape, side, origins, directions, ray, t)
            begun = begun or (cell >= 0 and flat[cell])
            run = run + 1 if begun and cell >= 0 and not flat[cell] else 0
            enters[ray] = run == 2
            t += half


@njit(nogil=True, cache=True)
def block(seen, side, origins, directions, start, stop, walls, deep):
    """Sets `walls` in the first cells that are not `seen` on each ray where it `enters` such, `deep` half cells deep."""
    flat, flat_walls, half = seen.reshape(-1), walls.reshape(-1), np.float32(0.5) * side
    for ray in range(start.shape[0]):
        t, run, begun = start[ray], 0, False
        while t < stop[ray] and run < deep:
            cell = _cell_at(seen.shape, side, origins, directions, ray, t)
            begun = begun or (cell >= 0 and flat[cell])
            run = run + 1 if begun and cell >= 0 and not flat[cell] else 0
            if run >= 2:
                flat_walls[cell] = True
            t += half
