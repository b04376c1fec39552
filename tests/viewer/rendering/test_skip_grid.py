"""The skip grid never hides content and its distances are the largest that are safe."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scenepack.pack import Pack
from tests.reference_marcher import fetch
from tests.scenepack.random_packs import packs
from viewer.rendering.skip_grid import CELL, chebyshev_distances, content_bounds, content_cells, skip_words


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(pack=packs(block_sizes=(3, 5, 14, 30)), seed=st.integers(0, 2**32 - 1))
def test_no_sample_in_a_cell_without_content_has_any_opacity(pack: Pack, seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0, pack.grid_size, (4000, 3))
    # Borders of macroblocks and of voxels are where a mistake would be.
    edges = rng.random(positions.shape) < 0.3
    positions = np.where(edges, np.round(2 * positions) / 2, positions).clip(0, np.array(pack.grid_size) - 1e-9)
    content = content_cells(pack)
    cells = np.floor((positions + 0.5) / CELL).astype(int)
    empty = ~content[cells[:, 2], cells[:, 1], cells[:, 0]]
    rgba, _ = fetch(pack, positions)
    assert not np.any(rgba[empty, 3] > 0)
    low, high = content_bounds(content)
    outside = np.any((positions < low) | (positions > high), axis=1)
    assert not np.any(rgba[outside, 3] > 0)


@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(pack=packs(block_sizes=(3, 5, 14, 30)))
def test_words_hold_the_distances_of_cells_and_the_content_of_their_eighths(pack: Pack) -> None:
    eighths = content_cells(pack, CELL // 2)
    words = skip_words(eighths)
    content = content_cells(pack)
    z, y, x = content.shape
    assert np.array_equal(words[:z, :y, :x] & 255, chebyshev_distances(words & 255 == 0)[:z, :y, :x])
    assert np.array_equal(words[:z, :y, :x] & 255 == 0, content)
    for k, j, i in np.argwhere(np.ones_like(eighths)):
        bit = 8 + i % 2 + 2 * (j % 2) + 4 * (k % 2)
        assert words[k // 2, j // 2, i // 2] >> bit & 1 == eighths[k, j, i]


@pytest.mark.parametrize("seed", range(6))
def test_chebyshev_distances_are_those_of_a_plain_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    content = rng.random((9, 12, 7)) < (0.01, 0.1)[seed % 2]
    content[tuple(rng.integers(0, n) for n in content.shape)] = True
    places = np.argwhere(content)
    everywhere = np.stack(np.indices(content.shape), axis=-1)
    expected = np.abs(everywhere[..., None, :] - places).max(axis=-1).min(axis=-1)
    assert np.array_equal(chebyshev_distances(content), expected)
