"""Fine-tuning of the view MLP on what the baked grid really shows (SNeRG section 5.6).

Baking to 8 bits shifts accumulated colours and features; the view MLP is trained on against the photographs, with the
grid held fixed. So every training pixel is marched once, and an epoch is a pass over what was accumulated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from baker.tuning.pack_layout import (
    PackLayout,
    accumulate,
    over_background,
    pack_layout,
    pack_rays,
    pack_sizes,
    pack_voxels,
)
from baker.view_mlp import from_params, to_params
from scenepack.constants import TRANSMITTANCE_SHADED
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.marching.batches import until_complete
from training.marching.march import MarchSizes
from training.marching.rays import GridFrameRays
from training.method import ViewMlpParams
from training.view_mlp import apply_view_mlp

LEARNING_RATE = 3e-4
EPOCHS = 100
BATCH = 16_384
MAX_PIXELS = 1_000_000  # training pixels marched at most, an even random share: ample for 850 weights
CHUNK_RAYS, CHUNK_SAMPLES = 4096, 131_072


class Pixels(NamedTuple):
    """Shaded training pixels: diffuse [P, 3] with background, features [P, 4], viewdirs [P, 3], target [P, 3]; weight [P, 1]
    of a pixel's error, before it is squared."""

    diffuse: jax.Array
    features: jax.Array
    viewdirs: jax.Array
    target: jax.Array
    weight: jax.Array


def fine_tune(
    pack: Pack, dataset: RayDataset, *, epochs: int = EPOCHS, seed: int = 0, by_opacity: bool = False,
    on_share: Callable[[float, str], None] | None = None,
) -> tuple[Pack, float, float]:  # fmt: skip
    """The pack with its view MLP refined, and the PSNR over shaded training pixels before and after.

    by_opacity: photographs also show what lies outside of the pack's box. Errors are weighted by the pack's own opacity, as
    the paper masks pictures of such scenes (section 6).

    A diffuse pack, and one that no training pixel meets, comes back as it is.
    """
    if pack.view_mlp is None or epochs < 1:
        return pack, float("nan"), float("nan")
    pixels = shaded_pixels(pack, dataset, seed, on_share)
    if pixels is None:
        return pack, float("nan"), float("nan")
    if not by_opacity:
        pixels = pixels._replace(weight=jnp.ones_like(pixels.weight))
    params = to_params(pack.view_mlp)
    before = _psnr(params, pixels)
    optimiser = optax.adam(LEARNING_RATE)
    moments, key = optimiser.init(params), jax.random.key(seed)
    for epoch in range(epochs):
        params, moments = _epoch(params, moments, pixels, jax.random.fold_in(key, epoch), optimiser)
        if on_share:
            on_share(0.5 + 0.5 * (epoch + 1) / epochs, f"epoch {epoch + 1} of {epochs}")
    after = _psnr(params, pixels)
    return replace(pack, view_mlp=from_params(params)), before, after


def shaded_pixels(
    pack: Pack, dataset: RayDataset, seed: int, on_share: Callable[[float, str], None] | None
) -> Pixels | None:
    """Marches the training pixels through the pack and keeps those that the viewer shades (T <= 254/255)."""
    layout, voxels = pack_layout(pack), pack_voxels(pack)
    rays, sizes = pack_rays(pack, dataset), pack_sizes(pack, CHUNK_SAMPLES)
    ids = np.random.default_rng(seed).permutation(dataset.count)[:MAX_PIXELS].astype(np.int32)

    def march_some(places: np.ndarray) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        *made, complete = _march_pixels(layout, voxels, dataset, rays, jnp.asarray(ids[places]), sizes, pack.ndc)
        return (made[0], made[1]), complete

    kept = []
    for start, end, (values, shaded) in until_complete(len(ids), CHUNK_RAYS, march_some):
        kept.append(np.asarray(values)[: end - start][np.asarray(shaded)[: end - start]])
        if on_share:
            on_share(0.5 * end / len(ids), "marching training pixels")
    table = np.concatenate(kept)
    if len(table) == 0:
        return None
    return Pixels(*(jnp.asarray(part) for part in np.split(table, [3, 7, 10, 13], axis=1)))


@partial(jax.jit, static_argnames=("sizes", "ndc"))
def _march_pixels(
    layout: PackLayout, voxels: jax.Array, dataset: RayDataset, source: GridFrameRays, ids: jax.Array,
    sizes: MarchSizes, ndc: bool,
) -> tuple[jax.Array, jax.Array, jax.Array]:  # fmt: skip
    """[N, 14] diffuse, features, viewdirs, target, opacity of pixels `ids`; which are shaded; which were marched whole."""
    rays, target = source.geometry_at(ids), dataset.colours_at(ids)
    sums, complete = accumulate(layout, voxels, rays, sizes)
    diffuse, features, behind = over_background(sums, dataset.background, ndc)
    table = jnp.concatenate([diffuse, features, rays.viewdirs, target, 1 - behind[:, None]], axis=-1)
    return table, behind <= TRANSMITTANCE_SHADED, complete


def _squared_error(params: ViewMlpParams, pixels: Pixels) -> jax.Array:
    """Mean squared error per channel of what the viewer would show; it clamps the sum."""
    residual = apply_view_mlp(params, pixels.diffuse, pixels.features, pixels.viewdirs)
    return jnp.mean(jnp.square(pixels.weight * (jnp.minimum(pixels.diffuse + residual, 1.0) - pixels.target)))


@partial(jax.jit, static_argnames="optimiser")
def _epoch(params, moments, pixels: Pixels, key: jax.Array, optimiser: optax.GradientTransformation):
    """One pass over the pixels in random order; the last incomplete batch is filled up with other pixels."""
    count = pixels.diffuse.shape[0]
    batches = -(-count // BATCH)
    order = jnp.resize(jax.random.permutation(key, count), (batches, BATCH))

    def step(carry, ids):
        params, moments = carry
        slope = jax.grad(_squared_error)(params, Pixels(*(array[ids] for array in pixels)))
        updates, moments = optimiser.update(slope, moments, params)
        return (optax.apply_updates(params, updates), moments), None

    return jax.lax.scan(step, (params, moments), order)[0]


@jax.jit
def _psnr(params: ViewMlpParams, pixels: Pixels) -> jax.Array:
    return -10.0 * jnp.log10(_squared_error(params, pixels))
