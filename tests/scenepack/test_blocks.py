"""Cutting a volume into padded macroblocks loses nothing, and padding is what the neighbours hold."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from scenepack.blocks import (
    MAX_SLICE_SIDE,
    atlas_from_volume,
    atlas_shape,
    choose_atlas_blocks,
    dense_from_pack,
    grid_block_counts,
)
from scenepack.pack import Pack
from tests.scenepack.random_packs import packs
from tests.scenepack.volumes import atlas_from_dense


@settings(max_examples=25, deadline=None)
@given(pack=packs(block_sizes=(1, 2, 6, 14)))
def test_putting_a_pack_together_and_cutting_it_again_gives_the_same_atlas(pack: Pack) -> None:
    rgba, features = dense_from_pack(pack)
    again = atlas_from_dense(rgba, features, pack.block_size, pack.occupied, atlas_blocks=pack.atlas_blocks)
    np.testing.assert_array_equal(again[0], pack.atlas_indices)
    np.testing.assert_array_equal(again[1], pack.atlas_rgba)
    assert (again[2] is None) == (pack.atlas_features is None)
    if again[2] is not None:
        np.testing.assert_array_equal(again[2], pack.atlas_features)


def test_a_volume_is_read_one_macroblock_at_a_time_and_never_outside_of_the_grid() -> None:
    size, boxes = (10, 7, 6), []

    def read_box(low: tuple[int, int, int], high: tuple[int, int, int]) -> np.ndarray:
        boxes.append((low, high))
        z, y, x = np.ogrid[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        return np.repeat((z * 100 + y * 10 + x)[..., None] % 256, 4, axis=-1).astype(np.uint8)

    occupied = np.ones(grid_block_counts(size, 4)[::-1], bool)
    indices, rgba, features = atlas_from_volume(read_box, size, 4, occupied, channels=4)
    assert features is None and len(boxes) == occupied.size
    for low, high in boxes:
        assert all(0 <= a < b <= n and b - a <= 6 for a, b, n in zip(low, high, size[::-1], strict=True))
    whole = read_box((0, 0, 0), (6, 7, 10))
    np.testing.assert_array_equal(atlas_from_dense(whole, None, 4, occupied)[1], rgba)
    assert indices.max() < 255


@given(count=st.integers(0, 200_000), block_size=st.sampled_from([1, 6, 14, 30, 62]))
def test_the_chosen_layout_holds_all_and_stays_within_bounds(count: int, block_size: int) -> None:
    x, y, z = choose_atlas_blocks(count, block_size)
    assert x * y * z >= count and max(x, y, z) <= 255
    depth, height, width = atlas_shape((x, y, z), block_size)
    assert max(height, width) <= MAX_SLICE_SIDE and depth % 4 == 0
    assert count < 2 or x * y * z <= 1.5 * count + 2
