"""Rays through the occupancy grid: where they begin and bend, that no sample is left out, and each is done once."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from scenepack.contraction import contract
from training.marching import Cells, GridBox, GridFrameRays, MarchSizes, grid_points, march, to_grid
from training.method import Rays
from training.multires.jax_engine import cells_of
from training.multires.state import Box

SHAPE = (9, 11, 14)  # z, y, x
ORIGIN, VOXEL = np.array([-0.3, 0.2, 1.0]), 0.1


def cells_of_grid(present: np.ndarray) -> Cells:
    """The occupancy grid, of 16³ cells, whose first ones are `present` bool [z, y, x]."""
    codes = np.zeros((16, 16, 16), np.uint8)
    codes[tuple(slice(n) for n in present.shape)] = present
    box = Box(ORIGIN, np.full(3, VOXEL), np.array(present.shape[::-1], np.int32))
    return cells_of(SimpleNamespace(box=box, codes=codes, step_cells=1.0))  # type: ignore[arg-type]


def random_rays(count: int) -> Rays:
    """Rays through the grid, some axis-parallel, some that miss it."""
    rng = np.random.default_rng(0)
    target = ORIGIN + rng.random((count, 3)) * np.array(SHAPE[::-1]) * VOXEL * 1.3
    origins = target + rng.normal(size=(count, 3))
    directions = target - origins
    directions[: count // 8] = np.eye(3)[rng.integers(0, 3, count // 8)]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    origins, directions = (jnp.asarray(a, jnp.float32) for a in (origins, directions))
    return Rays(origins, directions, directions, jnp.zeros(count), jnp.full(count, 10.0))


@pytest.mark.parametrize("samples", [4096, 100])
def test_the_march_lists_every_sample_with_support_and_says_which_rays_did_not_fit(samples: int) -> None:
    cells, rays = cells_of_grid(np.random.default_rng(0).random(SHAPE) < 0.15), random_rays(256)
    grid_rays = to_grid(cells.box, rays)
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


def test_rays_in_a_turned_grid_meet_what_they_met_and_begin_where_they_did() -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    grid_T_training = np.eye(4)
    grid_T_training[:3, :3], grid_T_training[:3, 3] = turn, [1.0, -2.0, 0.5]
    rays = random_rays(50)._replace(near=jnp.full(50, 3.0), far=jnp.full(50, 4.0))
    source: Any = SimpleNamespace(geometry_at=lambda ids, away: rays)
    moved = GridFrameRays(source, jnp.asarray(grid_T_training, jnp.float32)).geometry_at(jnp.arange(50))
    points = np.asarray(rays.origins) + 1.7 * np.asarray(rays.directions)
    expected = points @ turn.T + grid_T_training[:3, 3]
    np.testing.assert_allclose(moved.origins + 1.7 * moved.directions, expected, atol=1e-5)
    assert np.array_equal(moved.near, rays.near) and np.all(np.isinf(np.asarray(moved.far)))
    assert np.array_equal(moved.viewdirs, rays.viewdirs), "the view MLP knows the training frame"


def test_a_contracted_ray_is_a_path_through_the_contracted_points_of_the_ray() -> None:
    inner, side = 1.1, 64
    box = GridBox(jnp.full(3, -2 * inner), jnp.float32(4 * inner / side), jnp.full(3, side), inner)
    rays = random_rays(200)._replace(near=jnp.full(200, 0.3))
    found = to_grid(box, rays)
    assert (np.isfinite(np.asarray(found.begins)).sum(1) > 1).any() and np.all(np.asarray(found.start) == 0)
    for share in (0.0, 0.3, 0.9):
        s = share * found.end
        points = rays.origins + found.times(s)[:, None] * rays.directions
        there = (inner * contract(np.asarray(points) / inner) + 2 * inner) / (4 * inner / side)
        np.testing.assert_allclose(found.points(jnp.arange(200), s), there, atol=2e-3)
        np.testing.assert_allclose(grid_points(box, points), there, atol=2e-3)
    np.testing.assert_allclose(found.times(0 * found.end), 0.3, atol=1e-6)
