"""Which cells of a grid training rays reach, and with how much light (SNeRG section 5.3).

Notation: cells of the culling grid [z, y, x] with a density each; T, the transmittance of a ray so far. Samples lie one cell
apart, as those of a pack lie one voxel apart (docs/rendering.md).
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from baker.baking.grid import BakeGrid
from baker.tuning.marcher import PART, TOGETHER, box_of, lines_in_grid
from training.dataset import RayDataset
from training.marching.rays import GridFrameRays
from training.multires.fused.compiled import kernel
from training.multires.fused.march import piece_from
from training.multires.fused.workers import Workers

RAYS = 1_000_000  # training rays marched; with 100 views of 200 × 200 every fourth
EARLY_TERMINATION = 1e-3  # T at which rays end, well below any tau_vis
BLOCK_BITS = 3  # blocks of 8³ cells are skipped at once where all are empty


def best_transmittance(
    density: np.ndarray, grid: BakeGrid, dataset: RayDataset, tick: Callable[[float], None] | None = None
) -> np.ndarray:
    """float32 [cells]: the largest T with which any of many training rays reaches a cell; 0 in empty cells."""
    workers, size = Workers(), 1 << BLOCK_BITS
    filled = np.pad(density > 0, [(0, -n % size) for n in density.shape])
    z, y, x = (n // size for n in filled.shape)
    blocks = filled.reshape(z, size, y, size, x, size).any((1, 3, 5))
    best = [np.zeros(density.shape, np.float32) for _ in range(workers.count)]
    cell = grid.voxel_size * grid.cell
    box = box_of(grid.min_xyz, cell, density.shape[::-1], grid.contraction)
    source = GridFrameRays(dataset, jnp.asarray(np.linalg.inv(grid.worldspace_T_opengl), jnp.float32))
    ids = np.random.default_rng(0).permutation(dataset.count)[:RAYS].astype(np.int32)
    for first in range(0, len(ids), TOGETHER):
        count = min(TOGETHER, len(ids) - first)
        lines, length = lines_in_grid(box, source, ids[np.minimum(np.arange(first, first + TOGETHER), len(ids) - 1)])

        def share(worker: int, part: int, lines=lines, length=length, count=count) -> None:
            low, high = part * PART, min((part + 1) * PART, count)
            _raise_best(density, blocks, lines, length, low, high, best[worker])

        workers.share(-(-count // PART), share)
        if tick:
            tick((first + count) / len(ids))
    return np.maximum.reduce(best)


@kernel
def _raise_best(density, blocks, rays, length, low, high, best):
    """Raises best [cells] to the T of rays low … high - 1 at the cells that they meet. length [N]: world units per cell."""
    depth, height, width = density.shape
    half, one = np.float32(0.5), np.float32(1.0)
    for ray in range(low, high):
        k, passed = np.int64(0), one
        stop, along = rays.end[ray], rays.start[ray] + half
        piece, until, ox, oy, oz, dx, dy, dz = piece_from(rays, ray, 0, along)
        while along < stop and passed > np.float32(EARLY_TERMINATION):
            if along >= until:
                piece, until, ox, oy, oz, dx, dy, dz = piece_from(rays, ray, piece, along)
            gx, gy, gz = ox + along * dx, oy + along * dy, oz + along * dz
            x, y, z = np.int64(np.floor(gx)), np.int64(np.floor(gy)), np.int64(np.floor(gz))
            steps = np.int64(1)
            if 0 <= x < width and 0 <= y < height and 0 <= z < depth:
                if blocks[z >> BLOCK_BITS, y >> BLOCK_BITS, x >> BLOCK_BITS]:
                    if density[z, y, x] > 0:
                        best[z, y, x] = max(best[z, y, x], passed)
                        passed *= np.exp(-density[z, y, x] * length[ray])
                else:
                    out = min(_leaving(gx, dx), _leaving(gy, dy), _leaving(gz, dz), until - along)
                    steps = max(np.int64(np.ceil(out)), 1)
            k += steps
            along = rays.start[ray] + half + np.float32(k)


@kernel(inline="always")
def _leaving(place, direction):
    """Distance to where a ray leaves, along one axis, the block of cells around `place`."""
    if direction == 0:
        return np.float32(3e38)
    low = np.int64(np.floor(place)) >> BLOCK_BITS << BLOCK_BITS
    wall = low + (1 << BLOCK_BITS) if direction > 0 else low
    return (np.float32(wall) - place) / direction
