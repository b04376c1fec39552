"""Views midway between photographs."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baker.baking.passes import with_views_between
from training.dataset import RayDataset


def test_photographs_come_first_and_each_has_a_view_between(dataset: RayDataset) -> None:
    views = with_views_between(dataset)
    assert dataset.views < views.views <= 2 * dataset.views and views.count == views.views * 48 * 48
    ids = jnp.arange(0, dataset.count, 97)
    for ours, theirs in zip(views.geometry_at(ids), dataset.geometry_at(ids), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    poses = np.asarray(views.world_T_camera, np.float64)
    turns, given = poses[dataset.views :, :, :3], poses[: dataset.views]
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-6)
    for pose in poses[dataset.views :]:
        middle = 0.5 * (given[:, None, :, 3] + given[None, :, :, 3])
        i, j = np.unravel_index(np.linalg.norm(middle - pose[:, 3], axis=-1).argmin(), (len(given), len(given)))
        np.testing.assert_allclose(pose[:, 3], middle[i, j], atol=1e-6)
        both = [Rotation.from_matrix(given[k, :, :3]) for k in (i, j)]
        here = Rotation.from_matrix(pose[:, :3])
        apart = [(here.inv() * other).magnitude() for other in both]
        assert apart[0] == pytest.approx(apart[1], abs=1e-4), "turned as much from the one as from the other"
        assert sum(apart) == pytest.approx((both[0].inv() * both[1]).magnitude(), abs=1e-4)


def test_a_view_between_shows_more_on_every_side_than_a_photograph(dataset: RayDataset) -> None:
    views, pixels = with_views_between(dataset), 48 * 48

    def widest(view: int) -> float:
        """The largest angle between rays of a view, as a cosine."""
        at = np.asarray(views.geometry_at(view * pixels + jnp.array([0, 47, pixels - 48, pixels - 1])).directions)
        return float((at @ at.T).min())

    assert widest(views.views - 1) < widest(0) - 0.1
