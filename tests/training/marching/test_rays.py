"""Rays before they are marched, and many of them some at a time, each until it is whole."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.training.marching.grids import ORIGIN, VOXEL, cells_of_grid, random_rays
from training.marching.layout import GridBox
from training.marching.march import until_complete
from training.marching.rays import GridFrameRays, grid_points, to_grid
from training.method import Rays


class KnownRays(NamedTuple):
    """Stands in for the dataset that makes the rays."""

    rays: Rays

    def geometry_at(self, ids: jax.Array, away: jax.Array | None = None) -> Rays:
        return Rays(*(array[ids] for array in self.rays))


def test_each_ray_is_done_once_and_in_order_however_few_fit() -> None:
    room = iter([3, 8, 1, 5, 2, 8, 8, 8])
    asked: list[np.ndarray] = []

    def march_some(places: np.ndarray) -> tuple[np.ndarray, jax.Array]:
        asked.append(places)
        return 10 * places, jnp.arange(8) < next(room)

    done = []
    for start, end, output in until_complete(21, 8, march_some):
        assert start == len(done) and end > start
        done += output[: end - start].tolist()
    assert done == list(range(0, 210, 10))
    assert all(len(places) == 8 and places.max() <= 20 for places in asked), "one size, so one compilation"


def test_rays_in_a_turned_grid_meet_what_they_met_and_begin_where_they_did() -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    grid_T_training = np.eye(4)
    grid_T_training[:3, :3], grid_T_training[:3, 3] = turn, [1.0, -2.0, 0.5]
    rays = random_rays(50)._replace(near=jnp.full(50, 3.0), far=jnp.full(50, 4.0))
    moved = GridFrameRays(KnownRays(rays), jnp.asarray(grid_T_training, jnp.float32)).geometry_at(jnp.arange(50))  # type: ignore[arg-type]
    points = np.asarray(rays.origins) + 1.7 * np.asarray(rays.directions)
    expected = points @ turn.T + grid_T_training[:3, 3]
    np.testing.assert_allclose(moved.origins + 1.7 * moved.directions, expected, atol=1e-5)
    assert np.array_equal(moved.near, rays.near) and np.all(np.isinf(np.asarray(moved.far)))
    assert np.array_equal(moved.viewdirs, rays.viewdirs), "the view MLP knows the training frame"


def test_a_ray_begins_at_near_and_ends_with_the_box() -> None:
    layout = cells_of_grid(np.ones((14, 14, 14), bool))
    middle = jnp.asarray(ORIGIN + 0.7, jnp.float32)
    along = jnp.asarray([[1.0, 0, 0]] * 3)
    ones = jnp.ones(3)
    rays = Rays(middle - 2 * along, along, along, jnp.asarray([0.0, 1.5, 3.0]), jnp.inf * ones)
    found = to_grid(layout, rays)
    np.testing.assert_allclose(found.start * VOXEL, [1.3, 1.5, 3.0], atol=1e-5)
    np.testing.assert_allclose(found.end * VOXEL, 2.7 * ones, atol=1e-5)


def test_a_contracted_ray_is_a_path_through_the_contracted_points_of_the_ray() -> None:
    inner, side = 1.1, 64
    box = GridBox(jnp.full(3, -2 * inner), jnp.float32(4 * inner / side), jnp.full(3, side), inner)
    rays = random_rays(200)._replace(near=jnp.full(200, 0.3))
    found = to_grid(box, rays)
    assert (np.isfinite(np.asarray(found.begins)).sum(1) > 1).any() and np.all(np.asarray(found.start) == 0)
    for share in (0.0, 0.3, 0.9):
        s = share * found.end
        points = rays.origins + found.times(s)[:, None] * rays.directions
        np.testing.assert_allclose(found.points(jnp.arange(200), s), grid_points(box, points), atol=2e-3)
    np.testing.assert_allclose(found.times(0 * found.end), 0.3, atol=1e-6)
    fused = pytest.importorskip("training.multires.fused.rays", reason="pip install 'snerg[train]'")
    batch = fused.empty_batch(200, inner)
    fused.take_rays(
        *(np.asarray(a) for a in (rays.origins, rays.directions, rays.near, rays.far)), inner, np.full(3, -2 * inner),
        np.full(3, 4 * inner / side), np.full(3, side, np.int32), batch,
    )  # fmt: skip
    for name in ("start", "end", "length"):
        np.testing.assert_allclose(getattr(batch, name), getattr(found, name), rtol=1e-4, atol=1e-4)
    for share in (0.1, 0.5, 0.95):
        s = np.float32(share) * batch.end
        piece = (batch.begins <= s[:, None]).sum(1) - 1
        at = batch.origins[np.arange(200), piece] + s[:, None] * batch.directions[np.arange(200), piece]
        np.testing.assert_allclose(at, found.points(jnp.arange(200), jnp.asarray(s)), atol=2e-3)
