"""Fine-tuning of the view MLP on what the baked grid really shows (SNeRG section 5.5).

Baking to 8 bits shifts accumulated colours and features; the view MLP is trained on against the photographs, with the grid held
fixed. So every training pixel is marched once, and an epoch is a pass over what was accumulated. The paper does not say how many
pixels a step takes: here as many as a photograph has, of all photographs.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from baker.tuning.marcher import PackMarcher
from baker.tuning.shading import Accumulated, from_params, over_background, to_params
from scenepack.constants import TRANSMITTANCE_SHADED
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.method import ViewMlpParams
from training.rendering import apply_view_mlp

LEARNING_RATE = 3e-4
EPOCHS = 100
MARCHED_AT_ONCE, SCORED_AT_ONCE = 1 << 22, 1 << 20


class Pixels(NamedTuple):
    """Shaded training pixels."""

    diffuse: jax.Array  # [P, 3], with background
    features: jax.Array  # [P, 4]
    viewdirs: jax.Array  # [P, 3]
    target: jax.Array  # [P, 3]
    weight: jax.Array  # [P, 1], of a pixel's error before it is squared


def fine_tune(
    pack: Pack, dataset: RayDataset, *, epochs: int = EPOCHS, seed: int = 0, by_opacity: bool = False,
    on_share: Callable[[float, str], None] = lambda share, text: None,
) -> tuple[Pack, dict[str, Any]]:  # fmt: skip
    """The pack with its view MLP refined; figures: PSNR over shaded training pixels before and after.

    by_opacity: photographs also show what lies outside of the pack's box. Errors are weighted by the pack's own opacity, as
    the paper masks pictures of such scenes (appendix C.2).

    Returns the same pack and no figures where it is diffuse or no training pixel meets it.
    """
    pixels = None if pack.view_mlp is None else shaded_pixels(pack, dataset, seed, on_share)
    if pack.view_mlp is None or pixels is None:
        return pack, {}
    if not by_opacity:
        pixels = pixels._replace(weight=jnp.ones_like(pixels.weight))
    params = to_params(pack.view_mlp)
    before = _psnr(params, pixels)
    optimiser = optax.adam(LEARNING_RATE)
    moments, key = optimiser.init(params), jax.random.key(seed)
    count = len(pixels.diffuse)
    batch = -(-count // dataset.views)
    for epoch in range(epochs):  # pixels are in random order already: the same batches in another are enough
        order = jax.random.permutation(jax.random.fold_in(key, epoch), -(-count // batch))
        params, moments = _epoch(params, moments, pixels, order, batch, optimiser)
        on_share(0.5 + 0.5 * (epoch + 1) / epochs, f"epoch {epoch + 1} of {epochs}")
    figures = {
        "epochs": epochs,
        "train_psnr_before": round(before, 3),
        "train_psnr_after": round(_psnr(params, pixels), 3),
    }
    return replace(pack, view_mlp=from_params(params)), figures


def shaded_pixels(
    pack: Pack, dataset: RayDataset, seed: int = 0, on_share: Callable[[float, str], None] = lambda share, text: None
) -> Pixels | None:
    """Marches all training pixels through the pack and keeps those that the viewer shades (T <= 254/255), in random order."""
    marcher, parts = PackMarcher(pack, dataset), []
    for start in range(0, dataset.count, MARCHED_AT_ONCE):
        part = np.arange(start, min(start + MARCHED_AT_ONCE, dataset.count), dtype=np.int32)

        def tell(share: float, done: int = start, more: int = len(part)) -> None:
            on_share(0.5 * (done + share * more) / dataset.count, "marching training pixels")

        sums = marcher.accumulate(part, tell)
        shaded = np.asarray(sums.transmittance) <= TRANSMITTANCE_SHADED
        if shaded.any():
            sums = Accumulated(*(jnp.asarray(of[shaded]) for of in sums))
            parts.append(Pixels(*map(np.asarray, _pixels(sums, dataset, jnp.asarray(part[shaded]), pack.ndc))))  # type: ignore[arg-type]
    if not parts:
        return None
    order = np.random.default_rng(seed).permutation(sum(len(some.diffuse) for some in parts))
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


@partial(jax.jit, static_argnames=("batch", "optimiser"))
def _epoch(params, moments, pixels: Pixels, order: jax.Array, batch: int, optimiser: optax.GradientTransformation):
    """One pass over the pixels, in batches of neighbours, in this order; the last is filled up with the first."""

    def step(carry, turn):
        params, moments = carry
        ids = (batch * turn + jnp.arange(batch)) % len(pixels.diffuse)
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
