"""Volume rendering: opacity, transmittance and the deferred end of a ray."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from baker.tuning.shading import from_params, to_params
from tests.reference_marcher import view_residual
from training.config import PAPER, REAL_BATCH, SYNTHETIC_BATCH, TrainConfig
from training.nerf.method import learning_rate, make_optimizer, sparsity_of
from training.rendering import apply_view_mlp, cauchy_sparsity, init_view_mlp, shade, weights_of

depths = arrays(np.float32, (3, 7), elements=st.floats(0, 20, width=32))


@settings(max_examples=30, deadline=None)
@given(depths)
def test_weights_and_what_remains_of_the_light_sum_to_one(optical):
    weights = weights_of(jnp.asarray(optical), jnp.ones_like(optical))
    remaining = np.exp(-optical.sum(-1))
    np.testing.assert_allclose(weights.sum(-1) + remaining, 1, atol=1e-5)
    assert (np.asarray(weights) >= 0).all()


def test_shading_puts_the_background_behind_before_it_asks_the_view_mlp():
    view = init_view_mlp(jax.random.key(0))
    diffuse, features = jnp.asarray([[0.1, 0.2, 0.3]]), jnp.asarray([[0.1, 0.2, 0.3, 0.4]])
    alpha, v = jnp.asarray([0.75]), jnp.asarray([[0.0, 0.0, 1.0]])
    plain, seen = (shade(mlp, diffuse, features, alpha, v, background=(1.0, 0.5, 0.0)).rgb for mlp in (None, view))
    behind = diffuse + 0.25 * jnp.asarray([1.0, 0.5, 0.0])
    np.testing.assert_allclose(plain, behind, rtol=1e-6)
    np.testing.assert_allclose(seen, behind + apply_view_mlp(view, behind, features, v), rtol=1e-5)


def test_the_sparsity_term_is_log_1_plus_2_sigma_squared_summed_over_a_rays_samples():
    sigma = jnp.asarray([[0.0, 1.0, 2.0], [0.0, 0.0, 10.0]])
    first, second = math.log(3) + math.log(9), math.log(201)
    assert float(cauchy_sparsity(sigma)) == pytest.approx((first + second) / 2)
    assert float(cauchy_sparsity(sigma, c=2.0)) == pytest.approx((math.log(1.5) + math.log(3) + math.log(51)) / 2)


def test_sparsity_counts_the_coarse_samples_alone_of_both_fields():
    coarse = jnp.asarray([[1.0, 0.0]])
    fine = jnp.asarray([[2.0, 0.0, 0.0, 0.0, 0.0]])  # fine samples are masked with 0
    expected = math.log(3) + math.log(9)
    assert float(sparsity_of(coarse, fine, PAPER)) == pytest.approx(expected)
    release = dataclasses.replace(PAPER, sparsity_over_samples="release")
    # over the coarse samples, beside the mean over channels
    assert float(sparsity_of(coarse, fine, release)) == pytest.approx(3 * expected / 2)


@pytest.mark.parametrize(
    ("step", "rate"),
    [
        (0, 2e-4),
        (1250, 2e-3 * 0.01**0.005 * (0.1 + 0.9 * math.sin(math.pi / 4))),
        (2500, 2e-3 * 0.01**0.01),  # 1.91e-3: the warm-up is over
        (125_000, 2e-4),
        (250_000, 2e-5),
        (300_000, 2e-5),
    ],
)
def test_the_papers_learning_rate(step, rate):
    assert float(learning_rate(PAPER.nerf, PAPER.steps, step)) == pytest.approx(rate, rel=1e-5)


def test_gradients_are_clipped_by_value_then_by_norm():
    config = PAPER.nerf
    optimizer = make_optimizer(config, PAPER.steps)
    params = jnp.zeros(4)
    # by value: (0.01, 0.01, 0.001, 0); then scaled to norm 0.01. Adam's first moment holds a tenth of that
    _, state = optimizer.update(jnp.asarray([5.0, 0.02, 0.001, 0.0]), optimizer.init(params), params)
    clipped = np.array([0.01, 0.01, 0.001, 0.0])
    expected = 0.1 * clipped * 0.01 / np.linalg.norm(clipped)
    moments = [leaf for leaf in jax.tree.leaves(state) if leaf.shape == (4,)]
    np.testing.assert_allclose(moments[0], expected, rtol=1e-5)


def test_the_paper_preset_holds_the_papers_numbers():
    assert (PAPER.steps, PAPER.sparsity_weight, PAPER.sparsity_scale) == (250_000, 1e-4, 0.5)
    assert (SYNTHETIC_BATCH, REAL_BATCH, PAPER.batch_size) == (8192, 16_384, None)
    # what else it has: the tests above, and of nerf
    assert (PAPER.nerf.coarse_samples, PAPER.nerf.fine_samples) == (192, 384)
    assert TrainConfig().method == PAPER.method == "nerf" and PAPER.sparsity_over_samples == "paper"


def test_the_view_mlp_is_that_of_the_reference_and_keeps_its_weights_on_its_way_to_a_pack_and_back():
    """The order of the encoding and of the layers is one that packs and shaders rely on."""
    rng = np.random.default_rng(1)
    initial = init_view_mlp(jax.random.key(0))
    params = jax.tree.map(lambda p: jnp.asarray(rng.normal(size=p.shape), jnp.float32), initial)
    diffuse, features, v = rng.random((6, 3)), rng.random((6, 4)), rng.normal(size=(6, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    mlp = from_params(params)
    residual = apply_view_mlp(params, *(jnp.asarray(a) for a in (diffuse, features, v)))
    np.testing.assert_allclose(residual, view_residual(mlp, v, diffuse, features), rtol=2e-5, atol=1e-5)
    for trained, back in zip(jax.tree.leaves(params), jax.tree.leaves(to_params(mlp)), strict=True):
        np.testing.assert_array_equal(back, trained)
