"""Accumulated rays as the viewer shows them (docs/rendering.md, "Shading"), and how far that is from the photographs; the view
MLP on its way between a pack (NumPy) and the trainer (JAX)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from scenepack.constants import TRANSMITTANCE_SHADED, UNPREMULTIPLY_GAIN
from scenepack.pack import ViewMlp
from training.method import ViewMlpParams
from training.rendering import apply_view_mlp


class Accumulated(NamedTuple):
    """What the march leaves of N rays. Of NumPy or of JAX."""

    colour: jax.Array  # [N, 3], premultiplied
    features: jax.Array  # [N, 4], premultiplied
    transmittance: jax.Array  # [N]: T behind the last sample


class ShadingInputs(NamedTuple):
    """R rays and the view MLP."""

    sums: Accumulated
    head: ViewMlpParams | None
    viewdirs: jax.Array  # [R, 3]
    target: jax.Array  # [R, 3]: colours of photographs
    whole: jax.Array  # bool [R]: which of them count
    background: tuple[float, ...]


class ErrorTerms(NamedTuple):
    """How the colours of rays are compared with photographs."""

    ndc: bool  # a forward-facing scene
    by_opacity: bool  # errors weigh as much as the pack is opaque: photographs also show what lies outside of its box


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


def shown(
    sums: Accumulated, head: ViewMlpParams | None, viewdirs: jax.Array, background: tuple[float, ...], ndc: bool
) -> jax.Array:
    """[R, 3] what the viewer makes of accumulated rays, above 1 not yet clamped."""
    diffuse, features, behind = over_background(sums, background, ndc)
    if head is None:
        return diffuse
    residual = apply_view_mlp(head, diffuse, features, viewdirs)
    return diffuse + residual * (behind <= TRANSMITTANCE_SHADED)[:, None]


def squared_error(inputs: ShadingInputs, terms: ErrorTerms, *, clamped: bool) -> tuple[jax.Array, jax.Array]:
    """Sum over the rays that count, of what they accumulated, and of their weights.

    clamped: as on a screen; else colours below 0 still have a slope.
    """
    sums, head, viewdirs, target, whole, background = inputs
    rgb = shown(sums, head, viewdirs, background, terms.ndc)
    rgb = jnp.clip(rgb, 0, 1) if clamped else jnp.minimum(rgb, 1.0)
    opacity = jax.lax.stop_gradient(1.0 - sums.transmittance) if terms.by_opacity else 1.0
    weight = jnp.where(whole, opacity, 0.0)
    return jnp.square(weight[:, None] * (rgb - target)).sum(), jnp.square(weight).sum()


def psnr_of(error: float, weight: float) -> float:
    """PSNR of a sum of squared errors over colours of rays of so much weight, in dB."""
    return float(-10 * np.log10(max(error, 1e-12) / max(3 * weight, 1.0)))


def to_params(mlp: ViewMlp) -> ViewMlpParams:
    """The weights of a pack's view MLP, to be trained on."""
    return ViewMlpParams(*jax.tree.map(jnp.asarray, (mlp.weights, mlp.biases)))


def from_params(params: ViewMlpParams) -> ViewMlp:
    """Trained weights as a pack holds them, float32."""
    return ViewMlp(*jax.tree.map(lambda array: np.asarray(array, np.float32), tuple(params)))
