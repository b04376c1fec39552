"""A baked pack as JAX arrays, marched as the viewer marches it (docs/rendering.md).

Notation: B = block_size + 2; slots number the occupied macroblocks; `voxels` uint8 [slots B³, 8] holds their padded copies
as rgb, alpha, features, each premultiplied by alpha. Grid coordinates g are in voxels from the grid's corner.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from baker.tuning.marcher import Accumulated
from scenepack.blocks import block_copy
from scenepack.constants import ALPHA_CONTRIBUTES, FEATURES, TRANSMITTANCE_STOP, UNPREMULTIPLY_GAIN
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.marching.layout import (
    COARSE,
    DEEPEST,
    DEPTH_UNITS,
    blend,
    coarse_cell,
    flat_index,
    segments_across,
    trilinear_weights,
)
from training.marching.march import MarchSizes, Samples, march, transmittance
from training.marching.rays import GridFrameRays, to_grid
from training.method import Rays

MAX_ALPHA = 1 - 1e-6  # keeps the optical depth of opaque samples finite


class PackLayout(NamedTuple):
    """Where voxels are: a training.marching.layout.Layout over macroblocks.

    blocks int32 [bz by bx]: slot of each macroblock, -1 empty; block_dims int32 [3]; block_size int32.
    support uint8 [slots B³]: of the cell between this voxel and the next along each axis, 0 where all have alpha 0, else 1 plus
    the optical depth of a step at their mean alpha, in 1 / DEPTH_UNITS.
    coarse uint8, coarse_dims int32 [3]: coarse occupancy.
    """

    origin: jax.Array
    voxel: jax.Array
    dims: jax.Array
    blocks: jax.Array
    block_dims: jax.Array
    block_size: jax.Array
    support: jax.Array
    coarse: jax.Array
    coarse_dims: jax.Array

    def _lower(self, g: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Slot [N] (-1 empty), lowest of the 8 voxels within the padded copy int32 [N, 3], fractions [N, 3]."""
        block = jnp.clip((g / self.block_size).astype(jnp.int32), 0, self.block_dims - 1)
        slot = self.blocks[flat_index(block, self.block_dims)]
        local = g - block * self.block_size + 0.5  # + 1 for the padding, - 0.5 for the centre
        lower = jnp.clip(jnp.floor(local), 0, self.block_size)
        return slot, lower.astype(jnp.int32), local - lower

    def _flat(self, slot: jax.Array, cell: jax.Array) -> jax.Array:
        side = self.block_size + 2
        return ((jnp.maximum(slot, 0) * side + cell[:, 2]) * side + cell[:, 1]) * side + cell[:, 0]

    def has_support(self, g: jax.Array) -> jax.Array:
        """bool [..]: whether any of the 8 voxels around g [.., 3] within its macroblock's copy has alpha."""
        slot, lower, _ = self._lower(g.reshape(-1, 3))
        return ((slot >= 0) & (self.support[self._flat(slot, lower)] > 0)).reshape(g.shape[:-1])

    def optical_depth(self, g: jax.Array) -> jax.Array:
        """int32 [...]: see training.marching.layout.Layout."""
        slot, lower, _ = self._lower(g.reshape(-1, 3))
        depth = self.support[self._flat(slot, lower)].astype(jnp.int32)
        return jnp.where(slot >= 0, depth, 0).reshape(g.shape[:-1])

    def near_content(self, g: jax.Array) -> jax.Array:
        """bool [...]: whether content may lie within COARSE/2 voxels of g [..., 3]."""
        return self.coarse[coarse_cell(g, self.coarse_dims)] > 0

    def corners(self, g: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Rows of `voxels` int32 [N, 8] around g [N, 3], and trilinear weights [N, 8]."""
        slot, lower, fraction = self._lower(g)
        side = self.block_size + 2
        offsets = jnp.stack([(dz * side + dy) * side + dx for dz in (0, 1) for dy in (0, 1) for dx in (0, 1)])
        return self._flat(slot, lower)[:, None] + offsets, trilinear_weights(fraction)


def over_background(
    sums: Accumulated, background: tuple[float, ...], ndc: bool
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Diffuse colour [N, 3] over the background, features [N, 4] and T [N] of what was accumulated (docs/rendering.md)."""
    colour, features, behind = sums
    if ndc:  # forward-facing: partially un-premultiplied (appendix C.3)
        alpha = 1.0 - behind
        gain = jnp.minimum(1.0, UNPREMULTIPLY_GAIN * alpha) / jnp.maximum(alpha, 1e-6)
        colour, features, behind = colour * gain[:, None], features * gain[:, None], 1.0 - alpha * gain
    return colour + behind[:, None] * jnp.asarray(background), features, behind


def pack_voxels(pack: Pack) -> jax.Array:
    """The padded copies of a pack's macroblocks, uint8 [slots B³, 8]."""
    blocks = np.argwhere(pack.occupied)
    side = pack.padded_block_size
    voxels = np.zeros((max(len(blocks), 1), side, side, side, 4 + FEATURES), np.uint8)
    for slot, block in enumerate(map(tuple, blocks)):
        voxels[slot, ..., :4] = block_copy(pack, pack.atlas_rgba, block)
        if pack.atlas_features is not None:
            voxels[slot, ..., 4:] = block_copy(pack, pack.atlas_features, block)
    return jnp.asarray(voxels.reshape(-1, 4 + FEATURES))


def pack_layout(pack: Pack) -> PackLayout:
    """Where the voxels of a pack are."""
    blocks = np.argwhere(pack.occupied)
    size, side = pack.block_size, pack.padded_block_size
    slots = np.full(pack.occupied.shape, -1, np.int32)
    coarse = np.zeros([-(-n * size // COARSE) for n in pack.occupied.shape], np.uint8)
    support = np.zeros((max(len(blocks), 1), side, side, side), np.uint8)
    mean = np.arange(8 * 255 + 1) / (8 * 255)
    codes = 1 + np.minimum(-DEPTH_UNITS * np.log1p(-np.minimum(mean, MAX_ALPHA)), DEEPEST).astype(np.uint8)
    codes[0] = 0
    for slot, block in enumerate(map(tuple, blocks)):
        slots[block] = slot
        alpha = block_copy(pack, pack.atlas_rgba, block)[..., 3].astype(np.uint16)
        for axis in range(3):
            alpha = alpha + np.roll(alpha, -1, axis)  # the last cell along an axis is never a lower corner
        support[slot] = codes[alpha]
        _mark_coarse(coarse, alpha[: size + 1, : size + 1, : size + 1], np.array(block) * size)
    width, height, depth = pack.grid_size
    return PackLayout(
        origin=jnp.asarray(pack.min_xyz, jnp.float32),
        voxel=jnp.float32(pack.voxel_size),
        dims=jnp.asarray([width, height, depth], jnp.int32),
        blocks=jnp.asarray(slots.ravel()),
        block_dims=jnp.asarray(slots.shape[::-1], jnp.int32),
        block_size=jnp.int32(size),
        support=jnp.asarray(support.ravel()),
        coarse=jnp.asarray(coarse.ravel()),
        coarse_dims=jnp.asarray(coarse.shape[::-1], jnp.int32),
    )


def _mark_coarse(coarse: np.ndarray, some: np.ndarray, start: np.ndarray) -> None:
    """Sets the coarse occupancy within COARSE/2 + 1 voxels of the cells that are not 0 in `some` [z, y, x], of a macroblock
    at `start`.
    """
    near = COARSE // 2 + 1
    where = np.argwhere(some) + start - 1  # a cell's samples lie within g = cell - 1/2 ... cell + 1/2 of the grid
    for shift in np.stack(np.meshgrid(*((-near, 0, near + 1),) * 3, indexing="ij"), -1).reshape(-1, 3):
        at = np.clip((where + shift) // COARSE, 0, np.array(coarse.shape) - 1)
        coarse[tuple(at.T)] = 1


def pack_sizes(pack: Pack, samples: int) -> MarchSizes:
    """List sizes for marching a pack: `samples` in all, and room for the longest ray."""
    segments = segments_across(pack.grid_size)
    return MarchSizes(segments, samples // 2, samples, segments * COARSE)


def pack_rays(pack: Pack, dataset: RayDataset) -> GridFrameRays:
    """The training rays as a viewer of the pack would cast them: in its grid frame, from the camera on, without an end."""
    return GridFrameRays(dataset, jnp.asarray(np.linalg.inv(pack.worldspace_T_opengl), jnp.float32))


def composite(samples: Samples, values: jax.Array, rays: int, per_ray: int) -> Accumulated:
    """Front-to-back compositing of interpolated premultiplied values [S, 8] in [0, 1], by the rules of docs/rendering.md."""
    alpha = jnp.where(samples.valid & (values[:, 3] > ALPHA_CONTRIBUTES), values[:, 3], 0.0)
    tau = -jnp.log1p(-jnp.minimum(alpha, MAX_ALPHA))
    before, _ = transmittance(samples, tau, rays, per_ray)
    taken = (alpha > 0) & (before > TRANSMITTANCE_STOP)
    weight = jnp.where(taken, before, 0.0)[:, None]
    sums = (
        jnp.zeros((rays, 8))
        .at[samples.ray]
        .add(
            jnp.concatenate(
                [values[:, :3] * weight, values[:, 4:] * weight, jnp.where(taken, tau, 0.0)[:, None]], axis=-1
            )
        )
    )
    return Accumulated(sums[:, :3], sums[:, 3:7], jnp.exp(-sums[:, 7]))


@partial(jax.jit, static_argnames="sizes")
def accumulate(layout: PackLayout, voxels: jax.Array, rays: Rays, sizes: MarchSizes) -> tuple[Accumulated, jax.Array]:
    """Marches rays given in the grid frame; also bool [N]: which rays were marched whole (see march)."""
    count = rays.near.shape[0]
    samples = march(layout, to_grid(layout, rays), jnp.full(count, 0.5), sizes, 1.0)
    ids, weights = layout.corners(samples.g)
    values = blend(voxels[ids].astype(jnp.float32) * (1 / 255), weights)
    return composite(samples, values, count, sizes.per_ray), samples.complete
