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

from baker.tuning.marcher import Accumulated, make_marcher
from baker.tuning.pack_layout import over_background
from baker.view_mlp import from_params, to_params
from scenepack.constants import TRANSMITTANCE_SHADED
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.method import ViewMlpParams
from training.view_mlp import apply_view_mlp

LEARNING_RATE = 3e-4
EPOCHS = 100
BATCH = 16_384
MAX_PIXELS = 1_000_000  # training pixels marched at most, an even random share: ample for 850 weights


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
    ids = np.random.default_rng(seed).permutation(dataset.count)[:MAX_PIXELS].astype(np.int32)
    ids.sort()  # neighbours read the same memory
    sums = make_marcher(pack, dataset).accumulate(
        ids, on_share and (lambda share: on_share(0.5 * share, "marching training pixels"))
    )
    shaded = np.asarray(sums.transmittance) <= TRANSMITTANCE_SHADED
    if not shaded.any():
        return None
    sums = Accumulated(*(jnp.asarray(part[shaded]) for part in sums))
    return _pixels(sums, dataset, jnp.asarray(ids[shaded]), pack.ndc)


@partial(jax.jit, static_argnames="ndc")
def _pixels(sums: Accumulated, dataset: RayDataset, ids: jax.Array, ndc: bool) -> Pixels:
    """What is accumulated along rays `ids`, ready for the view MLP, and what the photographs show there."""
    diffuse, features, behind = over_background(sums, dataset.background, ndc)
    viewdirs, target = dataset.geometry_at(ids).viewdirs, dataset.colours_at(ids)
    return Pixels(diffuse, features, viewdirs, target, 1 - behind[:, None])


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
