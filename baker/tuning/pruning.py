"""Emptying the voxels that no training view sees enough of, and closing what is behind surfaces (beyond SNeRG section 5.4).

The paper culls whole macroblocks. What is left in them is in good part haze: voxels that never make up two hundredths of
any pixel, yet each costs every ray that meets it a sample, and bytes. So rays are marched through the baked pack as the
viewer marches it, and a voxel stays where some sample that it is part of has a weight of tau_weight; the criterion is
that of PlenOctrees (Yu et al. 2021, section 4.1) at the viewer's own samples. The same march tells how much light arrives
at a voxel at best. Where that is little, nobody can tell how deep the scene goes on, so these are made denser: rays end.

Notation: B = block_size + 2; slots number the occupied macroblocks; T the transmittance before a sample, T alpha its weight,
which is its share in its pixel; a voxel's transmittance is the largest T of the samples with enough weight that it is part
of, in units of 1/255 and rounded up; 0 where there is none.
Rays go through random places of the training photographs, not through pixel centres alone: where photographs are
coarser than voxels, voxels between two pixels' rays must not be mistaken for unseen ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from baker.tuning.pack_layout import MAX_ALPHA, PackLayout, pack_layout, pack_rays, pack_sizes
from scenepack.blocks import block_copy, fill_atlas
from scenepack.constants import ALPHA_CONTRIBUTES, TRANSMITTANCE_STOP
from scenepack.pack import Pack
from scenepack.padding import restore_padding
from training.dataset import RayDataset
from training.marching.batches import rays_that_meet, until_complete
from training.marching.layout import depth_where
from training.marching.march import MarchSizes, march, transmittance
from training.marching.rays import GridFrameRays, to_grid

TAU_WEIGHT = 0.02
RAYS_A_VOXEL, MOST_RAYS = 0.75, 4_000_000  # with a third as many, a lego at 512³ loses 0.8 dB
HIDDEN, DEEP, DENSER = 0.3, 0.02, 20.0  # from transmittance HIDDEN down to DEEP, density grows to DENSER times itself
EARLY_TERMINATION = 1e-4  # T at which marches end; depths are estimates, so far behind the last T that counts
CHUNK_RAYS, CHUNK_SAMPLES = 16_384, 524_288


@dataclass(frozen=True)
class Pruned:
    """voxels: with alpha before and after. macroblocks: left empty, and dropped."""

    voxels_before: int
    voxels_after: int
    macroblocks: int


def prune(
    pack: Pack,
    dataset: RayDataset,
    tau_weight: float = TAU_WEIGHT,
    seed: int = 0,
    on_share: Callable[[float], None] | None = None,
) -> tuple[Pack, Pruned]:
    """The pack without the voxels that no sample of a training view with weight tau_weight touches, closed within.

    The arrays of `pack` are changed. A pack that no view sees at all comes back as it is.
    """
    assert pack.atlas_features is not None, "baking always stores features"
    blocks = [tuple(block) for block in np.argwhere(pack.occupied)]
    best = _transmittance(pack, dataset, tau_weight, seed, on_share)
    if not best.any():
        count = sum(int(np.count_nonzero(_data(pack, pack.atlas_rgba, block)[..., 3])) for block in blocks)
        return pack, Pruned(count, count, 0)
    before = after = 0
    size = pack.block_size
    kept = np.zeros(pack.occupied.shape, bool)
    for block in blocks:
        rgba = _data(pack, pack.atlas_rgba, block)
        had, lit = rgba[..., 3] > 0, best[tuple(slice(b * size, (b + 1) * size) for b in block)]
        stays = had & (lit > 0)
        gain = stays * closing_gain(rgba[..., 3], lit)
        for values in (rgba, _data(pack, pack.atlas_features, block)):
            values[...] = np.round(values * gain[..., None])
        before, after = before + int(had.sum()), after + int(stays.sum())
        kept[block] = stays.any()
    del best
    indices, rgba, features = fill_atlas(
        ((block, _voxels(pack, block)) for block in blocks if kept[block]), kept, pack.block_size
    )
    thinner = replace(pack, atlas_indices=indices, atlas_rgba=rgba, atlas_features=features)
    for atlas in (rgba, features):
        restore_padding(atlas, indices, pack.block_size)
    return thinner, Pruned(before, after, len(blocks) - int(kept.sum()))


def closing_gain(alpha: np.ndarray, transmittance: np.ndarray) -> np.ndarray:
    """What premultiplied voxels of alpha and transmittance uint8 [...] are multiplied by, float32, so that little light
    goes on.
    """
    opacity = np.maximum(alpha, 1) / np.float32(255)
    depth = np.clip((HIDDEN - transmittance / np.float32(255)) / (HIDDEN - DEEP), 0, 1)
    return (1 - (1 - opacity) ** (1 + (DENSER - 1) * depth)) / opacity


def _data(pack: Pack, atlas: np.ndarray, block: tuple[int, ...]) -> np.ndarray:
    """The data voxels [bs, bs, bs, c] of a macroblock, a view into the atlas."""
    return block_copy(pack, atlas, block)[1:-1, 1:-1, 1:-1]


def _voxels(pack: Pack, block: tuple[int, ...]) -> np.ndarray:
    """rgba and features uint8 [bs, bs, bs, 8] of a macroblock."""
    assert pack.atlas_features is not None, "baking always stores features"
    return np.concatenate([_data(pack, atlas, block) for atlas in (pack.atlas_rgba, pack.atlas_features)], axis=-1)


def _transmittance(
    pack: Pack, dataset: RayDataset, tau_weight: float, seed: int, on_share: Callable[[float], None] | None
) -> np.ndarray:
    """uint8 [grid voxels z, y, x, filled up to whole macroblocks]: each voxel's transmittance."""
    blocks = [tuple(block) for block in np.argwhere(pack.occupied)]
    size, side = pack.block_size, pack.padded_block_size
    alpha = np.zeros((max(len(blocks), 1), side, side, side), np.uint8)
    for slot, block in enumerate(blocks):
        alpha[slot] = block_copy(pack, pack.atlas_rgba, block)[..., 3]
    copies = np.asarray(_transmittance_of_copies(pack, alpha, dataset, tau_weight, seed, on_share)).reshape(alpha.shape)
    # A voxel is in the copies of up to eight macroblocks; a sample touches one of them. One more around the grid.
    best = np.zeros([n * size + 2 for n in pack.occupied.shape], np.uint8)
    for slot, block in enumerate(blocks):
        at = best[tuple(slice(b * size, b * size + side) for b in block)]
        np.maximum(at, copies[slot], out=at)
    return best[1:-1, 1:-1, 1:-1]


def _transmittance_of_copies(
    pack: Pack, alpha: np.ndarray, dataset: RayDataset, tau_weight: float, seed: int,
    on_share: Callable[[float], None] | None,
) -> jax.Array:  # fmt: skip
    """uint8 [slots B³]: the transmittance of voxels of the padded copies, whose alpha is uint8 [slots, B, B, B]."""
    layout, rays, sizes = pack_layout(pack), pack_rays(pack, dataset), pack_sizes(pack, CHUNK_SAMPLES)
    stored, best = jnp.asarray(alpha.reshape(-1)), jnp.zeros(alpha.size, jnp.uint8)
    rng = np.random.default_rng(seed)
    count = max(int(min(RAYS_A_VOXEL * np.count_nonzero(alpha), MOST_RAYS)), CHUNK_RAYS)
    ids = rng.integers(0, dataset.count, count, np.int32)
    away = rng.random((count, 2), np.float32) - np.float32(0.5)
    meets = rays_that_meet(layout, rays, ids, sizes.segments, away=away)  # most may pass an object by
    ids, away = ids[meets], away[meets]

    def march_some(places: np.ndarray) -> tuple[None, jax.Array]:
        nonlocal best
        some = jnp.asarray(ids[places]), jnp.asarray(away[places])
        best, complete = _raise_transmittance(best, stored, layout, rays, *some, tau_weight, sizes)
        return None, complete

    for _, done, _ in until_complete(len(ids), CHUNK_RAYS, march_some):
        if on_share:
            on_share(done / len(ids))
    return best


@partial(jax.jit, static_argnames="sizes", donate_argnums=0)
def _raise_transmittance(
    best: jax.Array, stored: jax.Array, layout: PackLayout, source: GridFrameRays, ids: jax.Array, away: jax.Array,
    tau_weight: float, sizes: MarchSizes,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """Raises `best` by what rays `ids`, moved by `away` [N, 2] pixels, see; also which rays were marched whole."""
    count = ids.shape[0]
    rays = to_grid(layout, source.geometry_at(ids, away))
    samples = march(layout, rays, jnp.full(count, 0.5), sizes, 1.0, depth_where(EARLY_TERMINATION))
    corners, shares = layout.corners(samples.g)
    alpha = (shares * stored[corners].astype(jnp.float32)).sum(-1) * (1 / 255)
    alpha = jnp.where(samples.valid & (alpha > ALPHA_CONTRIBUTES), alpha, 0.0)
    before, _ = transmittance(samples, -jnp.log1p(-jnp.minimum(alpha, MAX_ALPHA)), count, sizes.per_ray)
    enough = (before > TRANSMITTANCE_STOP) & (before * alpha >= tau_weight)
    at = jnp.where(enough[:, None] & (shares > 0), corners, best.size)
    value = jnp.ceil(255 * before).astype(jnp.uint8)
    return best.at[at].max(jnp.broadcast_to(value[:, None], at.shape), mode="drop"), samples.complete
