"""The view MLP on its way between a pack (NumPy) and the trainer (JAX)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from scenepack.pack import ViewMlp
from training.method import ViewMlpParams


def to_params(mlp: ViewMlp) -> ViewMlpParams:
    """The weights of a pack's view MLP, to be trained on."""
    return ViewMlpParams(*jax.tree.map(jnp.asarray, (mlp.weights, mlp.biases)))


def from_params(params: ViewMlpParams) -> ViewMlp:
    """Trained weights as a pack holds them, float32."""
    return ViewMlp(*jax.tree.map(lambda array: np.asarray(array, np.float32), tuple(params)))
