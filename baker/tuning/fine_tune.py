"""Fine-tuning of the view MLP on what the baked grid really shows (SNeRG section 5.5).

Baking to 8 bits shifts accumulated colours and features; the view MLP is trained on against the photographs, with the grid held
fixed. So every training pixel is marched once, and an epoch is a pass over what was accumulated. The paper does not say how many
pixels a step takes: here as many as a photograph has, of all photographs.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from baker.tuning.marcher import PackMarcher
from baker.tuning.shading import ErrorTerms, Pixels, from_params, pixels_of, squared_error, to_params
from scenepack.constants import TRANSMITTANCE_SHADED
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.method import ViewMlpParams

ADAM = optax.adam(3e-4)
EPOCHS = 100
MARCHED_AT_ONCE, SCORED_AT_ONCE = 1 << 22, 1 << 20


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
    terms, head = ErrorTerms(dataset.background, pack.ndc, by_opacity), to_params(pack.view_mlp)
    before = _psnr(head, pixels, terms)
    moments, key = ADAM.init(head), jax.random.key(seed)
    count = len(pixels.target)
    batch = -(-count // dataset.views)
    for epoch in range(epochs):  # pixels are in random order already: the same batches in another are enough
        order = jax.random.permutation(jax.random.fold_in(key, epoch), -(-count // batch))
        head, moments = _epoch(head, moments, pixels, order, batch, terms)
        on_share(0.5 + 0.5 * (epoch + 1) / epochs, f"epoch {epoch + 1} of {epochs}")
    figures = {
        "epochs": epochs,
        "train_psnr_before": round(before, 3),
        "train_psnr_after": round(_psnr(head, pixels, terms), 3),
    }
    return replace(pack, view_mlp=from_params(head)), figures


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
        shaded = sums[:, 7] <= TRANSMITTANCE_SHADED
        if shaded.any():
            parts.append(jax.tree.map(np.asarray, pixels_of(dataset, part[shaded], sums[shaded])))
    if not parts:
        return None
    order = np.random.default_rng(seed).permutation(sum(len(some.target) for some in parts))
    return jax.tree.map(lambda *of: jnp.asarray(np.concatenate(of)[order]), *parts)


@partial(jax.jit, static_argnames="terms")
def _mean_error(head: ViewMlpParams, pixels: Pixels, terms: ErrorTerms) -> jax.Array:
    """Mean squared error per channel of what the viewer would show; it clamps the sum."""
    return squared_error(head, pixels, terms, clamped=False)[0] / pixels.target.size


@partial(jax.jit, static_argnames=("batch", "terms"))
def _epoch(head, moments, pixels: Pixels, order: jax.Array, batch: int, terms: ErrorTerms):
    """One pass over the pixels, in batches of neighbours, in this order; the last is filled up with the first."""

    def step(carry, turn):
        head, moments = carry
        ids = (batch * turn + jnp.arange(batch)) % len(pixels.target)
        slope = jax.grad(_mean_error)(head, Pixels(*(array[ids] for array in pixels)), terms)
        updates, moments = ADAM.update(slope, moments, head)
        return (optax.apply_updates(head, updates), moments), None

    return jax.lax.scan(step, (head, moments), order)[0]


def _psnr(head: ViewMlpParams, pixels: Pixels, terms: ErrorTerms) -> float:
    """PSNR (dB) over all pixels, some at a time: a hidden layer of them all would take gigabytes."""
    count, error = len(pixels.target), 0.0
    for start in range(0, count, SCORED_AT_ONCE):
        part = Pixels(*(array[start : start + SCORED_AT_ONCE] for array in pixels))
        error += float(_mean_error(head, part, terms)) * len(part.target) / count
    return float(-10.0 * np.log10(max(error, 1e-12)))
