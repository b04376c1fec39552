"""What can be seen of a pack before it is read to the end."""

import numpy as np
import pytest

from scenepack import load_pack, save_pack
from scenepack.coarse import coarse_pack, factor_for, order_of_groups
from tests.viewer.conftest import toy_pack


@pytest.mark.parametrize(("depth", "side"), [(32, 32), (64, 32), (36, 16), (8, 7)])
def test_every_group_is_decoded_once(depth, side):
    order, steps = order_of_groups(depth, side)
    assert sorted(order) == list(range(-(-depth // 4))) and all(0 < step <= len(order) for step in steps)


def test_the_coarse_pack_lies_where_the_whole_does():
    pack = toy_pack()
    coarse = coarse_pack(pack, np.ones(len(pack.atlas_rgba), bool))
    f = factor_for(pack.block_size)
    assert coarse is not None and f is not None and coarse.voxel_size == f * pack.voxel_size
    assert coarse.grid_blocks == pack.grid_blocks and coarse.atlas_blocks == pack.atlas_blocks
    assert np.all(coarse.max_xyz >= pack.max_xyz - 1e-9)


def test_previews_come_before_the_end_and_the_pack_is_the_same(tmp_path):
    pack, seen, told = toy_pack(), [], []
    save_pack(pack, tmp_path / "toy")
    read = load_pack(tmp_path / "toy", on_progress=lambda done, _: told.append(done),
                     on_preview=lambda preview: seen.append((len(told), preview)))  # fmt: skip
    assert seen and seen[0][0] < told[-1]
    assert all(preview.atlas_rgba[..., 3].any() for _, preview in seen)
    np.testing.assert_array_equal(read.atlas_rgba, pack.atlas_rgba)
    np.testing.assert_array_equal(read.atlas_features, pack.atlas_features)
