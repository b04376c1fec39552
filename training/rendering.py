"""Deferred volume rendering, and the terms of the loss.

Source: quadrature, SNeRG equations 1 and 2 (after Max 1995); deferred shading with the view MLP, section 4.2; the encoding, NeRF
section 5.1 and SNeRG section 6; the loss, sections 4.1 and 4.3. The paper sums it over rays; we divide by the rays of a batch,
which does not change the balance.

Notation, per ray, samples k along the last axis but channels:
    t      [..., K]      positions along the ray, point(t) = origin + t direction
    delta  [..., K]      length of the interval that sample k stands for, in world units
    sigma  [..., K]      density per unit of world length, >= 0
    alpha  [..., K]      1 - exp(-sigma delta)
    T      [..., K]      transmittance before sample k, exp(-sum over k' < k of sigma delta)
    weight [..., K]      T alpha, the share of sample k in the pixel

The view MLP is one tiny network per ray, not per sample. Input, 34 channels: encoded view direction (27), accumulated diffuse
colour with the background (3), accumulated features (4). Two hidden layers of 16 with ReLU; the output goes through a sigmoid and
is the residual that is added to the diffuse colour (equation 7). Weights are input-major: x @ W + b.
"""

from collections.abc import Sequence
from itertools import pairwise

import jax
import jax.numpy as jnp

from scenepack.constants import VIEW_FREQUENCIES, VIEW_MLP_WIDTHS
from training.method import RenderOutput, ViewMlpParams

LAST_INTERVAL = 1e10  # NeRF lets the last sample stand for the rest of the ray


def intervals(t: jax.Array, directions: jax.Array, last: jax.Array | float = LAST_INTERVAL) -> jax.Array:
    """delta [..., K] of sorted t [..., K] along directions [..., 3], not always unit (NDC). last [..., 1] is in units of t."""
    gaps = jnp.concatenate([jnp.diff(t, axis=-1), jnp.broadcast_to(last, t[..., :1].shape)], axis=-1)
    return gaps * jnp.linalg.norm(directions, axis=-1, keepdims=True)


def alpha_of(sigma: jax.Array, delta: jax.Array | float) -> jax.Array:
    """Opacity of an interval, 1 - exp(-sigma delta), in [0, 1]; exact for small arguments."""
    return -jnp.expm1(-sigma * delta)


def transmittance(sigma_delta: jax.Array) -> jax.Array:
    """T [..., K] before each sample, from optical depths sigma delta [..., K]. T of the first sample is 1."""
    before = jnp.cumsum(sigma_delta[..., :-1], axis=-1)
    return jnp.exp(-jnp.concatenate([jnp.zeros_like(sigma_delta[..., :1]), before], axis=-1))


def weights_of(sigma: jax.Array, delta: jax.Array) -> jax.Array:
    """weight [..., K] = T alpha; they sum to the ray's opacity, at most 1."""
    return transmittance(sigma * delta) * alpha_of(sigma, delta)


def composite(weights: jax.Array, values: jax.Array) -> jax.Array:
    """Sum over samples of weight [..., K] times values [..., K, C] -> [..., C]."""
    return jnp.einsum("...k,...kc->...c", weights, values)


def over_background(rgb: jax.Array, alpha: jax.Array, background: Sequence[float]) -> jax.Array:
    """Premultiplied rgb [..., 3] of opacity alpha [...] before a background colour."""
    return rgb + (1.0 - alpha[..., None]) * jnp.asarray(background, dtype=rgb.dtype)


# --- Deferred shading ---


def encode(x: jax.Array, degrees: int) -> jax.Array:
    """Encodes x [..., D] to [..., D (1 + 2 degrees)]: x, then sin(2^k x) for each k, then sin(2^k x + pi/2) for each k. All of x,
    y, z stand at one frequency, then at the next: the order that the pack's view MLP and the shader share."""
    frequencies = 2.0 ** jnp.arange(degrees, dtype=x.dtype)
    scaled = (x[..., None, :] * frequencies[:, None]).reshape(*x.shape[:-1], degrees * x.shape[-1])
    return jnp.concatenate([x, jnp.sin(scaled), jnp.sin(scaled + 0.5 * jnp.pi)], axis=-1)


def init_view_mlp(key: jax.Array) -> ViewMlpParams:
    """Glorot-uniform weights [34, 16], [16, 16], [16, 3] and zero biases, as in JAXNeRF."""
    glorot = jax.nn.initializers.glorot_uniform()
    keys = jax.random.split(key, 3)
    first, second, last = (glorot(k, shape) for k, shape in zip(keys, pairwise(VIEW_MLP_WIDTHS), strict=True))
    b0, b1, b2 = (jnp.zeros(width) for width in VIEW_MLP_WIDTHS[1:])
    return ViewMlpParams((first, second, last), (b0, b1, b2))


def apply_view_mlp(
    params: ViewMlpParams, diffuse_with_background: jax.Array, features: jax.Array, viewdirs: jax.Array
) -> jax.Array:
    """The residual [..., 3] in [0, 1] for diffuse [..., 3], features [..., 4] and unit viewdirs [..., 3].

    The caller adds it to the diffuse colour: unclamped in training (as in the release), clamped to [0, 1] for a picture.
    """
    x = jnp.concatenate([encode(viewdirs, VIEW_FREQUENCIES), diffuse_with_background, features], axis=-1)
    for weight, bias in zip(params.weights[:-1], params.biases[:-1], strict=True):
        x = jax.nn.relu(x @ weight + bias)
    return jax.nn.sigmoid(x @ params.weights[-1] + params.biases[-1])


def shade(
    view: ViewMlpParams | None, diffuse: jax.Array, features: jax.Array, alpha: jax.Array, viewdirs: jax.Array,
    background: Sequence[float],
) -> RenderOutput:  # fmt: skip
    """The deferred end of a ray: background, view MLP, sum (equation 7).

    diffuse [..., 3] and features [..., 4] are accumulated and premultiplied, alpha [...], viewdirs [..., 3]. The
    residual is added at every pixel and nothing is clamped, as in the release's training. No view MLP: diffuse.
    """
    diffuse = over_background(diffuse, alpha, background)
    rgb = diffuse if view is None else diffuse + apply_view_mlp(view, diffuse, features, viewdirs)
    return RenderOutput(rgb, alpha)


# --- Terms of the loss ---

CHANNELS = 3


def squared_error(rgb: jax.Array, target: jax.Array) -> jax.Array:
    """L_r per ray: mean over rays of |C - C_hat|^2, for rgb and target [N, 3]. CHANNELS times the MSE per channel."""
    return jnp.mean(jnp.sum(jnp.square(rgb - target), axis=-1))


def cauchy_sparsity(sigma: jax.Array, c: float = 0.5) -> jax.Array:
    """L_s / lambda_s per ray: mean over rays of the sum over samples of log(1 + sigma^2 / c); sigma [N, K]."""
    return jnp.mean(jnp.sum(jnp.log1p(jnp.square(sigma) / c), axis=-1))


def mean_squared_error(rgb: jax.Array, target: jax.Array) -> jax.Array:
    """Mean over rays and channels, of colours clamped to [0, 1] as a picture would show them: what PSNR is made of."""
    return jnp.mean(jnp.square(jnp.clip(rgb, 0.0, 1.0) - target))


def psnr_of(mse: jax.Array) -> jax.Array:
    """Peak signal-to-noise ratio in dB of an MSE of colours in [0, 1]."""
    return -10.0 * jnp.log10(jnp.maximum(mse, 1e-12))
