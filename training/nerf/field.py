"""MLP_Theta: a point in space to density, diffuse colour and features (SNeRG equation 4, sections 4.2 and 6); and the heads
of the paper's baselines.

Notation: p [..., 3] points of the training frame; gamma(p) [..., 63] their encoding; D layers of W channels with ReLU. The
encoding is concatenated again behind layer `skip_after`. One linear head follows the trunk, of as many of these as
NerfConfig.view asks for: density (1, ReLU), diffuse (3, sigmoid), features (4, sigmoid).

The hidden layers' products may be of bfloat16 numbers; sums are float32, and so are the encoding's own weights (2^9 p needs
more than 8 bits) and the head.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from scenepack.constants import FEATURES, VIEW_FREQUENCIES
from training.config import NerfConfig
from training.method import FieldOutput
from training.view_mlp import POINT_DEGREES, encode_points, encode_viewdirs

CONDITION_WIDTH = 128  # channels of JAXNeRF's layer behind the viewing direction
HEAD_OUTPUTS = {"deferred": 1 + 3 + FEATURES, "tiny": 1 + 3 + FEATURES, "none": 1 + 3, "nerf": 1}


class Dense(NamedTuple):
    """x @ weight + bias; weight [in, out]."""

    weight: jax.Array
    bias: jax.Array


class FieldParams(NamedTuple):
    trunk: tuple[Dense, ...]  # D hidden layers
    head: Dense  # the linear layer of HEAD_OUTPUTS


class NerfHead(NamedTuple):
    """JAXNeRF's colour."""

    bottleneck: Dense  # linear, W channels; the encoded viewing direction beside it
    hidden: Dense  # CONDITION_WIDTH with ReLU
    rgb: Dense  # 3 with sigmoid


def init_field(key: jax.Array, config: NerfConfig) -> FieldParams:
    """Glorot-uniform weights and zero biases (JAXNeRF)."""
    encoded = 3 * (1 + 2 * POINT_DEGREES)
    keys = jax.random.split(key, config.depth + 1)
    layers, width = [], encoded
    for layer in range(config.depth):
        layers.append(init_dense(keys[layer], width, config.width))
        width = config.width + (encoded if layer == config.skip_after else 0)
    return FieldParams(tuple(layers), init_dense(keys[-1], width, HEAD_OUTPUTS[config.view]))


def init_nerf_head(key: jax.Array, width: int) -> NerfHead:
    """A head for a trunk of `width` channels."""
    inputs = (width, width + 3 * (1 + 2 * VIEW_FREQUENCIES), CONDITION_WIDTH)
    sizes = zip(jax.random.split(key, 3), inputs, (width, CONDITION_WIDTH, 3), strict=True)
    return NerfHead(*(init_dense(*size) for size in sizes))


def init_dense(key: jax.Array, inputs: int, outputs: int) -> Dense:
    return Dense(jax.nn.initializers.glorot_uniform()(key, (inputs, outputs)), jnp.zeros(outputs))


def apply_trunk(params: FieldParams, points: jax.Array, config: NerfConfig) -> jax.Array:
    """The last hidden layer [..., W] (and the encoding behind it, where the skip comes last) at points [..., 3]."""
    encoded = encode_points(points)
    x = jax.nn.relu(encoded @ params.trunk[0].weight + params.trunk[0].bias)
    joined = config.skip_after == 0  # whether the encoding stands beside x
    for layer, (weight, bias) in enumerate(params.trunk[1:], start=1):
        product = _product(x, weight[: x.shape[-1]], config)
        if joined:
            product += encoded @ weight[x.shape[-1] :]
        x = jax.nn.relu(product + bias)
        joined = layer == config.skip_after
    return jnp.concatenate([x, encoded], axis=-1) if joined else x


def field_of(params: FieldParams, trunk: jax.Array, density_noise: jax.Array | float = 0.0) -> FieldOutput:
    """The field from its last hidden layer, 0 where the head lacks an output; density_noise [...] is added before the ReLU."""
    raw = trunk @ params.head.weight + params.head.bias
    outputs = raw.shape[-1]
    none = jnp.zeros((*raw.shape[:-1], FEATURES), raw.dtype)
    return FieldOutput(
        density=jax.nn.relu(raw[..., 0] + density_noise),
        diffuse=jax.nn.sigmoid(raw[..., 1:4]) if outputs >= 4 else none[..., :3],
        features=jax.nn.sigmoid(raw[..., 4:]) if outputs > 4 else none,
    )


def apply_nerf_head(head: NerfHead, trunk: jax.Array, viewdirs: jax.Array, config: NerfConfig) -> jax.Array:
    """Colours [N, S, 3] of samples with hidden layer trunk [N, S, W] seen along viewdirs [N, 3]."""
    bottleneck = _product(trunk, head.bottleneck.weight, config) + head.bottleneck.bias
    width = bottleneck.shape[-1]
    seen = encode_viewdirs(viewdirs) @ head.hidden.weight[width:]  # once a ray
    x = jax.nn.relu(_product(bottleneck, head.hidden.weight[:width], config) + seen[:, None] + head.hidden.bias)
    return jax.nn.sigmoid(x @ head.rgb.weight + head.rgb.bias)


def _product(x: jax.Array, weight: jax.Array, config: NerfConfig) -> jax.Array:
    """x @ weight in NerfConfig.matmul ("auto" is settled by then), summed in float32."""
    if config.matmul != "bfloat16":
        return x @ weight
    return jnp.matmul(x.astype(jnp.bfloat16), weight.astype(jnp.bfloat16), preferred_element_type=jnp.float32)
