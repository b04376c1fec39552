"""Emptying the voxels that no training view sees enough of, and closing what is behind surfaces (beyond SNeRG section 5.3).

The paper culls whole macroblocks. What is left in them is in good part haze: voxels that never make up a hundredth of any
pixel, yet each costs every ray that meets it a sample, and bytes. So rays are marched through the baked pack as the viewer
marches it, and tell how much light arrives at each voxel at best. A voxel stays where this, times its own opacity, is
tau_weight: so much a sample at its centre would make up of a pixel. (PlenOctrees, Yu et al. 2021, section 4.1, take the
weights of the samples that happen to fall on a voxel; those of a voxel that no ray went through the middle of are too low.)
Where little light arrives, nobody can tell how deep the scene goes on, so such voxels are made denser: rays end.

The rays (baker.tuning.visibility_rays) form a lattice over every photograph. A sample also counts for the neighbours of its voxel
up to half the lattice away, so that no voxel lies between the rays however fine the grid is. Where rays would be too many, the
lattice is wider, which keeps more voxels, never fewer.

Notation: B = block_size + 2; slots number the occupied macroblocks; T the transmittance before a sample, a voxel's
transmittance the largest T of the samples that it is part of, in units of 1/255 and rounded up; 0 where there is none.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from baker.tuning.marcher import PackMarcher
from baker.tuning.visibility_rays import visibility_rays_of
from scenepack.blocks import block_copy, fill_atlas, restore_padding
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.multires.fused.compiled import kernel

TAU_WEIGHT = 0.0085  # twice as much costs lego nothing, but views that fern was not trained on 0.3 dB
MILDER = (0.5, 0.25)  # parts of tau_weight that are tried where it costs too much
DENSER = 20.0  # times itself, density grows to where it is closed
CLOSED = (0.3, 0.1)  # transmittance: from the first down to the second, density grows to DENSER times itself


@dataclass(frozen=True)
class Pruned:
    """voxels: with alpha before and after. macroblocks: left empty, and dropped. tau_weight: what it was done by, 0 if not."""

    voxels_before: int
    voxels_after: int
    macroblocks: int
    tau_weight: float


def prune(
    pack: Pack, arriving: ArrivingTransmittance, score: Callable[[Pack], float], most_lost: float,
    tau_weight: float = TAU_WEIGHT,
) -> tuple[Pack, Pruned]:  # fmt: skip
    """The pack without voxels that contribute less than tau_weight to every pixel, closed behind surfaces.

    score: PSNR (dB) of a pack; it may fall by most_lost. If it falls further, smaller thresholds (MILDER) are tried, and in the
    end the pack is returned unchanged: many faint voxels together may be a wall.
    """
    least = score(pack) - most_lost
    for part in (1.0, *MILDER):
        thinner, pruned = _thinner(pack, arriving, part * tau_weight)
        if score(thinner) >= least:
            return thinner, pruned
        del thinner  # before the next takes its place
    count = sum(int(np.count_nonzero(_data(pack, pack.atlas_rgba, block)[..., 3])) for block in _blocks(pack))
    return pack, Pruned(count, count, 0, 0.0)


def _thinner(pack: Pack, arriving: ArrivingTransmittance, tau_weight: float) -> tuple[Pack, Pruned]:
    """The pack without its voxels that make up less than tau_weight, closed."""
    features = pack.atlas_features
    assert features is not None, "baking always stores features"
    alpha, transmittance = np.arange(256)[:, None], np.arange(256)
    stays = (alpha > 0) & (alpha * transmittance >= tau_weight * 255**2)
    gain = (stays * closing_gain(alpha, transmittance)).astype(np.float32)  # [256, 256], 0 where a voxel is emptied
    blocks = _blocks(pack)
    counts = np.array([_count(_data(pack, pack.atlas_rgba, block), arriving.at(block), gain) for block in blocks])
    before, after = counts.sum(0).tolist()
    kept = np.zeros(pack.occupied.shape, bool)
    kept[tuple(np.transpose(blocks))] = counts[:, 1] > 0
    indices, rgba, features = fill_atlas(
        (
            (block, _scaled(_data(pack, pack.atlas_rgba, block), _data(pack, features, block), arriving.at(block), gain))
            for block in blocks if kept[block]
        ),
        kept, pack.block_size,
    )  # fmt: skip
    thinner = replace(pack, atlas_indices=indices, atlas_rgba=rgba, atlas_features=features)
    for atlas in (rgba, features):
        restore_padding(atlas, indices, pack.block_size)
    return thinner, Pruned(before, after, len(blocks) - int(kept.sum()), tau_weight)


def _blocks(pack: Pack) -> list[tuple[int, ...]]:
    """Places z, y, x of the occupied macroblocks."""
    return [tuple(block) for block in np.argwhere(pack.occupied)]


def closing_gain(alpha: np.ndarray, transmittance: np.ndarray) -> np.ndarray:
    """What premultiplied voxels of alpha and transmittance uint8 [...] are multiplied by, float32, so that little light
    goes on.
    """
    opacity, (shown, deep) = np.maximum(alpha, 1) / np.float32(255), CLOSED
    depth = np.clip((shown - transmittance / np.float32(255)) / (shown - deep), 0, 1)
    return (1 - (1 - opacity) ** (1 + (DENSER - 1) * depth)) / opacity


def _data(pack: Pack, atlas: np.ndarray, block: tuple[int, ...]) -> np.ndarray:
    """The data voxels [bs, bs, bs, c] of a macroblock, a view into the atlas."""
    return block_copy(pack, atlas, block)[1:-1, 1:-1, 1:-1]


@kernel
def _count(rgba, arriving, gain):
    """How many voxels of a macroblock have alpha, and how many stay."""
    before = after = 0
    for z in range(arriving.shape[0]):
        for y in range(arriving.shape[1]):
            for x in range(arriving.shape[2]):
                before += rgba[z, y, x, 3] > 0
                after += gain[rgba[z, y, x, 3], arriving[z, y, x]] > 0
    return before, after


@njit(nogil=True, cache=True)
def _scaled(rgba, features, arriving, gain):
    """rgba and features uint8 [bs, bs, bs, 8] of what stays of a macroblock, closed within."""
    out = np.zeros((*arriving.shape, 8), np.uint8)
    for z in range(arriving.shape[0]):
        for y in range(arriving.shape[1]):
            for x in range(arriving.shape[2]):
                by = gain[rgba[z, y, x, 3], arriving[z, y, x]]
                if by > 0:
                    for c in range(4):
                        out[z, y, x, c] = np.uint8(np.round(by * rgba[z, y, x, c]))
                        out[z, y, x, 4 + c] = np.uint8(np.round(by * features[z, y, x, c]))
    return out


@dataclass(frozen=True)
class ArrivingTransmittance:
    """transmittance uint8 [voxels z, y, x with a margin around], where rays went; how far it reaches beyond, in voxels."""

    transmittance: np.ndarray
    block_size: int
    reach: int

    def at(self, block: tuple[int, ...]) -> np.ndarray:
        """uint8 [bs, bs, bs]: the largest transmittance within `reach` of each voxel of a macroblock."""
        size, around = self.block_size, 2 * self.reach + 1
        arriving = self.transmittance[tuple(slice(b * size, (b + 1) * size + around - 1) for b in block)]
        for axis in range(3):
            arriving = _most_of_neighbours(arriving, around, axis)
        return arriving


def _most_of_neighbours(values: np.ndarray, count: int, axis: int) -> np.ndarray:
    """The most of each `count` neighbours along an axis, which is count - 1 shorter then. By doubling: ten times as fast as
    looking at each of them."""
    values, width = np.moveaxis(values, axis, 0), 1
    while width < count:
        further = min(width, count - width)
        values, width = np.maximum(values[:-further], values[further:]), width + further
    return np.moveaxis(values, 0, axis)


def arriving_transmittance(
    pack: Pack, dataset: RayDataset, seed: int, on_share: Callable[[float], None] | None
) -> ArrivingTransmittance | None:
    """The largest transmittance with which rays of the views arrive at the voxels of a pack; None where they meet none."""
    size, side, marcher = pack.block_size, pack.padded_block_size, PackMarcher(pack, dataset)
    rays = visibility_rays_of(marcher, dataset, seed)
    if rays is None:
        return None
    copies = marcher.transmittance(rays.ids, rays.pixel_offset, on_share)
    # A voxel is in the copies of up to eight macroblocks; a sample touches one of them.
    margin = max(rays.reach, 1)
    best = np.zeros([n * size + 2 * margin for n in pack.occupied.shape], np.uint8)
    for slot, block in enumerate(np.argwhere(pack.occupied)):
        at = best[tuple(slice(b * size + margin - 1, b * size + margin - 1 + side) for b in block)]
        np.maximum(at, copies[slot], out=at)
    cut = margin - rays.reach
    return ArrivingTransmittance(best[(slice(cut, -cut or None),) * 3], size, rays.reach) if best.any() else None
