"""Voxels and view MLP tuned together: which rays, and for how long."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from baker.tuning.joint_tuning import JointConfig, joint_tune
from baker.tuning.marcher import PackMarcher
from scenepack import check_pack
from scenepack.codecs.quantisation import Steps
from tests.baker.tuning.reference import copied, pack_of
from training.dataset import RayDataset

pytestmark = pytest.mark.usefixtures("hardly_optimised")

SAMPLES = 32_768


QUICK = JointConfig(passes=2, samples=SAMPLES, rate=20.0, density_rate=0.3, head_rate=1e-2)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_pack_so_that_a_bake_that_goes_on_ends_alike(dataset: RayDataset) -> None:
    pack = pack_of()
    (one, figures), (two, again) = (joint_tune(copied(pack), dataset, QUICK) for _ in range(2))
    assert figures == again and figures["train_psnr_after"] > figures["train_psnr_before"]
    assert np.array_equal(one.atlas_rgba, two.atlas_rgba) and not np.array_equal(one.atlas_rgba, pack.atlas_rgba)
    for a, b in zip(one.view_mlp.weights, two.view_mlp.weights, strict=True):  # type: ignore[union-attr]
        assert np.array_equal(a, b)
    assert [f for f in check_pack(one) if f.severity in ("warning", "error")] == []
    still = replace(QUICK, passes=0, rate=0.0, density_rate=0.0, head_rate=0.0)
    untouched = joint_tune(copied(one), dataset, still)[0]
    assert np.array_equal(untouched.atlas_rgba, one.atlas_rgba), "cells that have not moved change no byte"


@pytest.mark.slow
def test_tuning_harms_no_pack_that_shows_its_photographs_already(dataset: RayDataset) -> None:
    pack = pack_of(diffuse=True)
    sums = PackMarcher(pack, dataset).accumulate(np.arange(dataset.count, dtype=np.int32))
    colours = sums.colour + np.asarray(sums.transmittance)[:, None] * np.asarray(dataset.background)
    shown = replace(dataset, pixels=jnp.asarray(np.round(255 * colours), jnp.uint8))
    figures = joint_tune(pack, shown, JointConfig(samples=SAMPLES))[1]
    assert figures["train_psnr_before"] > 50 and figures["train_psnr_after"] > 50, "errors stay below a level of 8 bits"


@pytest.mark.slow
@pytest.mark.parametrize("steps", [Steps(4, 16), Steps(4, 12, 8)])
def test_in_coarse_steps_little_is_lost_and_all_that_is_stored_is_a_multiple_or_as_bright_as_can_be(dataset, steps):
    pack = pack_of()
    empty = pack.atlas_rgba[..., 3] == 0
    coarse, figures = joint_tune(pack, dataset, replace(QUICK, steps=steps))
    assert coarse.atlas_features is not None
    alpha = coarse.atlas_rgba[..., 3:]
    for values, step in ((coarse.atlas_rgba[..., :3], steps.colour), (coarse.atlas_features, steps.feature)):
        assert np.all((values % step == 0) | (values == alpha)) and np.any(values % step == 0)
    assert np.all((alpha % steps.alpha == 0) | (alpha == 255)) and np.array_equal(alpha[..., 0] == 0, empty)
    assert len(np.unique(alpha)) > 128 // steps.alpha, "opacity is stored in all its steps"
    fine = joint_tune(pack_of(), dataset, QUICK)[1]
    assert figures["train_psnr_after"] > fine["train_psnr_after"] - 0.5
    assert [f for f in check_pack(coarse) if f.severity in ("warning", "error")] == []
