"""The contraction of unbounded scenes, and the straight pieces of contracted rays."""

from dataclasses import replace

import numpy as np

from scenepack.contraction import MOST_PIECES, contract, path_of, piece_at, time_at, uncontract
from tests.scenepack.random_packs import random_pack

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(2000, 3)) * np.exp(RNG.uniform(-2, 6, (2000, 1)))


def rays(count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Origins within and outside of the inner cube, unit directions; among them some along axes and diagonals."""
    origins = RNG.normal(size=(count, 3)) * RNG.choice([0.3, 1.0, 8.0], (count, 1))
    directions = RNG.normal(size=(count, 3))
    directions[:40] = np.eye(3)[RNG.integers(3, size=40)] * RNG.choice([-1.0, 1.0], (40, 1))
    directions[40:60, 1] = 0.0
    origins[:8] = 0.0
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def along(path, s: np.ndarray) -> np.ndarray:
    """Points [N, 3] at lengths s [N]."""
    row, piece = np.arange(len(s)), piece_at(path, s)
    return path.origins[row, piece] + s[:, None] * path.directions[row, piece]


def test_the_inverse_leads_back_and_the_inner_cube_stays():
    contracted = contract(POINTS)
    assert np.abs(contracted).max() < 2
    np.testing.assert_allclose(uncontract(contracted), POINTS, rtol=1e-9, atol=1e-12)
    within = np.abs(POINTS).max(1) <= 1
    assert 100 < within.sum() < 1900 and np.array_equal(contracted[within], POINTS[within])


def test_points_of_a_path_are_those_of_its_ray_contracted_and_its_end_is_at_infinity():
    origins, directions = rays()
    begin = RNG.uniform(0, 2, len(origins))
    path = path_of(origins, directions, begin)
    for share in RNG.uniform(0, 0.98, 30):
        s = share * path.ends
        t = time_at(path, s)
        assert np.all(t >= begin - 1e-9)
        np.testing.assert_allclose(along(path, s), contract(origins + t[:, None] * directions), atol=1e-7)
    np.testing.assert_allclose(np.abs(along(path, path.ends)).max(1), 2.0, atol=1e-9)
    assert np.isfinite(path.starts).sum(1).max() <= MOST_PIECES
    assert np.all(np.diff(path.starts.clip(max=path.ends[:, None]), axis=1) >= 0)
    assert np.allclose(np.linalg.norm(path.directions[np.isfinite(path.starts)], axis=-1), 1.0)


def test_a_pack_says_its_contraction_unless_it_is_forward_facing():
    pack = random_pack(np.random.default_rng(0))
    assert pack.contraction is None and pack.with_metadata(contraction=2).contraction == 2.0
    assert replace(pack, ndc=True).with_metadata(contraction=2).contraction is None
