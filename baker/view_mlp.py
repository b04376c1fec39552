"""The view MLP on its way between a pack (NumPy) and the trainer (JAX)."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from scenepack.pack import ViewMlp
from training.method import ViewMlpParams


def to_params(mlp: ViewMlp) -> ViewMlpParams:
    """The weights of a pack's view MLP, to be trained on."""
    w0, w1, w2 = (jnp.asarray(weight) for weight in mlp.weights)
    b0, b1, b2 = (jnp.asarray(bias) for bias in mlp.biases)
    return ViewMlpParams((w0, w1, w2), (b0, b1, b2))


def from_params(params: ViewMlpParams) -> ViewMlp:
    """Trained weights as a pack holds them, float32."""
    w0, w1, w2 = (np.asarray(weight, np.float32) for weight in params.weights)
    b0, b1, b2 = (np.asarray(bias, np.float32) for bias in params.biases)
    return ViewMlp((w0, w1, w2), (b0, b1, b2))
