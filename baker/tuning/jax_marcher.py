"""baker.tuning.marcher.PackMarcher by XLA: for cards, and the reference for other marchers.

Notation: B = block_size + 2; S samples of a chunk of rays.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from baker.tuning.marcher import Accumulated, OnShare, box_of
from baker.tuning.pack_layout import (
    MAX_ALPHA,
    PackLayout,
    accumulate,
    pack_layout,
    pack_rays,
    pack_sizes,
    pack_voxels,
)
from scenepack.blocks import block_copy
from scenepack.constants import ALPHA_CONTRIBUTES, TRANSMITTANCE_STOP
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.marching.batches import rays_that_meet, until_complete
from training.marching.layout import depth_where
from training.marching.march import MarchSizes, Samples, march, transmittance
from training.marching.rays import GridFrameRays, to_grid

EARLY_TERMINATION = 1e-4  # T at which marches end; depths are estimates, so far behind the last T that counts
LIGHT_RAYS, LIGHT_SAMPLES = 16_384, 524_288  # of a chunk whose light is told
COLOUR_RAYS, COLOUR_SAMPLES = 4096, 131_072  # of a chunk that is accumulated


class Sighted(NamedTuple):
    """A pack to look at: where its voxels are, the training rays in its frame, alpha uint8 [slots B³] of padded copies."""

    layout: PackLayout
    rays: GridFrameRays
    alpha: jax.Array


class Seen(NamedTuple):
    """Samples of rays: T before each [S], its alpha [S], corners int32 [S, 8] and shares [S, 8] as PackLayout.corners."""

    samples: Samples
    before: jax.Array
    alpha: jax.Array
    corners: jax.Array
    shares: jax.Array


class JaxMarcher:
    """See baker.tuning.marcher.PackMarcher."""

    def __init__(self, pack: Pack, dataset: RayDataset) -> None:
        self.pack, self.rays, self.layout = pack, pack_rays(pack, dataset), pack_layout(pack)
        self.box, self.sizes = box_of(pack), pack_sizes(pack, LIGHT_SAMPLES)

    def meets(self, ids: np.ndarray, away: np.ndarray | None = None) -> np.ndarray:
        return rays_that_meet(self.layout, self.rays, ids, self.sizes.segments, away=away)

    def half_depths(self, ids: np.ndarray) -> np.ndarray:
        depths, scene = np.zeros(len(ids), np.float32), self._sighted()

        def march_some(places: np.ndarray) -> tuple[jax.Array, jax.Array]:
            return _half_depths(scene, jnp.asarray(ids[places]), self.sizes)

        for start, end, some in until_complete(len(ids), COLOUR_RAYS, march_some):
            depths[start:end] = np.asarray(some)[: end - start]
        return depths

    def light(self, ids: np.ndarray, away: np.ndarray, on_share: OnShare | None = None) -> np.ndarray:
        scene, side = self._sighted(), self.pack.padded_block_size
        best = jnp.zeros(scene.alpha.size, jnp.uint8)

        def march_some(places: np.ndarray) -> tuple[None, jax.Array]:
            nonlocal best
            some = jnp.asarray(ids[places]), jnp.asarray(away[places])
            best, complete = _raise_transmittance(best, scene, *some, self.sizes)
            return None, complete

        for _, done, _ in until_complete(len(ids), LIGHT_RAYS, march_some):
            if on_share:
                on_share(done / len(ids))
        return np.asarray(best).reshape(-1, side, side, side)

    def accumulate(self, ids: np.ndarray, on_share: OnShare | None = None) -> Accumulated:
        sizes, voxels = self.sizes._replace(samples=COLOUR_SAMPLES, coarse=COLOUR_SAMPLES // 2), pack_voxels(self.pack)
        sums = np.empty((len(ids), 8), np.float32)

        def march_some(places: np.ndarray) -> tuple[jax.Array, jax.Array]:
            return _accumulated(self.layout, voxels, self.rays, jnp.asarray(ids[places]), sizes)

        for start, end, some in until_complete(len(ids), COLOUR_RAYS, march_some):
            sums[start:end] = np.asarray(some)[: end - start]
            if on_share:
                on_share(end / len(ids))
        return Accumulated(sums[:, :3], sums[:, 3:7], sums[:, 7])  # type: ignore[arg-type]

    def _sighted(self) -> Sighted:
        blocks, side = np.argwhere(self.pack.occupied), self.pack.padded_block_size
        alpha = np.zeros((max(len(blocks), 1), side, side, side), np.uint8)
        for slot, block in enumerate(map(tuple, blocks)):
            alpha[slot] = block_copy(self.pack, self.pack.atlas_rgba, block)[..., 3]
        return Sighted(self.layout, self.rays, jnp.asarray(alpha.reshape(-1)))


def marcher_of(pack: Pack, dataset: RayDataset) -> JaxMarcher:
    """The marcher of a pack."""
    return JaxMarcher(pack, dataset)


def see(
    scene: Sighted, ids: jax.Array, away: jax.Array | None, sizes: MarchSizes, last_depth: int | None = None
) -> Seen:
    """The samples of rays `ids`, moved by `away` [N, 2] pixels, as the viewer takes them; alpha is 0 where none counts."""
    count = ids.shape[0]
    rays = to_grid(scene.layout, scene.rays.geometry_at(ids, away))
    samples = march(scene.layout, rays, jnp.full(count, 0.5), sizes, 1.0, last_depth)
    corners, shares = scene.layout.corners(samples.g)
    alpha = (shares * scene.alpha[corners].astype(jnp.float32)).sum(-1) * (1 / 255)
    alpha = jnp.where(samples.valid & (alpha > ALPHA_CONTRIBUTES), alpha, 0.0)
    before, _ = transmittance(samples, -jnp.log1p(-jnp.minimum(alpha, MAX_ALPHA)), count, sizes.per_ray)
    return Seen(samples, before, alpha, corners, shares)


@partial(jax.jit, static_argnames="sizes")
def _half_depths(scene: Sighted, ids: jax.Array, sizes: MarchSizes) -> tuple[jax.Array, jax.Array]:
    """See PackMarcher.half_depths; also which rays were marched whole."""
    seen = see(scene, ids, None, sizes)
    half = (seen.alpha > 0) & (seen.before >= 0.5)
    depths = jnp.zeros(ids.shape[0]).at[seen.samples.ray].max(jnp.where(half, seen.samples.t, 0.0))
    return depths, seen.samples.complete


@partial(jax.jit, static_argnames="sizes", donate_argnums=0)
def _raise_transmittance(
    best: jax.Array, scene: Sighted, ids: jax.Array, away: jax.Array, sizes: MarchSizes
) -> tuple[jax.Array, jax.Array]:
    """Raises `best` by what rays `ids`, moved by `away` [N, 2] pixels, see; also which rays were marched whole."""
    seen = see(scene, ids, away, sizes, depth_where(EARLY_TERMINATION))
    arrives = (seen.before > TRANSMITTANCE_STOP) & (seen.alpha > 0)
    at = jnp.where(arrives[:, None] & (seen.shares > 0), seen.corners, best.size)
    value = jnp.ceil(255 * seen.before).astype(jnp.uint8)
    return best.at[at].max(jnp.broadcast_to(value[:, None], at.shape), mode="drop"), seen.samples.complete


@partial(jax.jit, static_argnames="sizes")
def _accumulated(
    layout: PackLayout, voxels: jax.Array, source: GridFrameRays, ids: jax.Array, sizes: MarchSizes
) -> tuple[jax.Array, jax.Array]:
    """[N, 8] colour, features and T of rays `ids`; which were marched whole."""
    sums, complete = accumulate(layout, voxels, source.geometry_at(ids), sizes)
    return jnp.concatenate([sums.colour, sums.features, sums.transmittance[:, None]], axis=-1), complete
