"""Voxels that no training view sees enough of: emptied, closed behind surfaces, or like their neighbours (not in the paper).

The paper culls whole macroblocks. Much of what is left in them is haze: voxels that never make up a hundredth of any pixel, yet
cost every ray that meets them a sample, and bytes. So rays are marched through the baked pack as the viewer marches it, and tell
how much light arrives at each voxel at best. A voxel stays where this, times its own opacity, is tau_weight: so much a sample at
its centre would make up of a pixel. (PlenOctrees, Yu et al. 2021, section 4.1, take the weights of the samples that fall on a
voxel, which are too low where no ray went through its middle.) Where little light arrives, voxels are made denser: rays end.

The rays are a lattice over each photograph, begun at a random place. Its step follows the grid: SPACING voxels where the
photographs see surfaces. A surface that is seen at 45 degrees is met by some ray within about `spacing` voxels of any of its
points, and a sample lights the voxels within one of it. Most are seen from straighter ahead, or by several photographs, so light
is taken to reach spacing - 2 voxels further (`reach`), so that no voxel lies between the rays. Beyond MOST_RAYS that meet content
the step grows, which keeps more voxels, never fewer.

Of the voxels that stay, hidden ones may copy their neighbours, so that they compress better: where little transmittance is left
in every photograph and between them, a voxel takes the colour and features of the voxel before it, along x or else along y, as
near as its own alpha allows. Alphas stay, so that no surface moves. In mist half of a pixel lies where half of the transmittance
is gone, so the photographs decide how much is hidden.

Notation: bs = block_size, B = bs + 2; slots number the occupied macroblocks, in the grid's order; T the transmittance before a
sample, a voxel's transmittance the largest T of the samples that it is part of, in units of 1/255 and rounded up; 0 where there
is none. arriving: uint8 [slots, bs, bs, bs], the largest transmittance within `reach` of each voxel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import ceil, sqrt

import jax
import jax.numpy as jnp
import numpy as np

from baker.tuning.marcher import OnShare, PackMarcher
from scenepack.blocks import block_data, restore_pack_padding, with_macroblocks
from scenepack.codecs.quantisation import Steps, in_steps
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.marching import GridBox, GridFrameRays, grid_points, to_grid

SPACING = 3.0  # voxels between neighbouring rays
MOST_RAYS = 12_000_000  # that meet content
PILOTS = 16_384  # rays that tell how many voxels wide pixels are
FEW_WIDER = 0.9  # share of the pilots whose pixels are no wider than what is taken for the width
TOGETHER = 1_048_576  # rays that are made together, of whole photographs


def _spacing(marcher: PackMarcher, dataset: RayDataset, rng: np.random.Generator) -> tuple[float, int] | None:
    """Pixels between the rays, and `reach`; None where no photograph sees anything."""
    pilots = rng.integers(0, dataset.count, 8 * PILOTS, np.int32)
    meets = marcher.meets(pilots)
    if not meets.any():
        return None
    # How many voxels apart the rays of neighbouring pixels are where they meet surfaces, for all but the widest pixels
    ids = np.resize(pilots[meets], PILOTS)
    depths = marcher.half_depths(ids)
    if not depths.any():
        return None
    widths = np.asarray(_widths(marcher.box, marcher.rays, jnp.asarray(ids), jnp.asarray(depths)))
    width = float(np.quantile(widths[depths > 0], FEW_WIDER))
    expected = meets.mean() * dataset.count * (width / SPACING) ** 2
    wider = sqrt(max(expected / MOST_RAYS, 1.0))
    return SPACING / width * wider, ceil(SPACING * wider - 2)


@jax.jit
def _widths(box: GridBox, source: GridFrameRays, ids: jax.Array, depths: jax.Array) -> jax.Array:
    """float32 [N]: voxels from a ray to those of the next column and row, the wider of both, at depths [N] in voxels."""
    centre = jnp.zeros((ids.shape[0], 2))
    t = to_grid(box, source.geometry_at(ids, centre)).times(depths)

    def point(pixel_offset: jax.Array) -> jax.Array:
        rays = source.geometry_at(ids, pixel_offset)
        return grid_points(box, rays.origins + t[:, None] * rays.directions)

    at = point(centre)
    steps = [jnp.linalg.norm(point(centre + jnp.asarray(one)) - at, axis=-1) for one in ((1.0, 0.0), (0.0, 1.0))]
    return jnp.maximum(*steps)


def _lattices(
    dataset: RayDataset, step: float, rng: np.random.Generator, on_share: OnShare
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """ids int32 [N] and pixel_offset float32 [N, 2] of a lattice over each photograph, `step` pixels apart, some at a time."""
    width, first = np.asarray(dataset.width), np.asarray(dataset.first)
    height = np.diff(np.append(first, dataset.count)) // width
    ids, pixel_offset, held = [], [], 0
    for view in range(dataset.views):
        w, h = int(width[view]), int(height[view])
        start = rng.random(2) * (min(step, w), min(step, h))
        y, x = np.meshgrid(np.arange(start[1], h, step), np.arange(start[0], w, step), indexing="ij")
        column, row = np.minimum(x.astype(np.int32), w - 1), np.minimum(y.astype(np.int32), h - 1)
        ids.append((first[view] + row * w + column).ravel().astype(np.int32))
        pixel_offset.append(np.stack([x - column - 0.5, y - row - 0.5], -1).reshape(-1, 2).astype(np.float32))
        held += x.size
        if held >= TOGETHER or view + 1 == dataset.views:
            yield np.concatenate(ids), np.concatenate(pixel_offset)
            on_share((view + 1) / dataset.views)
            ids, pixel_offset, held = [], [], 0


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
    pack: Pack, arriving: np.ndarray, score: Callable[[Pack], float], most_lost: float, tau_weight: float = TAU_WEIGHT
) -> tuple[Pack, Pruned]:
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
    count = sum(int(np.count_nonzero(_alpha(pack, block))) for block in _blocks(pack))
    return pack, Pruned(count, count, 0, 0.0)


def _thinner(pack: Pack, arriving: np.ndarray, tau_weight: float) -> tuple[Pack, Pruned]:
    """The pack without its voxels that make up less than tau_weight, closed."""
    alpha, transmittance = np.arange(256)[:, None], np.arange(256)
    stays = (alpha > 0) & (alpha * transmittance >= tau_weight * 255**2)
    gains = (stays * closing_gain(alpha, transmittance)).astype(np.float32)  # [256, 256], 0 where a voxel is emptied

    def thinned(slot: int) -> tuple[tuple[int, ...], np.ndarray]:
        block = blocks[slot]
        gain = gains[_alpha(pack, block), arriving[slot]]
        some, voxels = gain > 0, np.zeros((*gain.shape, 8), np.uint8)
        before = np.concatenate([block_data(pack, atlas, block)[some] for atlas in pack.atlases], axis=-1)
        voxels[some] = np.round(gain[some][:, None] * before)
        return block, voxels

    before = after = 0
    blocks, kept = _blocks(pack), np.zeros(pack.occupied.shape, bool)
    for block, light in zip(blocks, arriving, strict=True):
        alphas = _alpha(pack, block)
        stay = int(np.count_nonzero(stays[alphas, light]))
        before, after = before + int(np.count_nonzero(alphas)), after + stay
        kept[block] = stay > 0
    left = [slot for slot, block in enumerate(blocks) if kept[block]]
    return with_macroblocks(pack, map(thinned, left), kept), Pruned(before, after, len(blocks) - len(left), tau_weight)


def _blocks(pack: Pack) -> list[tuple[int, ...]]:
    """Places z, y, x of the occupied macroblocks."""
    return [tuple(block) for block in np.argwhere(pack.occupied)]


def _alpha(pack: Pack, block: tuple[int, ...]) -> np.ndarray:
    """uint8 [bs, bs, bs] of the voxels of a macroblock."""
    return block_data(pack, pack.atlas_rgba, block)[..., 3]


def closing_gain(alpha: np.ndarray, transmittance: np.ndarray) -> np.ndarray:
    """Factors float32 for premultiplied voxels of alpha and transmittance uint8 [...]: the less light arrives, the denser they
    become (CLOSED, DENSER)."""
    opacity, (shown, deep) = np.maximum(alpha, 1) / np.float32(255), CLOSED
    depth = np.clip((shown - transmittance / np.float32(255)) / (shown - deep), 0, 1)
    return (1 - (1 - opacity) ** (1 + (DENSER - 1) * depth)) / opacity


def _most_of_neighbours(values: np.ndarray, count: int, axis: int) -> np.ndarray:
    """The most of each `count` neighbours along an axis, which is count - 1 shorter then. By doubling, which is fast."""
    values, width = np.moveaxis(values, axis, 0), 1
    while width < count:
        further = min(width, count - width)
        values, width = np.maximum(values[:-further], values[further:]), width + further
    return np.moveaxis(values, 0, axis)


def arriving_transmittance(
    pack: Pack, dataset: RayDataset, seed: int, on_share: OnShare = lambda share: None
) -> np.ndarray | None:
    """uint8 [slots, bs, bs, bs]: the largest transmittance with which rays of the views arrive within `reach` of each voxel;
    None where they meet none."""
    size, side, marcher = pack.block_size, pack.padded_block_size, PackMarcher(pack, dataset)
    rng = np.random.default_rng(seed)
    if (spacing := _spacing(marcher, dataset, rng)) is None:
        return None
    step, reach = spacing
    copies = marcher.transmittance(_lattices(dataset, step, rng, on_share))
    # A voxel is in the copies of up to eight macroblocks; a sample touches one of them.
    blocks, margin, around = _blocks(pack), max(reach, 1), 2 * reach + 1
    best = np.zeros([n * size + 2 * margin for n in pack.occupied.shape], np.uint8)
    for slot, block in enumerate(blocks):
        at = best[tuple(slice(b * size + margin - 1, b * size + margin - 1 + side) for b in block)]
        np.maximum(at, copies[slot], out=at)
    del copies
    arriving, first = np.empty((len(blocks), size, size, size), np.uint8), margin - reach
    for slot, block in enumerate(blocks):
        light = best[tuple(slice(b * size + first, (b + 1) * size + first + around - 1) for b in block)]
        for axis in range(3):
            light = _most_of_neighbours(light, around, axis)
        arriving[slot] = light
    return arriving if arriving.any() else None


# --- Hidden voxels ---

# Transmittance, in units of 1/255, below which a voxel is hidden; the first that costs little enough is taken. Of lego at
# 1000³, 128 saves 8 % of the bytes for 0.01 dB. Fern's pack of 300³ loses 2.6 dB with 128, 0.4 with 64, nothing with 32.
HIDDEN = (128, 64, 32)


def smooth_hidden(
    pack: Pack, arriving: np.ndarray, steps: Steps, score: Callable[[Pack], float], most_lost: float
) -> tuple[Pack, int]:
    """The pack after hidden voxels took their neighbours' values, and the transmittance below which voxels count as hidden. The
    pack unchanged and 0 where every threshold costs too much.

    steps: what it is stored in, and stays in. score (dB): may fall by most_lost.
    """
    least = score(pack) - most_lost
    for hidden in HIDDEN:
        smooth = follow_neighbours(pack, arriving, steps, hidden)
        if score(smooth) >= least:
            return smooth, hidden
        del smooth  # before the next takes its place
    return pack, 0


def follow_neighbours(pack: Pack, arriving: np.ndarray, steps: Steps, hidden: int) -> Pack:
    """The pack with the voxels that get less transmittance than `hidden` like their neighbours."""
    rgba, features = (None if atlas is None else atlas.copy() for atlas in (pack.atlas_rgba, pack.atlas_features))
    assert rgba is not None
    pack = replace(pack, atlas_rgba=rgba, atlas_features=features)
    found = [_hidden(pack, block, light < hidden) for block, light in zip(_blocks(pack), arriving, strict=True)]
    at, rank = (np.concatenate(parts) for parts in zip(*found, strict=True))
    at = at[np.argsort(rank, kind="stable")]
    row = rgba.shape[2]
    # A voxel's neighbours have the rank before its own, so that voxels of one rank may follow at once. Beside a macroblock lies
    # its padding, which is as its neighbour was.
    for some in np.split(at, np.cumsum(np.bincount(rank))[:-1]):
        _follow(rgba.reshape(-1, 4), None if features is None else features.reshape(-1, 4), some, row, steps)
    restore_pack_padding(pack)
    return pack


def _hidden(pack: Pack, block: tuple[int, ...], dark: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where hidden voxels of a macroblock are in the flat atlas, int64 [n]; x + y, which is their rank. dark: bool
    [bs, bs, bs]."""
    z, y, x = np.nonzero((_alpha(pack, block) > 0) & dark)
    _, height, width, _ = pack.atlas_rgba.shape
    left, top, front = pack.atlas_indices[block].astype(np.int64) * pack.padded_block_size + 1
    return ((front + z) * height + top + y) * width + left + x, (x + y).astype(np.int32)


def _follow(rgba: np.ndarray, features: np.ndarray | None, at: np.ndarray, row: int, steps: Steps) -> None:
    """Voxels `at` [n] of flat atlases take what is before them, along x or else a `row` before, where that is not empty."""
    source = np.where(rgba[at - 1, 3] > 0, at - 1, at - row)
    some = rgba[source, 3] > 0
    at, source = at[some], source[some]
    alpha = rgba[at, 3:]
    rgba[at, :3] = in_steps(rgba[source, :3], steps.colour, alpha)
    if features is not None:
        features[at] = in_steps(features[source], steps.feature, alpha)
