"""The sparse grid knows where it has support, and its occupancy never hides content."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from tests.training.marching.grids import ORIGIN, SHAPE, VOXEL, random_voxels
from training.marching.sparse_grid import build_layout


@pytest.fixture
def present() -> np.ndarray:
    return random_voxels()


def test_support_is_told_exactly_and_coarse_occupancy_never_hides_content(present: np.ndarray) -> None:
    layout = build_layout(present, ORIGIN, VOXEL)
    rng = np.random.default_rng(2)
    g = jnp.asarray(rng.random((4000, 3)) * np.array(SHAPE[::-1]), jnp.float32)
    x, y, z = np.floor(np.asarray(g).T - 0.5).astype(int) + 1  # of the voxel below, padded by one
    eight = [np.pad(present, 1)[z + dz, y + dy, x + dx] for dz, dy, dx in np.ndindex(2, 2, 2)]
    supported = np.any(eight, axis=0)
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
