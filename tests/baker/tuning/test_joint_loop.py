"""Voxels and view MLP tuned together: which rays, for how long, and which state is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baker.tuning import joint_loop
from baker.tuning.joint_loop import JointConfig, joint_tune, split_by_view
from baker.tuning.tuner import Tuner
from scenepack import check_pack
from scenepack.codecs.quantisation import EXACT, Steps, steps_of
from tests.baker.tuning.helpers import copied, pack_of
from training.dataset import RayDataset

pytestmark = pytest.mark.usefixtures("hardly_optimised")

SAMPLES = 32_768


@pytest.mark.slow
def test_views_are_held_out_whole_and_evenly(dataset: RayDataset) -> None:
    every = np.arange(dataset.count, dtype=np.int32)
    pixels = dataset.count // dataset.views
    trained_on, held_out = split_by_view(every, dataset, 4, seed=0)
    assert sorted(set(held_out // pixels)) == [2, 6, 10] and not set(trained_on // pixels) & {2, 6, 10}
    assert len(trained_on) == 9 * pixels and len(held_out) == min(3 * pixels, joint_loop.HELD_OUT_RAYS)
    for one_in in (0, dataset.views + 1):
        trained_on, seen = split_by_view(every, dataset, one_in, seed=0)
        assert np.array_equal(trained_on, every) and set(seen // pixels) == set(range(dataset.views))


QUICK = JointConfig(passes=2, samples=SAMPLES, rate=20.0, density_rate=0.3, head_rate=1e-2, held_out=4, checks=3)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_pack_so_that_a_bake_that_goes_on_ends_alike(dataset: RayDataset) -> None:
    pack = pack_of()
    (one, figures, _), (two, again, _) = (joint_tune(copied(pack), dataset, QUICK) for _ in range(2))
    assert figures == again and figures["held_out_psnr_after"] > figures["held_out_psnr_before"]
    assert np.array_equal(one.atlas_rgba, two.atlas_rgba) and not np.array_equal(one.atlas_rgba, pack.atlas_rgba)
    for a, b in zip(one.view_mlp.weights, two.view_mlp.weights, strict=True):  # type: ignore[union-attr]
        assert np.array_equal(a, b)
    assert [f for f in check_pack(one) if f.severity in ("warning", "error")] == []


@pytest.mark.slow
def test_tuning_that_makes_held_out_views_worse_leaves_the_pack_as_it_was(dataset: RayDataset) -> None:
    pack = pack_of()
    wild = replace(QUICK, rate=0.0, density_rate=50.0, head_rate=3.0)
    tuned, figures, _ = joint_tune(copied(pack), dataset, wild)
    assert figures["held_out_psnr_after"] >= figures["held_out_psnr_before"]
    if figures["held_out_psnr_after"] == figures["held_out_psnr_before"]:
        assert np.array_equal(tuned.atlas_rgba, pack.atlas_rgba)
    spoilt, worse, _ = joint_tune(copied(pack), dataset, replace(wild, held_out=0))
    assert worse["held_out_psnr_after"] < figures["held_out_psnr_after"], "without held-out views the last state counts"
    assert not np.array_equal(spoilt.atlas_rgba, pack.atlas_rgba)


@pytest.mark.slow
@pytest.mark.parametrize(("held_out", "kept"), [(4, 30.1), (0, 29.5)])
def test_the_state_is_kept_that_held_out_views_like_best(
    dataset: RayDataset, monkeypatch: pytest.MonkeyPatch, held_out: int, kept: float
) -> None:
    known, states = iter([30.0, 29.9, 30.1, 29.5]), []
    snapshot, tuned = Tuner.snapshot, Tuner.tuned
    monkeypatch.setattr(Tuner, "score", lambda self, ids: (next(known), 5.0))
    monkeypatch.setattr(Tuner, "snapshot", lambda self: (states.append(snapshot(self)), states[-1])[1])
    monkeypatch.setattr(Tuner, "tuned", lambda self, state: (states.append(state), tuned(self, state))[1])
    config = replace(QUICK, passes=50, most_steps=3, held_out=held_out)
    figures = joint_tune(pack_of(), dataset, config)[1]
    assert figures["held_out_psnr_after"] == kept and figures["held_out_psnr_before"] == 30.0
    assert states[-1] is states[-2], "the last that was taken note of"


@pytest.mark.slow
@pytest.mark.parametrize(("most_lost", "stored_in"), [(0.5, Steps(8, 8, 8)), (0.3, EXACT)])
def test_steps_that_cost_held_out_views_too_much_are_not_stored_in(
    dataset: RayDataset, monkeypatch: pytest.MonkeyPatch, most_lost: float, stored_in: Steps
) -> None:
    known = iter([30.0, 29.6, 29.7])  # before, in steps, tuned
    monkeypatch.setattr(Tuner, "score", lambda self, ids: (next(known), 5.0))
    config = replace(QUICK, passes=50, most_steps=1, steps=Steps(8, 8, 8), most_lost=most_lost)
    pack, figures, came_to = joint_tune(pack_of(), dataset, config)
    assert came_to == stored_in and figures.get("lost_to_steps") == (None if stored_in == EXACT else 0.4)
    assert figures["held_out_psnr_after"] == (30.0 if stored_in == EXACT else 29.7)
    if stored_in == EXACT:
        assert np.array_equal(pack.atlas_rgba, pack_of().atlas_rgba), "to the byte as it was"
    else:
        assert steps_of(pack.atlas_rgba, pack.atlas_features) == stored_in


@pytest.mark.slow
@pytest.mark.parametrize("steps", [Steps(4, 16), Steps(4, 12, 8)])
def test_in_coarse_steps_little_is_lost_and_all_that_is_stored_is_a_multiple_or_as_bright_as_can_be(
    dataset: RayDataset, steps: Steps
) -> None:
    pack = pack_of()
    empty = pack.atlas_rgba[..., 3] == 0
    coarse, figures, _ = joint_tune(pack, dataset, replace(QUICK, held_out=0, steps=steps))
    assert coarse.atlas_features is not None
    alpha = coarse.atlas_rgba[..., 3:]
    for values, step in ((coarse.atlas_rgba[..., :3], steps.colour), (coarse.atlas_features, steps.feature)):
        assert np.all((values % step == 0) | (values == alpha)) and np.any(values % step == 0)
    assert np.all((alpha % steps.alpha == 0) | (alpha == 255)) and np.array_equal(alpha[..., 0] == 0, empty)
    assert len(np.unique(alpha)) > 128 // steps.alpha, "opacity is stored in all its steps"
    fine = joint_tune(pack_of(), dataset, replace(QUICK, held_out=0))[1]
    assert figures["held_out_psnr_after"] > fine["held_out_psnr_after"] - 0.5
    assert [f for f in check_pack(coarse) if f.severity in ("warning", "error")] == []
