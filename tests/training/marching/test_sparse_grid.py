"""The sparse grid interpolates like a dense one, and its occupancy never hides content."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from tests.training.marching.grids import ORIGIN, SHAPE, VOXEL, random_voxels
from training.marching.sparse_grid import build_layout, interpolate


@pytest.fixture
def present() -> np.ndarray:
    return random_voxels()


def test_a_sparse_grid_interpolates_as_a_dense_one_with_row_zero_where_nothing_is(present: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    layout = build_layout(present, ORIGIN, VOXEL)
    rows = rng.normal(size=(present.sum() + 1, 8)).astype(np.float32)
    rows[0] = 0
    dense = np.zeros((*SHAPE, 8), np.float32)
    dense[present] = rows[1:]
    g = rng.random((500, 3)) * np.array(SHAPE[::-1])
    expected = np.stack(
        [map_coordinates(np.pad(dense[..., c], 1), g[:, ::-1].T + 0.5, order=1) for c in range(8)], axis=-1
    )
    got = interpolate(jnp.asarray(rows), layout, jnp.asarray(g, jnp.float32))
    np.testing.assert_allclose(got, expected, atol=2e-5)


def test_support_is_told_exactly_and_coarse_occupancy_never_hides_content(present: np.ndarray) -> None:
    layout = build_layout(present, ORIGIN, VOXEL)
    rng = np.random.default_rng(2)
    g = jnp.asarray(rng.random((4000, 3)) * np.array(SHAPE[::-1]), jnp.float32)
    ids, _ = layout.corners(g)
    supported = np.asarray(ids > 0).any(-1)
    assert np.array_equal(np.asarray(layout.has_support(g)), supported)
    nearby = g + jnp.asarray(rng.uniform(-1.999, 1.999, g.shape) / np.sqrt(3), jnp.float32)
    nearby = jnp.clip(nearby, 0, layout.dims)
    assert np.asarray(layout.near_content(nearby))[supported].all()


def test_points_know_the_voxel_they_lie_in(present: np.ndarray) -> None:
    layout = build_layout(present, ORIGIN, VOXEL)
    g = np.random.default_rng(5).random((500, 3)) * np.array(SHAPE[::-1])
    expected = np.zeros(SHAPE, int)
    expected[present] = np.arange(1, present.sum() + 1)
    x, y, z = g.astype(int).T
    assert np.array_equal(layout.nearest(jnp.asarray(g, jnp.float32)), expected[z, y, x])
