"""Volume rendering: opacity, transmittance and the deferred end of a ray."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from training.view_mlp import apply_view_mlp, init_view_mlp
from training.volume import alpha_of, composite, shade, weights_of

depths = arrays(np.float32, (3, 7), elements=st.floats(0, 20, width=32))


@settings(max_examples=30, deadline=None)
@given(depths)
def test_weights_and_what_remains_of_the_light_sum_to_one(optical):
    weights = weights_of(jnp.asarray(optical), jnp.ones_like(optical))
    remaining = np.exp(-optical.sum(-1))
    np.testing.assert_allclose(weights.sum(-1) + remaining, 1, atol=1e-5)
    assert (np.asarray(weights) >= 0).all()


def test_alpha_is_exact_for_small_arguments_too():
    sigma = jnp.asarray([1e-6, 0.1, 3.0, 40.0])
    np.testing.assert_allclose(alpha_of(sigma, 0.1), -np.expm1(-np.asarray(sigma, np.float64) * 0.1), rtol=1e-6)


def test_composite_weighs_each_samples_values():
    values = jnp.asarray([[[1.0, 0.0], [0.0, 2.0]]])
    np.testing.assert_allclose(composite(jnp.asarray([[0.25, 0.5]]), values), [[0.25, 1.0]], rtol=1e-6)


def test_shading_puts_the_background_behind_before_it_asks_the_view_mlp():
    view = init_view_mlp(jax.random.key(0))
    diffuse, features = jnp.asarray([[0.1, 0.2, 0.3]]), jnp.asarray([[0.1, 0.2, 0.3, 0.4]])
    alpha, v = jnp.asarray([0.75]), jnp.asarray([[0.0, 0.0, 1.0]])
    out = shade(view, diffuse, features, alpha, alpha, v, background=(1.0, 0.5, 0.0))
    behind = diffuse + 0.25 * jnp.asarray([1.0, 0.5, 0.0])
    np.testing.assert_allclose(out.diffuse, behind, rtol=1e-6)
    np.testing.assert_allclose(out.rgb, behind + apply_view_mlp(view, behind, features, v), rtol=1e-5)
