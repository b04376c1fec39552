"""Which macroblocks are worth storing (SNeRG section 5.3): those with opacity, and seen by some training camera.

Notation: TAU_ALPHA, TAU_VIS the thresholds; a cell is grid.cell³ voxels, the unit
of the visibility test (2, as in the release, which tests on a grid of half the resolution; more in very fine grids).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from baker.baking.field_query import FieldQuery, Occupied
from baker.baking.grid import BakeGrid, to_training
from baker.baking.visibility import best_transmittance
from baker.baking.work_folder import Arrays, WorkFolder, once, share_out
from training.dataset import RayDataset
from training.marching.layout import dilate

TAU_ALPHA = 0.005
TAU_VIS = 0.01
FAINTEST = 0.5 / 255  # opacity of a voxel that 8 bits do not round to nothing
BOX_PROBE = 256  # most cells a side when looking for the box around the content
BOX_MARGIN = 1.0  # probe cells added on every side of it
BOX_TAIL, BOX_GROWTH = 0.0005, 1.1  # share of the opacity cut off at either end of an axis; what the rest is grown by
DILATION = 2  # cells: what lies this near to a visible cell counts as visible

Tick = Callable[[float], None]


@dataclass(frozen=True)
class Opacity:
    """opaque bool [blocks z, y, x]: which macroblocks have some voxel of alpha TAU_ALPHA or more. density float32 [z, y, x]: the
    cells' mean density, 0 where no voxel is FAINTEST."""

    opaque: np.ndarray
    density: np.ndarray

    def culling(self, grid: BakeGrid, kept: np.ndarray) -> Culling:
        """What is left where only the macroblocks `kept` are."""
        per_block = grid.block_size // grid.cell
        inside = np.repeat(np.repeat(np.repeat(kept, per_block, 0), per_block, 1), per_block, 2)
        cells = dilate(self.density > 0) & inside
        return Culling(kept, cells, int(self.opaque.sum()), int((self.opaque & ~kept).sum()))


@dataclass(frozen=True)
class Culling:
    """kept bool [blocks z, y, x]; cells bool [z, y, x]: cells of kept blocks that hold opacity or touch one that does.

    opaque: number of macroblocks with opacity; hidden: how many of these no camera sees.
    """

    kept: np.ndarray
    cells: np.ndarray
    opaque: int
    hidden: int

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
    mass = [np.zeros(n) for n in counts]
    y, x = np.meshgrid(np.arange(counts[1]), np.arange(counts[0]), indexing="ij")
    for z in range(counts[2]):
        cells = np.stack([x, y, np.full_like(x, z)], -1).reshape(-1, 3)
        points = low + (cells + rng.random(cells.shape)) * cell
        alpha = 1 - np.exp(-np.asarray(query(to_training(worldspace_T_opengl, points)).density) * length)
        alpha[alpha < TAU_ALPHA] = 0
        for axis in range(3):
            mass[axis] += np.bincount(cells[:, axis], alpha, minlength=counts[axis])
    if not mass[0].any():
        return None
    found = np.array([_without_tails(m) for m in mass])
    first, last = found[:, 0], found[:, 1] + 1
    grow = BOX_MARGIN + 0.5 * (BOX_GROWTH - 1) * (last - first)
    occupied = np.array([np.flatnonzero(m)[[0, -1]] for m in mass])
    first = np.maximum(first - grow, occupied[:, 0] - BOX_MARGIN)
    last = np.minimum(last + grow, occupied[:, 1] + 1 + BOX_MARGIN)
    return np.maximum(low + first * cell, low), np.minimum(low + last * cell, high)


def _without_tails(mass: np.ndarray) -> tuple[int, int]:
    """First and last cell of an axis between tails of BOX_TAIL of the mass each."""
    share = np.cumsum(mass) / mass.sum()
    return int(np.searchsorted(share, BOX_TAIL)), int(np.searchsorted(share, 1 - BOX_TAIL))


def opaque_macroblocks(
    query: FieldQuery, grid: BakeGrid, occupied: Occupied | None = None, tick: Tick | None = None,
    work: WorkFolder | None = None,
) -> Opacity:  # fmt: skip
    """Culling by opacity: evaluates the field at every voxel centre, layer by layer of macroblocks, and keeps cells.

    occupied: tells which boxes may hold content, to skip the others (baker.baking.field_query). tick: called with the share done.
    work: finished layers, for resuming.
    """
    bx, by, bz = grid.blocks
    size, per_block = grid.block_size, grid.block_size // grid.cell
    holds = np.ones((bz, by, bx), bool)
    if occupied is not None:
        corners = np.argwhere(holds)[:, ::-1] * size
        ends = grid.training_points(corners), grid.training_points(corners + size)
        may_hold = occupied(np.minimum(*ends), np.maximum(*ends))
        holds = holds if may_hold is None else may_hold.reshape(bz, by, bx)
    opaque = np.zeros((bz, by, bx), bool)
    density = np.zeros((bz * per_block, by * per_block, bx * per_block), np.float32)
    total, done = max(int(holds.sum()), 1), 0

    def on_some(count: int) -> None:
        nonlocal done
        done += count
        if tick:
            tick(min(done / total, 1.0))

    layers = {k: (f"{grid.resolution}_opacity_{k:03d}", partial(_opacity_of_layer, query, holds[k], k, grid, on_some))
              for k in range(bz) if holds[k].any()}  # fmt: skip
    share_out(work, list(layers.values()))
    for k, piece in layers.items():
        before = done
        layer = once(work, *piece)
        on_some(before + int(holds[k].sum()) - done)
        opaque[k], density[k * per_block : (k + 1) * per_block] = layer["opaque"], layer["density"]
    return Opacity(opaque, density)


def seen_macroblocks(
    opacity: Opacity, grid: BakeGrid, dataset: RayDataset, tick: Tick | None = None, work: WorkFolder | None = None
) -> Culling:
    """Culling by visibility: drops macroblocks that no training ray reaches with transmittance TAU_VIS."""
    cells = opacity.density > 0
    name = f"{grid.resolution}_visibility"
    bits = once(work, name, lambda: _seen(opacity.density, grid, dataset, tick))["bits"]
    seen = np.unpackbits(bits, count=cells.size).reshape(cells.shape).astype(bool)
    for _ in range(DILATION):
        seen = dilate(seen)
    return opacity.culling(grid, opacity.opaque & _any_in_blocks(seen & cells, grid.block_size // grid.cell))


def _any_in_blocks(cells: np.ndarray, per_block: int) -> np.ndarray:
    z, y, x = (n // per_block for n in cells.shape)
    return np.any(cells.reshape(z, per_block, y, per_block, x, per_block), axis=(1, 3, 5))


def _opacity_of_layer(
    query: FieldQuery, holds: np.ndarray, k: int, grid: BakeGrid, tick: Callable[[int], None]
) -> Arrays:
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
        tick(len(part))
    return {"opaque": opaque, "density": density}


def _seen(density: np.ndarray, grid: BakeGrid, dataset: RayDataset, tick: Tick | None) -> Arrays:
    """Which cells a training ray reaches with transmittance TAU_VIS, as packed bits."""
    return {"bits": np.packbits(best_transmittance(density, grid, dataset, tick) >= TAU_VIS)}
