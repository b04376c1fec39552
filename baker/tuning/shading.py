"""Accumulated rays as the viewer shows them (docs/rendering.md, "Shading"), and how far that is from the photographs; the view
MLP on its way between a pack (NumPy) and the trainer (JAX).

Notation: sums [N, 8] is what the march leaves of N rays: premultiplied colour (3) and features (4), T behind the last sample.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from scenepack.constants import UNPREMULTIPLY_GAIN
from scenepack.pack import ViewMlp
from training.dataset import RayDataset
from training.method import RenderOutput, ViewMlpParams
from training.multires.field import shade


class Pixels(NamedTuple):
    """R training rays."""

    sums: jax.Array  # [R, 8]: what they accumulate
    viewdirs: jax.Array  # [R, 3]
    target: jax.Array  # [R, 3]: colours of photographs
    whole: jax.Array  # bool [R]: which of them count


@jax.jit
def pixels_of(dataset: RayDataset, ids: jax.Array, sums: jax.Array) -> Pixels:
    """The training rays `ids`, all of which count."""
    viewdirs, target = dataset.geometry_at(ids).viewdirs, dataset.colours_at(ids)
    return Pixels(sums, viewdirs, target, jnp.ones(len(ids), bool))


class ErrorTerms(NamedTuple):
    """How the colours of rays are compared with photographs."""

    background: tuple[float, ...]
    ndc: bool  # a forward-facing scene
    by_opacity: bool  # errors weigh as much as the pack is opaque: photographs also show what lies outside of its box


def shown(
    sums: jax.Array, head: ViewMlpParams | None, viewdirs: jax.Array, background: tuple[float, ...], ndc: bool
) -> RenderOutput:
    """What the viewer makes of accumulated rays; colours above 1 are not yet clamped."""
    if ndc:  # forward-facing: partially un-premultiplied (appendix C.3)
        alpha = 1.0 - sums[:, 7:]
        gain = jnp.minimum(1.0, UNPREMULTIPLY_GAIN * alpha) / jnp.maximum(alpha, 1e-6)
        sums = jnp.concatenate([sums[:, :7] * gain, 1.0 - alpha * gain], axis=-1)
    return shade(sums, head, viewdirs, jnp.asarray(background))


def squared_error(
    head: ViewMlpParams | None, pixels: Pixels, terms: ErrorTerms, *, clamped: bool
) -> tuple[jax.Array, jax.Array]:
    """Sum over the rays that count, of what they accumulated, and of their weights.

    clamped: as on a screen; else colours below 0 still have a slope.
    """
    rgb = shown(pixels.sums, head, pixels.viewdirs, terms.background, terms.ndc).rgb
    rgb = jnp.clip(rgb, 0, 1) if clamped else jnp.minimum(rgb, 1.0)
    opacity = jax.lax.stop_gradient(1.0 - pixels.sums[:, 7]) if terms.by_opacity else 1.0
    weight = jnp.where(pixels.whole, opacity, 0.0)
    return jnp.square(weight[:, None] * (rgb - pixels.target)).sum(), jnp.square(weight).sum()


def psnr_of(error: float | jax.Array, weight: float | jax.Array) -> float:
    """PSNR of a sum of squared errors over colours of rays of so much weight, in dB."""
    return float(-10 * np.log10(max(float(error), 1e-12) / max(3 * float(weight), 1.0)))


def to_params(mlp: ViewMlp) -> ViewMlpParams:
    """The weights of a pack's view MLP, to be trained on."""
    return ViewMlpParams(*jax.tree.map(jnp.asarray, (mlp.weights, mlp.biases)))


def from_params(params: ViewMlpParams) -> ViewMlp:
    """Trained weights as a pack holds them, float32."""
    return ViewMlp(*jax.tree.map(lambda array: np.asarray(array, np.float32), tuple(params)))
