"""Many rays, some at a time: none that meets content is left out, and each is marched until it is whole."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.training.marching.grids import ORIGIN, VOXEL, random_rays, random_voxels
from training.marching import batches
from training.marching.batches import rays_that_meet, until_complete
from training.marching.layout import segments_across
from training.marching.march import MarchSizes, march
from training.marching.rays import GridFrameRays, to_grid
from training.marching.sparse_grid import build_layout
from training.method import Rays


class KnownRays(NamedTuple):
    """A RaySource of rays that are known; `away` moves their origins along x and y."""

    rays: Rays

    def geometry_at(self, ids: jax.Array, away: jax.Array | None = None) -> Rays:
        rays = Rays(*(array[ids] for array in self.rays))
        return rays if away is None else rays._replace(origins=rays.origins.at[:, :2].add(away))


@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_every_ray_with_a_sample_meets_content_and_many_are_spared(phase: float, monkeypatch) -> None:
    monkeypatch.setattr(batches, "LOOKED_AT", 100)  # 300 rays: three times, and ids in any order
    layout, source = build_layout(random_voxels() & (np.arange(14) < 4), ORIGIN, VOXEL), KnownRays(random_rays(300))
    ids = np.random.default_rng(0).permutation(300).astype(np.int32)[:280]
    segments = segments_across(np.asarray(layout.dims))
    meets = rays_that_meet(layout, source, ids, segments, phase=phase)
    grid_rays = to_grid(layout, source.geometry_at(jnp.asarray(ids)))
    counts = march(layout, grid_rays, jnp.full(280, phase), MarchSizes(segments, 4096, 8192, 64), 1.0).counts
    assert meets[np.asarray(counts) > 0].all()
    assert 0.2 < meets.mean() < 0.9


def test_rays_beside_their_pixels_are_looked_at_where_they_are() -> None:
    layout, source = build_layout(random_voxels(), ORIGIN, VOXEL), KnownRays(random_rays(64))
    ids = np.arange(64, dtype=np.int32)
    far_away = rays_that_meet(layout, source, ids, 8, away=np.full((64, 2), 50.0, np.float32))
    here = rays_that_meet(layout, source, ids, 8, away=np.zeros((64, 2), np.float32))
    assert not far_away.any() and np.array_equal(here, rays_that_meet(layout, source, ids, 8)) and here.any()


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


def test_a_ray_that_never_fits_is_passed_over() -> None:
    ends = [end for _, end, _ in until_complete(3, 2, lambda places: (None, jnp.asarray(places != 1)))]
    assert ends == [1, 2, 3]


def test_rays_in_a_turned_grid_meet_what_they_met_and_begin_where_they_did() -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    grid_T_training = np.eye(4)
    grid_T_training[:3, :3], grid_T_training[:3, 3] = turn, [1.0, -2.0, 0.5]
    rays = random_rays(50)._replace(near=jnp.full(50, 3.0), far=jnp.full(50, 4.0))
    moved = GridFrameRays(KnownRays(rays), jnp.asarray(grid_T_training, jnp.float32)).geometry_at(jnp.arange(50))
    points = np.asarray(rays.origins) + 1.7 * np.asarray(rays.directions)
    expected = points @ turn.T + grid_T_training[:3, 3]
    np.testing.assert_allclose(moved.origins + 1.7 * moved.directions, expected, atol=1e-5)
    assert np.array_equal(moved.near, rays.near) and np.all(np.isinf(np.asarray(moved.far)))
    assert np.array_equal(moved.viewdirs, rays.viewdirs), "the view MLP knows the training frame"


def test_a_ray_begins_at_near_and_ends_with_the_box() -> None:
    layout = build_layout(np.ones((14, 14, 14), bool), ORIGIN, VOXEL)
    middle = jnp.asarray(ORIGIN + 0.7, jnp.float32)
    along = jnp.asarray([[1.0, 0, 0]] * 3)
    ones = jnp.ones(3)
    rays = Rays(middle - 2 * along, along, along, jnp.asarray([0.0, 1.5, 3.0]), jnp.inf * ones)
    found = to_grid(layout, rays)
    np.testing.assert_allclose(found.start * VOXEL, [1.3, 1.5, 3.0], atol=1e-5)
    np.testing.assert_allclose(found.end * VOXEL, 2.7 * ones, atol=1e-5)
