"""Positional encoding and the view MLP: the orders and numbers that packs and shaders rely on."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from scenepack.constants import VIEW_MLP_WIDTHS
from training.encoding import encode_points, encode_viewdirs, encoded_width
from training.view_mlp import apply_view_mlp, init_view_mlp


def test_view_encoding_is_v_then_sines_frequency_major_then_the_same_shifted_by_a_quarter():
    v = np.array([0.6, -0.48, 0.64])
    expected = list(v)
    for shift in (0.0, np.pi / 2):
        for k in range(4):
            expected += [np.sin(2**k * component + shift) for component in v]
    np.testing.assert_allclose(encode_viewdirs(jnp.asarray(v)), expected, atol=1e-6)


def test_encoded_widths_are_63_for_points_and_27_for_directions():
    assert encode_points(jnp.zeros((5, 3))).shape == (5, 63) and encoded_width(3, 10) == 63
    assert encode_viewdirs(jnp.zeros((2, 5, 3))).shape == (2, 5, 27) and encoded_width(3, 4) == 27


def test_view_mlp_has_the_papers_883_parameters():
    params = init_view_mlp(jax.random.key(0))
    assert VIEW_MLP_WIDTHS == (34, 16, 16, 3)
    assert [w.shape for w in params.weights] == [(34, 16), (16, 16), (16, 3)]
    assert sum(leaf.size for leaf in jax.tree.leaves(params)) == 34 * 16 + 16 + 16 * 16 + 16 + 16 * 3 + 3 == 883


def test_view_mlp_equals_the_same_arithmetic_written_out_in_numpy():
    rng = np.random.default_rng(1)
    params = jax.tree.map(lambda p: jnp.asarray(rng.normal(size=p.shape)), init_view_mlp(jax.random.key(0)))
    diffuse, features, v = rng.random((6, 3)), rng.random((6, 4)), rng.normal(size=(6, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    x = np.concatenate([np.asarray(encode_viewdirs(jnp.asarray(v))), diffuse, features], axis=1)
    for weight, bias in zip(params.weights[:2], params.biases[:2], strict=True):
        x = np.maximum(x @ np.asarray(weight) + np.asarray(bias), 0)
    expected = 1 / (1 + np.exp(-(x @ np.asarray(params.weights[2]) + np.asarray(params.biases[2]))))
    residual = apply_view_mlp(params, *(jnp.asarray(a) for a in (diffuse, features, v)))
    np.testing.assert_allclose(residual, expected, rtol=2e-5, atol=1e-5)
