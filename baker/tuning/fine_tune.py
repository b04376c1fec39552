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

from baker.tuning.marcher import PackMarcher
from baker.tuning.shading import Accumulated, over_background
from baker.view_mlp import from_params, to_params
from scenepack.constants import TRANSMITTANCE_SHADED
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.method import ViewMlpParams
from training.view_mlp import apply_view_mlp

LEARNING_RATE = 3e-4
EPOCHS = 100
BATCH = 16_384
FINE_TUNE_PIXELS = 1_000_000  # training pixels marched, an even random share: ample for 850 weights
MARCHED_AT_ONCE, SCORED_AT_ONCE = 1 << 22, 1 << 20


class Pixels(NamedTuple):
    """Shaded training pixels: diffuse [P, 3] with background, features [P, 4], viewdirs [P, 3], target [P, 3]; weight [P, 1]
    of a pixel's error, before it is squared."""

    diffuse: jax.Array
    features: jax.Array
    viewdirs: jax.Array
    target: jax.Array
    weight: jax.Array


def fine_tune(
    pack: Pack, dataset: RayDataset, *, epochs: int = EPOCHS, most_pixels: int = FINE_TUNE_PIXELS, seed: int = 0,
    by_opacity: bool = False, on_share: Callable[[float, str], None] | None = None,
) -> tuple[Pack, float, float]:  # fmt: skip
    """The pack with its view MLP refined, and the PSNR over shaded training pixels before and after.

    most_pixels: how many training pixels, an even random share; 0 for all of them (the paper), which the release takes a whole
    photograph a step. The paper does not say how many a step: here as many as a photograph has, of all photographs.

    by_opacity: photographs also show what lies outside of the pack's box. Errors are weighted by the pack's own opacity, as
    the paper masks pictures of such scenes (section 6).

    A diffuse pack, and one that no training pixel meets, comes back as it is.
    """
    if pack.view_mlp is None or epochs < 1:
        return pack, float("nan"), float("nan")
    pixels = shaded_pixels(pack, dataset, most_pixels, seed, on_share)
    if pixels is None:
        return pack, float("nan"), float("nan")
    if not by_opacity:
        pixels = pixels._replace(weight=jnp.ones_like(pixels.weight))
    params = to_params(pack.view_mlp)
    before = _psnr(params, pixels)
    optimiser = optax.adam(LEARNING_RATE)
    moments, key = optimiser.init(params), jax.random.key(seed)
    batch = BATCH if most_pixels else max(-(-len(pixels.diffuse) // dataset.views), 1)
    for epoch in range(epochs):
        order = _order(jax.random.fold_in(key, epoch), len(pixels.diffuse), batch, fixed=not most_pixels)
        params, moments = _epoch(params, moments, pixels, order, optimiser)
        if on_share:
            on_share(0.5 + 0.5 * (epoch + 1) / epochs, f"epoch {epoch + 1} of {epochs}")
    after = _psnr(params, pixels)
    return replace(pack, view_mlp=from_params(params)), before, after


def shaded_pixels(
    pack: Pack, dataset: RayDataset, most_pixels: int, seed: int, on_share: Callable[[float, str], None] | None
) -> Pixels | None:
    """Marches `most_pixels` training pixels (0: all) through the pack and keeps those that the viewer shades (T <= 254/255), in
    random order where they are all."""
    count, rng = dataset.count, np.random.default_rng(seed)
    ids = rng.permutation(count)[:most_pixels].astype(np.int32) if most_pixels else np.arange(count, dtype=np.int32)
    ids.sort()  # neighbours read the same memory
    marcher, parts = PackMarcher(pack, dataset), []
    for start in range(0, len(ids), MARCHED_AT_ONCE):
        part = ids[start : start + MARCHED_AT_ONCE]

        def tell(share: float, done: int = start, more: int = len(part)) -> None:
            if on_share:
                on_share(0.5 * (done + share * more) / len(ids), "marching training pixels")

        sums = marcher.accumulate(part, tell)
        shaded = np.asarray(sums.transmittance) <= TRANSMITTANCE_SHADED
        if shaded.any():
            sums = Accumulated(*(jnp.asarray(of[shaded]) for of in sums))
            parts.append(Pixels(*map(np.asarray, _pixels(sums, dataset, jnp.asarray(part[shaded]), pack.ndc))))  # type: ignore[arg-type]
    if not parts:
        return None
    order = slice(None) if most_pixels else rng.permutation(sum(len(some.diffuse) for some in parts))
    return Pixels(*(jnp.asarray(np.concatenate(of)[order]) for of in zip(*parts, strict=True)))


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


@partial(jax.jit, static_argnames=("count", "batch", "fixed"))
def _order(key: jax.Array, count: int, batch: int, *, fixed: bool) -> jax.Array:
    """int32 [batches, batch]: places of the pixels of an epoch's steps; the last incomplete batch is filled up with others.

    fixed: pixels are in random order already, and it is enough to take the same batches in another: no reading of gigabytes in
    random order.
    """
    batches = -(-count // batch)
    if not fixed:
        return jnp.resize(jax.random.permutation(key, count), (batches, batch))
    return (batch * jax.random.permutation(key, batches)[:, None] + jnp.arange(batch)) % count


@partial(jax.jit, static_argnames="optimiser")
def _epoch(params, moments, pixels: Pixels, order: jax.Array, optimiser: optax.GradientTransformation):
    """One pass over the pixels, in batches of places `order`."""

    def step(carry, ids):
        params, moments = carry
        slope = jax.grad(_squared_error)(params, Pixels(*(array[ids] for array in pixels)))
        updates, moments = optimiser.update(slope, moments, params)
        return (optax.apply_updates(params, updates), moments), None

    return jax.lax.scan(step, (params, moments), order)[0]


def _psnr(params: ViewMlpParams, pixels: Pixels) -> float:
    """PSNR (dB) over all pixels, some at a time: a hidden layer of them all would take gigabytes."""
    count, total = len(pixels.diffuse), 0.0
    for start in range(0, count, SCORED_AT_ONCE):
        part = Pixels(*(array[start : start + SCORED_AT_ONCE] for array in pixels))
        total += float(_error(params, part)) * len(part.diffuse)
    return float(-10.0 * np.log10(max(total / count, 1e-12)))


_error = jax.jit(_squared_error)
