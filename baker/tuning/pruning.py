"""Emptying the voxels that no training view sees enough of, and closing what is behind surfaces (beyond SNeRG section 5.4).

The paper culls whole macroblocks. What is left in them is in good part haze: voxels that never make up two hundredths of
any pixel, yet each costs every ray that meets it a sample, and bytes. So rays are marched through the baked pack as the
viewer marches it, and a voxel stays where some sample that it is part of has a weight of tau_weight; the criterion is
that of PlenOctrees (Yu et al. 2021, section 4.1) at the viewer's own samples. The same march tells how much light reaches
a voxel at best. Where that is little, nobody can tell how deep the scene goes on, so these are made denser: rays end.

Notation: B = block_size + 2; slots number the occupied macroblocks; the weight of a sample is T alpha, its share in its
pixel; a voxel's reach is the largest T of the samples with enough weight that it is part of, in units of 1/255.
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

from baker.baking.culling import in_grid_frame
from baker.tuning.pack_layout import MAX_ALPHA, PackLayout, pack_layout, pack_sizes
from scenepack.blocks import block_copy, fill_atlas
from scenepack.constants import ALPHA_CONTRIBUTES, TRANSMITTANCE_STOP
from scenepack.pack import Pack
from scenepack.padding import restore_padding
from training.dataset import RayDataset
from training.method import Rays
from training.voxels.march import MarchSizes, march, occupied_segments, to_grid, transmittance
from training.voxels.sparse_grid import DEPTH_UNITS

TAU_WEIGHT = 0.02
RAYS_A_VOXEL, MOST_RAYS = 0.75, 4_000_000  # with a third as many, a lego at 512³ loses 0.8 dB
HIDDEN, DEEP, DENSER = 0.3, 0.02, 20.0  # from reach HIDDEN down to DEEP, density grows to DENSER times itself
HORIZON = int(
    -np.log(1e-4) * DEPTH_UNITS
)  # a march ends there; depths are estimates, so far behind the last T that counts
CHUNK_RAYS, CHUNK_SAMPLES = 16_384, 524_288


@dataclass(frozen=True)
class Shed:
    """voxels: with alpha before and after. macroblocks: left empty, and dropped."""

    voxels_before: int
    voxels_after: int
    macroblocks: int


def shed(
    pack: Pack,
    dataset: RayDataset,
    tau_weight: float = TAU_WEIGHT,
    seed: int = 0,
    on_share: Callable[[float], None] | None = None,
) -> tuple[Pack, Shed]:
    """The pack without the voxels that no sample of a training view with weight tau_weight touches, closed within.

    The arrays of `pack` are changed. A pack that no view sees at all comes back as it is.
    """
    assert pack.atlas_features is not None, "baking always stores features"
    blocks = [tuple(block) for block in np.argwhere(pack.occupied)]
    reach = _reach(pack, dataset, tau_weight, seed, on_share)
    if not reach.any():
        count = sum(int(np.count_nonzero(_data(pack, pack.atlas_rgba, block)[..., 3])) for block in blocks)
        return pack, Shed(count, count, 0)
    before = after = 0
    size = pack.block_size
    kept = np.zeros(pack.occupied.shape, bool)
    for block in blocks:
        rgba = _data(pack, pack.atlas_rgba, block)
        had, reached = rgba[..., 3] > 0, reach[tuple(slice(b * size, (b + 1) * size) for b in block)]
        stays = had & (reached > 0)
        gain = stays * closing_gain(rgba[..., 3], reached)
        for values in (rgba, _data(pack, pack.atlas_features, block)):
            values[...] = np.round(values * gain[..., None])
        before, after = before + int(had.sum()), after + int(stays.sum())
        kept[block] = stays.any()
    del reach
    indices, rgba, features = fill_atlas(
        ((block, _voxels(pack, block)) for block in blocks if kept[block]), kept, pack.block_size
    )
    thinner = replace(pack, atlas_indices=indices, atlas_rgba=rgba, atlas_features=features)
    for atlas in (rgba, features):
        restore_padding(atlas, indices, pack.block_size)
    return thinner, Shed(before, after, len(blocks) - int(kept.sum()))


def closing_gain(alpha: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """What premultiplied voxels of alpha and reach uint8 [...] are multiplied by, float32, so that little light goes on."""
    opacity = np.maximum(alpha, 1) / np.float32(255)
    depth = np.clip((HIDDEN - reach / np.float32(255)) / (HIDDEN - DEEP), 0, 1)
    return (1 - (1 - opacity) ** (1 + (DENSER - 1) * depth)) / opacity


def _data(pack: Pack, atlas: np.ndarray, block: tuple[int, ...]) -> np.ndarray:
    """The data voxels [bs, bs, bs, c] of a macroblock, a view into the atlas."""
    return block_copy(pack, atlas, block)[1:-1, 1:-1, 1:-1]


def _voxels(pack: Pack, block: tuple[int, ...]) -> np.ndarray:
    """rgba and features uint8 [bs, bs, bs, 8] of a macroblock."""
    assert pack.atlas_features is not None, "baking always stores features"
    return np.concatenate([_data(pack, atlas, block) for atlas in (pack.atlas_rgba, pack.atlas_features)], axis=-1)


def _reach(
    pack: Pack, dataset: RayDataset, tau_weight: float, seed: int, on_share: Callable[[float], None] | None
) -> np.ndarray:
    """uint8 [grid voxels z, y, x, filled up to whole macroblocks]: each voxel's reach; 0 where no weight touches it."""
    blocks = [tuple(block) for block in np.argwhere(pack.occupied)]
    size, side = pack.block_size, pack.padded_block_size
    alpha = np.zeros((max(len(blocks), 1), side, side, side), np.uint8)
    for slot, block in enumerate(blocks):
        alpha[slot] = block_copy(pack, pack.atlas_rgba, block)[..., 3]
    copies = np.asarray(_reach_of_copies(pack, alpha, dataset, tau_weight, seed, on_share)).reshape(alpha.shape)
    # A voxel is in the copies of up to eight macroblocks; a sample touches one of them. One more around the grid.
    reach = np.zeros([n * size + 2 for n in pack.occupied.shape], np.uint8)
    for slot, block in enumerate(blocks):
        at = reach[tuple(slice(b * size, b * size + side) for b in block)]
        np.maximum(at, copies[slot], out=at)
    return reach[1:-1, 1:-1, 1:-1]


def _reach_of_copies(
    pack: Pack, alpha: np.ndarray, dataset: RayDataset, tau_weight: float, seed: int,
    on_share: Callable[[float], None] | None,
) -> jax.Array:  # fmt: skip
    """uint8 [slots B³]: the reach of voxels of the padded copies, whose alpha is uint8 [slots, B, B, B]."""
    layout, sizes = pack_layout(pack), pack_sizes(pack, CHUNK_SAMPLES)
    grid_T_training = jnp.asarray(np.linalg.inv(pack.worldspace_T_opengl), jnp.float32)
    stored, reach = jnp.asarray(alpha.reshape(-1)), jnp.zeros(alpha.size, jnp.uint8)
    rng = np.random.default_rng(seed)
    count = max(int(min(RAYS_A_VOXEL * np.count_nonzero(alpha), MOST_RAYS)), CHUNK_RAYS)
    ids = rng.integers(0, dataset.count, count, np.int32)
    away = rng.random((count, 2), np.float32) - np.float32(0.5)
    meets = np.zeros(-(-count // CHUNK_RAYS) * CHUNK_RAYS, bool)
    for start in range(0, count, CHUNK_RAYS):  # most rays of a photograph may pass an object by
        chosen = np.minimum(np.arange(start, start + CHUNK_RAYS), count - 1)
        meets[start : start + CHUNK_RAYS] = _meets(
            layout, dataset, jnp.asarray(ids[chosen]), jnp.asarray(away[chosen]), grid_T_training, sizes.segments
        )
    ids, away, done = ids[meets[:count]], away[meets[:count]], 0
    count = len(ids)
    while done < count:
        chosen = np.minimum(np.arange(done, done + CHUNK_RAYS), count - 1)
        reach, complete = _raise_reach(
            reach, stored, layout, dataset, jnp.asarray(ids[chosen]), jnp.asarray(away[chosen]), grid_T_training,
            tau_weight, sizes,
        )  # fmt: skip
        whole = np.asarray(complete)
        done += CHUNK_RAYS if whole.all() else max(int(whole.argmin()), 1)
        if on_share:
            on_share(min(done / count, 1.0))
    return reach


@partial(jax.jit, static_argnames="segments")
def _meets(
    layout: PackLayout, dataset: RayDataset, ids: jax.Array, away: jax.Array, grid_T_training: jax.Array, segments: int
) -> jax.Array:
    """bool [N]: whether a ray may meet content."""
    rays = to_grid(layout, _whole_rays(dataset, ids, away, grid_T_training))
    return occupied_segments(layout, rays, jnp.full(ids.shape[0], 0.5), segments, 1.0).any(-1)


def _whole_rays(dataset: RayDataset, ids: jax.Array, away: jax.Array, grid_T_training: jax.Array) -> Rays:
    """Rays through places `away` [N, 2] pixels from the centres of pixels `ids`, in the grid frame, of any length."""
    rays = in_grid_frame(dataset.geometry_at(ids, away), grid_T_training)
    return rays._replace(near=jnp.zeros_like(rays.near), far=jnp.full_like(rays.far, jnp.inf))


@partial(jax.jit, static_argnames="sizes", donate_argnums=0)
def _raise_reach(
    reach: jax.Array, stored: jax.Array, layout: PackLayout, dataset: RayDataset, ids: jax.Array, away: jax.Array,
    grid_T_training: jax.Array, tau_weight: float, sizes: MarchSizes,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """Raises the reach by what rays `ids`, moved by `away` [N, 2] pixels, see; also which rays were marched whole."""
    count = ids.shape[0]
    rays = _whole_rays(dataset, ids, away, grid_T_training)
    samples = march(layout, to_grid(layout, rays), jnp.full(count, 0.5), sizes, 1.0, HORIZON)
    corners, shares = layout.corners(samples.g)
    alpha = jnp.einsum("nk,nk->n", shares, stored[corners].astype(jnp.float32)) * (1 / 255)
    alpha = jnp.where(samples.valid & (alpha > ALPHA_CONTRIBUTES), alpha, 0.0)
    before, _ = transmittance(samples, -jnp.log1p(-jnp.minimum(alpha, MAX_ALPHA)), count, sizes.per_ray)
    enough = (before > TRANSMITTANCE_STOP) & (before * alpha >= tau_weight)
    at = jnp.where(enough[:, None] & (shares > 0), corners, reach.size)
    value = jnp.ceil(255 * before).astype(jnp.uint8)
    return reach.at[at].max(jnp.broadcast_to(value[:, None], at.shape), mode="drop"), samples.complete
