"""The march leaves nothing out, and says of which rays the lists had no room."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from tests.training.marching.grids import cells_of_grid, random_rays, random_voxels
from training.marching.march import MarchSizes, march, transmittance
from training.marching.rays import to_grid


@pytest.fixture
def present() -> np.ndarray:
    return random_voxels()


@pytest.mark.parametrize("samples", [4096, 100])
def test_the_march_lists_every_sample_with_support_and_says_which_rays_did_not_fit(
    present: np.ndarray, samples: int
) -> None:
    cells, rays = cells_of_grid(present), random_rays(256)
    grid_rays = to_grid(cells, rays)
    phase = jnp.asarray(np.random.default_rng(3).random(256), jnp.float32)
    found = march(cells, grid_rays, phase, MarchSizes(8, 2048, samples, 40), 1.0)
    start, end = np.asarray(grid_rays.start), np.asarray(grid_rays.end)
    listed = [[] for _ in range(256)]
    for ray, t in zip(np.asarray(found.ray)[found.valid], np.asarray(found.t)[found.valid], strict=True):
        listed[ray].append(float(t))
    t = (start[:, None] + np.asarray(phase)[:, None] + np.arange(40)).astype(np.float32)  # [ray, sample]
    g = grid_rays.points(jnp.arange(256)[:, None], jnp.asarray(t))
    expected = (t < end[:, None]) & np.asarray(cells.has_support(g.reshape(-1, 3))).reshape(t.shape)
    for ray in range(256):
        if found.complete[ray]:
            np.testing.assert_allclose(listed[ray], t[ray, expected[ray]], atol=1e-4)
        else:
            assert listed[ray] == [], "a ray that is not complete must not contribute"
    assert bool(found.complete.all()) == (samples == 4096)
    assert int(found.complete.sum()) > 20


def test_transmittance_is_the_running_product_of_each_ray(present: np.ndarray) -> None:
    cells, rays = cells_of_grid(present), random_rays(128, seed=5)
    found = march(cells, to_grid(cells, rays), jnp.full(128, 0.5), MarchSizes(8, 2048, 4096, 40), 1.0)
    tau = jnp.asarray(np.random.default_rng(4).exponential(1.0, 4096), jnp.float32)
    before, behind = transmittance(found, tau, 128, 40)
    rays_of, valid, taus, before, behind = map(np.asarray, (found.ray, found.valid, tau, before, behind))
    for ray in range(128):
        own = (rays_of == ray) & valid
        optical = taus[own]
        np.testing.assert_allclose(before[own], np.exp(np.cumsum(-optical) + optical), rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(behind[ray], np.exp(-optical.sum()), rtol=1e-4, atol=1e-6)
