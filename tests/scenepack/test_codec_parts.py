"""What codecs are made of: padding, straight colours, the continuation of voxels into empty space, occupancy."""

from __future__ import annotations

import numpy as np
import pytest

from scenepack.codecs.streams import filled, pack_occupancy, premultiplied, unpack_occupancy, unpremultiply
from scenepack.padding import restore_padding
from tests.scenepack.random_packs import random_pack


def test_padding_is_restored_whatever_lies_there() -> None:
    for seed in range(3):
        source = random_pack(np.random.default_rng(seed), block_size=4, grid_blocks=(4, 3, 3), style="noise")
        spoilt_atlas = source.atlas_rgba.copy()
        for block in np.argwhere(source.occupied):
            x, y, z = (int(i) * 6 for i in source.atlas_indices[tuple(block)])
            copy = spoilt_atlas[z : z + 6, y : y + 6, x : x + 6]
            data = copy[1:-1, 1:-1, 1:-1].copy()
            copy[...] = 77
            copy[1:-1, 1:-1, 1:-1] = data
        restore_padding(spoilt_atlas, source.atlas_indices, source.block_size)
        assert np.array_equal(spoilt_atlas, source.atlas_rgba)


def test_straight_colours_come_back_and_nothing_outshines_its_alpha() -> None:
    rng = np.random.default_rng(0)
    alpha = (rng.integers(0, 256, (9, 20, 33)) * (rng.random((9, 20, 33)) < 0.3)).astype(np.uint8)
    values = np.rint(rng.random((9, 20, 33, 3)) * alpha[..., None]).astype(np.uint8)
    shown = unpremultiply(values, alpha, 0.0)
    assert shown.shape == (9, 32, 48, 3)
    back = premultiplied(shown, alpha)
    assert np.abs(back.astype(int) - values).max() <= 1
    smooth = premultiplied(unpremultiply(values, alpha, 8.0), alpha)
    assert np.all(smooth <= alpha[..., None]) and not smooth[alpha == 0].any()
    assert abs(smooth.sum() / values.sum() - 1) < 0.02, "smoothing moves colour about and loses none"


def test_empty_voxels_continue_what_is_near_them() -> None:
    alpha = np.zeros((16, 16, 32), np.uint8)
    alpha[3:6, 4:9, 2:5] = 90
    values = np.where(alpha > 0, 45, 0).astype(np.uint8)[..., None]
    shown = unpremultiply(values, alpha, 8.0)
    assert np.all(shown[:, :, :16] == 128) and np.all(shown[:, :, 16:] == 128)  # 45 / 90, and grey where nothing is
    assert np.all(filled(alpha[..., None], alpha)[:, :, :16] == 90)


def test_occupancy_comes_back_exactly_and_is_refused_at_another_size() -> None:
    occupied = np.random.default_rng(0).random((5, 6, 7)) < 0.3
    data = pack_occupancy(occupied)
    assert np.array_equal(unpack_occupancy(data, (5, 6, 7)), occupied)
    for shape in ((5, 6, 9), (1, 2, 2)):
        with pytest.raises(Exception, match="expected"):
            unpack_occupancy(data, shape)
