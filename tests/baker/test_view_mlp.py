"""The view MLP keeps its weights, bit by bit, on its way from a pack to the trainer and back."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from baker.view_mlp import from_params, to_params
from scenepack.constants import VIEW_MLP_WIDTHS
from training.view_mlp import init_view_mlp


@pytest.mark.parametrize("seed", range(3))
def test_it_survives_both_ways(seed: int) -> None:
    params = init_view_mlp(jax.random.key(seed))
    mlp = from_params(params)
    again = to_params(mlp)
    for trained, stored, back in zip(
        [*params.weights, *params.biases], [*mlp.weights, *mlp.biases], [*again.weights, *again.biases], strict=True
    ):
        assert stored.dtype == np.float32 and back.dtype == np.float32
        np.testing.assert_array_equal(stored, np.asarray(trained))
        np.testing.assert_array_equal(np.asarray(back), stored)
    assert [weight.shape[0] for weight in mlp.weights] == list(VIEW_MLP_WIDTHS[:-1])
