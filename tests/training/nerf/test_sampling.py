"""Where along a ray the fields are asked."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from training.config import NerfConfig
from training.dataset import SceneFacts
from training.method import Rays
from training.nerf.render import coarse_samples, fine_samples, last_interval

NEAR, FAR = jnp.full(5, 2.0), jnp.full(5, 6.0)


@pytest.mark.parametrize(
    ("ndc", "given", "expected"), [(True, None, [0.25, 0.0]), (False, None, 1e10), (True, 0.5, 0.5)]
)
def test_the_last_sample_stands_for_the_rest_up_to_the_far_plane_in_ndc_and_for_all_beyond_it_elsewhere(
    ndc: bool, given: float | None, expected: float | list[float]
):
    facts = SceneFacts(
        0.0, 1.0, ((-1.0,) * 3, (1.0,) * 3), (40, 32, 50.0) if ndc else None, False, (1.0, 1.0, 1.0), False, None
    )
    rays = Rays(*(jnp.ones((2, 3)),) * 3, near=jnp.zeros(2), far=jnp.ones(2))
    t = jnp.asarray([[0.1, 0.75], [0.2, 1.0]])
    last = last_interval(t, rays, NerfConfig(last_interval=given), facts)
    np.testing.assert_allclose(np.asarray(last).ravel(), np.ravel(expected), atol=1e-6)


def test_fine_samples_crowd_where_the_coarse_weights_are():
    t = coarse_samples(None, NEAR, FAR, 41)
    weights = jnp.exp(-0.5 * ((t - 4.5) / 0.05) ** 2)
    fine = np.asarray(fine_samples(jax.random.uniform(jax.random.key(1), (5, 64)), t, weights, 64))
    assert (np.diff(fine) >= 0).all()
    assert (np.abs(fine - 4.5) < 0.3).mean() > 0.95
