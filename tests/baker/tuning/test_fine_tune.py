"""Fine-tuning improves the view MLP, and voxels with it, on what the pack shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baker.tuning.fine_tune import fine_tune
from baker.tuning.joint_loop import JointConfig, joint_tune
from scenepack import check_pack
from tests.scenepack.random_packs import random_pack, random_view_mlp


def test_fine_tuning_brings_a_spoilt_view_mlp_closer_to_the_photographs(scene, dataset) -> None:
    pack = random_pack(np.random.default_rng(7), block_size=14, grid_blocks=(3, 3, 3))
    size = np.array(pack.grid_size) * 0.05
    spoilt = random_view_mlp(np.random.default_rng(8))
    pack = replace(pack, voxel_size=0.05, min_xyz=-0.5 * size, view_mlp=spoilt)
    tuned, before, after = fine_tune(pack, dataset, epochs=500)
    assert after > before + 0.5
    assert tuned.view_mlp is not None and not np.array_equal(tuned.view_mlp.weights[0], spoilt.weights[0])
    assert tuned.atlas_rgba is pack.atlas_rgba, "the grid is left as it is"


@pytest.mark.slow
def test_a_diffuse_pack_has_nothing_to_tune(dataset) -> None:
    pack = random_pack(np.random.default_rng(3), block_size=14, grid_blocks=(2, 2, 2), diffuse=True)
    assert fine_tune(pack, dataset, epochs=3)[0] is pack


@pytest.mark.slow
def test_tuning_voxels_and_view_mlp_together_shows_the_photographs_better_and_keeps_all_copies_alike(dataset) -> None:
    pack = random_pack(np.random.default_rng(7), block_size=14, grid_blocks=(3, 3, 3))
    size = np.array(pack.grid_size) * 0.05
    pack = replace(pack, voxel_size=0.05, min_xyz=-0.5 * size, view_mlp=random_view_mlp(np.random.default_rng(8)))
    config = JointConfig(passes=20, samples=32_768, cell=1, rate=30.0, density_rate=0.5, held_out=0)
    before = pack.atlas_rgba.copy()
    tuned, figures = joint_tune(pack, dataset, config)
    assert figures["held_out_psnr_after"] > figures["held_out_psnr_before"] + 0.3
    assert not np.array_equal(tuned.atlas_rgba, before)
    before = tuned.atlas_rgba.copy()
    untouched = joint_tune(tuned, dataset, replace(config, passes=0, rate=0.0, density_rate=0.0, head_rate=0.0))[0]
    assert np.array_equal(untouched.atlas_rgba, before), "cells that have not moved change no byte"
    assert not [f.message for f in check_pack(tuned) if f.severity in ("warning", "error")]
