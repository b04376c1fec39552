"""Positional encoding of points and view directions (NeRF section 5.1; SNeRG section 6).

Notation: x [..., D] coordinates; k = 0 ... degrees - 1 the frequencies 2^k. The order, which the pack's view MLP and the shader
share, is frequency-major (all of x, y, z at one frequency, then the next):

    x,  sin(2^k x) for each k,  sin(2^k x + pi/2) for each k
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from scenepack.constants import VIEW_FREQUENCIES

POINT_DEGREES = 10  # sin(2^0 x) ... sin(2^9 x)


def encoded_width(coordinates: int, degrees: int) -> int:
    """Channels of `encode` for so many coordinates and degrees: 3, 10 -> 63; 3, 4 -> 27."""
    return coordinates * (1 + 2 * degrees)


def encode(x: jax.Array, degrees: int) -> jax.Array:
    """Encodes x [..., D] to [..., D (1 + 2 degrees)] in the order given above."""
    if degrees == 0:
        return x
    frequencies = 2.0 ** jnp.arange(degrees, dtype=x.dtype)
    scaled = (x[..., None, :] * frequencies[:, None]).reshape(*x.shape[:-1], degrees * x.shape[-1])
    return jnp.concatenate([x, jnp.sin(scaled), jnp.sin(scaled + 0.5 * jnp.pi)], axis=-1)


def encode_points(points: jax.Array) -> jax.Array:
    """gamma(p), [..., 3] -> [..., 63]."""
    return encode(points, POINT_DEGREES)


def encode_viewdirs(viewdirs: jax.Array) -> jax.Array:
    """gamma(v) of unit directions in the training frame, [..., 3] -> [..., 27]."""
    return encode(viewdirs, VIEW_FREQUENCIES)
