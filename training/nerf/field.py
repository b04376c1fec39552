"""MLP_Theta: a point in space to density, diffuse colour and features (SNeRG equation 5, sections 4.2 and 6).

Notation: p [..., 3] points of the training frame; gamma(p) [..., 63] their encoding; D layers of W
channels with ReLU. The encoding is concatenated again behind layer `skip_after`. One linear head of 8
channels follows the trunk: density (ReLU), diffuse (3, sigmoid), features (4, sigmoid).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from training.config import NerfConfig
from training.encoding import POINT_DEGREES, encode_points, encoded_width
from training.method import FieldOutput
from training.view_mlp import FEATURES


class Dense(NamedTuple):
    """x @ weight + bias; weight [in, out]."""

    weight: jax.Array
    bias: jax.Array


class FieldParams(NamedTuple):
    """trunk: D hidden layers; head: the linear layer of 1 + 3 + 4 outputs."""

    trunk: tuple[Dense, ...]
    head: Dense


def init_field(key: jax.Array, config: NerfConfig) -> FieldParams:
    """Glorot-uniform weights and zero biases (JAXNeRF)."""
    glorot = jax.nn.initializers.glorot_uniform()
    encoded = encoded_width(3, POINT_DEGREES)
    keys = jax.random.split(key, config.depth + 1)
    layers, width = [], encoded
    for layer in range(config.depth):
        layers.append(Dense(glorot(keys[layer], (width, config.width)), jnp.zeros(config.width)))
        width = config.width + (encoded if layer == config.skip_after else 0)
    outputs = 1 + 3 + FEATURES
    return FieldParams(tuple(layers), Dense(glorot(keys[-1], (width, outputs)), jnp.zeros(outputs)))


def apply_field(
    params: FieldParams, points: jax.Array, skip_after: int, density_noise: jax.Array | float = 0.0
) -> FieldOutput:
    """Asks the field at points [..., 3]; density_noise [...] is added to the raw density, before its ReLU."""
    encoded = encode_points(points)
    x = encoded
    for layer, (weight, bias) in enumerate(params.trunk):
        x = jax.nn.relu(x @ weight + bias)
        if layer == skip_after:
            x = jnp.concatenate([x, encoded], axis=-1)
    raw = x @ params.head.weight + params.head.bias
    return FieldOutput(
        density=jax.nn.relu(raw[..., 0] + density_noise),
        diffuse=jax.nn.sigmoid(raw[..., 1:4]),
        features=jax.nn.sigmoid(raw[..., 4:]),
    )
