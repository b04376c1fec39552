"""Which macroblocks are worth storing (SNeRG section 5.3): those with opacity, and seen by some training camera.

Notation: TAU_ALPHA, TAU_VIS the thresholds; a cell is grid.cell³ voxels, the unit of the visibility test (2, as in the release;
more in very fine grids). T is the transmittance of a ray so far; samples lie one cell apart.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp
import numpy as np

from baker.baking.field_query import BATCH, FieldQuery, Occupied
from baker.baking.grid import BakeGrid
from baker.baking.work_folder import Arrays, Tick, WorkFolder, in_order, once
from baker.tuning.marcher import box_of, share_rays, wall
from scenepack.placement import transformed
from training.dataset import RayDataset
from training.marching import GridFrameRays, dilate
from training.multires.fused.compiled import Workers, kernel
from training.multires.fused.march import piece_from

TAU_ALPHA = 0.005
TAU_VIS = 0.01
FAINTEST = 0.5 / 255  # opacity of a voxel that 8 bits do not round to nothing
BOX_PROBE = 256  # most cells a side when looking for the box around the content
BOX_MARGIN = 1.0  # probe cells added on every side of it
BOX_TAIL, BOX_GROWTH = 0.0005, 1.1  # share of the opacity cut off at either end of an axis; what the rest is grown by
DILATION = 2  # cells: what lies this near to a visible cell counts as visible


@dataclass(frozen=True)
class Opacity:
    """What of a grid holds anything."""

    opaque: np.ndarray  # bool [blocks z, y, x]: which macroblocks have some voxel of alpha TAU_ALPHA or more
    density: np.ndarray  # float32 [z, y, x]: the cells' mean density, 0 where no voxel is FAINTEST

    def culling(self, grid: BakeGrid, kept: np.ndarray) -> Culling:
        """What is left where only the macroblocks `kept` are."""
        per_block = grid.block_size // grid.cell
        inside = np.repeat(np.repeat(np.repeat(kept, per_block, 0), per_block, 1), per_block, 2)
        cells = dilate(self.density > 0) & inside
        return Culling(kept, cells, int(self.opaque.sum()), int((self.opaque & ~kept).sum()))


@dataclass(frozen=True)
class Culling:
    """What of a grid is worth storing."""

    kept: np.ndarray  # bool [blocks z, y, x]
    cells: np.ndarray  # bool [z, y, x]: cells of kept blocks that hold opacity or touch one that does
    opaque: int  # number of macroblocks with opacity
    hidden: int  # how many of these no camera sees

    def counts(self) -> dict[str, int]:
        """How many macroblocks the grid has, each threshold removed, and are left."""
        total = int(self.kept.size)
        return {"grid": total, "below_tau_alpha": total - self.opaque, "below_tau_vis": self.hidden,
                "kept": self.opaque - self.hidden}  # fmt: skip


def content_box(
    query: FieldQuery, low: np.ndarray, high: np.ndarray, resolution: int, worldspace_T_opengl: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The part of the box (low, high), grid frame, that holds the content; None where nothing is opaque.

    The field is probed on a grid of at most BOX_PROBE cells a side, at one random place per cell, with opacities as a
    voxel of the final resolution would have. As in the release, thin tails of the opacity along each axis are cut off (a
    few floating specks must not halve the resolution of all the rest), and the box is then grown by a tenth.
    """
    probes = min(resolution, BOX_PROBE)
    cell = (high - low).max() / probes
    counts = np.maximum(np.ceil((high - low) / cell - 1e-6).astype(int), 1)
    length = (high - low).max() / resolution
    rng = np.random.default_rng(0)
    mass, total = [np.zeros(n) for n in counts], int(counts.prod())
    for start in range(0, total, BATCH):
        z, y, x = np.unravel_index(np.arange(start, min(start + BATCH, total)), counts[::-1])
        cells = np.stack([x, y, z], -1)
        points = low + (cells + rng.random(cells.shape)) * cell
        placed = transformed(worldspace_T_opengl, points).astype(np.float32)
        alpha = 1 - np.exp(-np.asarray(query(placed).density) * length)
        alpha[alpha < TAU_ALPHA] = 0
        for axis in range(3):
            mass[axis] += np.bincount(cells[:, axis], alpha, minlength=counts[axis])
    if not mass[0].any():
        return None
    shares = [np.cumsum(m) / m.sum() for m in mass]
    first, last = (np.array([np.searchsorted(share, tail) for share in shares]) for tail in (BOX_TAIL, 1 - BOX_TAIL))
    last = last + 1
    grow = BOX_MARGIN + 0.5 * (BOX_GROWTH - 1) * (last - first)
    occupied = np.array([np.flatnonzero(m)[[0, -1]] for m in mass])
    first = np.maximum(first - grow, occupied[:, 0] - BOX_MARGIN)
    last = np.minimum(last + grow, occupied[:, 1] + 1 + BOX_MARGIN)
    return np.maximum(low + first * cell, low), np.minimum(low + last * cell, high)


def opaque_macroblocks(
    query: FieldQuery, grid: BakeGrid, occupied: Occupied, tick: Tick, work: WorkFolder | None
) -> Opacity:
    """Culling by opacity: evaluates the field at every voxel centre, layer by layer of macroblocks, and keeps cells.

    occupied: which boxes may hold content, to skip the others; None where nothing is known (training.method). tick: called with
    the share done. work: finished layers, for resuming.
    """
    bx, by, bz = grid.blocks
    size, per_block = grid.block_size, grid.block_size // grid.cell
    every = np.ones((bz, by, bx), bool)
    corners = np.argwhere(every)[:, ::-1] * size
    ends = grid.training_points(corners), grid.training_points(corners + size)
    may_hold = occupied(np.minimum(*ends), np.maximum(*ends))
    holds = every if may_hold is None else may_hold.reshape(every.shape)
    opaque = np.zeros((bz, by, bx), bool)
    density = np.zeros((bz * per_block, by * per_block, bx * per_block), np.float32)
    layers = [k for k in range(bz) if holds[k].any()]
    name = f"{grid.resolution}_opacity"
    pieces = [(f"{name}_{k:03d}", partial(_opacity_of_layer, query, holds[k], k, grid)) for k in layers]
    for k, layer in zip(layers, in_order(work, pieces, tick), strict=True):
        opaque[k], density[k * per_block : (k + 1) * per_block] = layer["opaque"], layer["density"]
    return Opacity(opaque, density)


def seen_macroblocks(
    opacity: Opacity, grid: BakeGrid, dataset: RayDataset, tick: Tick, work: WorkFolder | None
) -> Culling:
    """Culling by visibility: drops macroblocks that no training ray reaches with transmittance TAU_VIS."""
    cells = opacity.density > 0

    def look() -> Arrays:
        return {"bits": np.packbits(best_transmittance(opacity.density, grid, dataset, tick) >= TAU_VIS)}

    bits = once(work, f"{grid.resolution}_visibility", look)["bits"]
    seen = np.unpackbits(bits, count=cells.size).reshape(cells.shape).astype(bool)
    for _ in range(DILATION):
        seen = dilate(seen)
    per_block = grid.block_size // grid.cell
    z, y, x = (n // per_block for n in cells.shape)
    in_blocks = (seen & cells).reshape(z, per_block, y, per_block, x, per_block).any(axis=(1, 3, 5))
    return opacity.culling(grid, opacity.opaque & in_blocks)


def _opacity_of_layer(query: FieldQuery, holds: np.ndarray, k: int, grid: BakeGrid, tick: Tick) -> Arrays:
    """opaque bool [blocks y, x] and density float32 [cells z, y, x] of the layer k of macroblocks; holds [blocks y, x]."""
    size, per_block = grid.block_size, grid.block_size // grid.cell
    by, bx = holds.shape
    opaque, density = np.zeros((by, bx), bool), np.zeros((per_block, by * per_block, bx * per_block), np.float32)
    z, y, x = np.meshgrid(*(np.arange(size, dtype=np.float32) + np.float32(0.5),) * 3, indexing="ij")
    centres = np.stack([x, y, z], -1).reshape(-1, 3)
    group = max(131_072 * 4 // size**3, 1)
    blocks = np.argwhere(holds)
    for start in range(0, len(blocks), group):
        part = blocks[start : start + group]
        points = np.concatenate([centres + np.array([i * size, j * size, k * size], np.float32) for j, i in part])
        sigma = np.asarray(query(grid.training_points(points)).density).reshape(len(part), *(per_block, grid.cell) * 3)
        for (j, i), values in zip(part, sigma, strict=True):
            alpha = 1 - np.exp(-values.max(axis=(1, 3, 5)) * grid.voxel_size)
            opaque[j, i] = alpha.max() >= TAU_ALPHA
            at = tuple(slice(b * per_block, (b + 1) * per_block) for b in (j, i))
            density[(slice(None), *at)] = np.where(alpha >= FAINTEST, values.mean(axis=(1, 3, 5)), 0)
        tick(min(start + group, len(blocks)) / len(blocks))
    return {"opaque": opaque, "density": density}


# --- Visibility -------------------------------------------------------------------------------------------------------

RAYS = 1_000_000  # training rays marched; with 100 views of 200 × 200 every fourth
EARLY_TERMINATION = 1e-3  # T at which rays end, well below any tau_vis
BLOCK_BITS = 3  # blocks of 8³ cells are skipped at once where all are empty


def best_transmittance(density: np.ndarray, grid: BakeGrid, dataset: RayDataset, tick: Tick) -> np.ndarray:
    """float32 [cells]: the largest T with which any of many training rays reaches a cell; 0 in empty cells."""
    workers, size = Workers(), 1 << BLOCK_BITS
    filled = np.pad(density > 0, [(0, -n % size) for n in density.shape])
    z, y, x = (n // size for n in filled.shape)
    blocks = filled.reshape(z, size, y, size, x, size).any((1, 3, 5))
    best = [np.zeros(density.shape, np.float32) for _ in range(workers.count)]
    box = box_of(grid.min_xyz, grid.voxel_size * grid.cell, density.shape[::-1], grid.contraction)
    source = GridFrameRays(dataset, jnp.asarray(np.linalg.inv(grid.worldspace_T_opengl), jnp.float32))
    ids = np.random.default_rng(0).permutation(dataset.count)[:RAYS].astype(np.int32)
    share_rays(
        workers, box, source, ids,
        lambda worker, rays, _, low, high: _raise_best(density, blocks, rays, low, high, best[worker]), tick,
    )  # fmt: skip
    return np.maximum.reduce(best)


@kernel
def _raise_best(density, blocks, rays, low, high, best):
    """Raises best [cells] to the T of rays low … high - 1 at the cells that they meet."""
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
                        passed *= np.exp(-density[z, y, x] * rays.length[ray])
                else:
                    out = min(_leaving(gx, dx), _leaving(gy, dy), _leaving(gz, dz), until - along)
                    steps = max(np.int64(np.ceil(out)), 1)
            k += steps
            along = rays.start[ray] + half + np.float32(k)


@kernel(inline="always")
def _leaving(place, direction):
    """Distance to where a ray leaves, along one axis, the block of cells around `place`."""
    low = np.float32(np.int64(np.floor(place)) >> BLOCK_BITS << BLOCK_BITS)
    return wall(place, direction, low, low + np.float32(1 << BLOCK_BITS))
