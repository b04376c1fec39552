"""Positional encoding of points and directions (NeRF section 5.1; SNeRG section 6), and the view MLP of the deferred head (SNeRG
section 4.2): one tiny network per ray, not per sample.

Input, 34 channels: encoded view direction (27), accumulated diffuse colour with the background (3),
accumulated features (4). Two hidden layers of 16 with ReLU; the output goes through a sigmoid and is the residual that is
added to the diffuse colour (equation 7). Weights are input-major: x @ W + b.
"""

from itertools import pairwise

import jax
import jax.numpy as jnp

from scenepack.constants import VIEW_FREQUENCIES, VIEW_MLP_WIDTHS
from training.method import ViewMlpParams


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
