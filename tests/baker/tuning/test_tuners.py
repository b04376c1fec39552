"""The two tuners of a pack agree: what a step does to cells and view MLP, what is stored, and what that scores."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from baker.tuning import joint_loop
from baker.tuning.fused import tuner as fused_tuner
from baker.tuning.fused.tuner import FusedTuner
from baker.tuning.jax_tuner import JaxTuner, gather, stored
from baker.tuning.tuner import BETAS, Look
from scenepack import Pack
from scenepack.codecs.steps import EXACT, Steps
from tests.baker.tuning.helpers import pack_of
from training.dataset import RayDataset
from training.multires.fused.workers import Workers

SAMPLES = 32_768
RATES = np.array([*[4e-3] * 3, 0.03, *[4e-3] * 4, 1e-3], np.float32)
COARSE = Steps(4, 16)
ALL_COARSE = Steps(4, 16, 4)
Both = tuple[FusedTuner, JaxTuner]


def both_of(
    pack: Pack, dataset: RayDataset, cell: int = 4, by_opacity: bool = False, steps: Steps = EXACT
) -> tuple[Both, np.ndarray]:
    """The two tuners of a pack, and rays for a step of both."""
    look = Look(pack.ndc, by_opacity)
    theirs = JaxTuner(pack, dataset, cell, look, steps)
    ours = FusedTuner(pack, dataset, cell, look, steps)  # last: it works on the pack's own arrays
    every = np.arange(dataset.count, dtype=np.int32)
    ids = every[ours.marcher.meets(every)]
    for tuner in (ours, theirs):
        tuner.fill(ids, SAMPLES, 0)
    return (ours, theirs), ids


def drawn(ids: np.ndarray, tuner: FusedTuner | JaxTuner, seed: int = 1) -> np.ndarray:
    return np.resize(np.random.default_rng(seed).choice(ids, 2048), tuner.rays).astype(np.int32)


def made_equal(both: Both) -> int:
    """Both take as many rays a step; how many."""
    ours, theirs = both
    rays = min(ours.rays, theirs.rays)
    ours.rays, ours.work = rays, fused_tuner.work_for(rays, ours.work.at.shape[1])
    theirs.rays, theirs.sizes = rays, theirs.sizes._replace(rays=rays)
    return rays


def test_both_compare_with_photographs_in_their_average_look(dataset: RayDataset) -> None:
    gains = np.ones((dataset.views, 3), np.float32)
    gains[:, 1] = np.linspace(0.6, 1.4, dataset.views)
    corrected = dataset.in_average_look(gains)
    (ours, theirs), ids = both_of(pack_of(), corrected)
    some = drawn(ids, ours)
    expected = np.asarray(corrected.colours_at(jnp.asarray(some)))
    assert np.abs(expected - np.asarray(dataset.colours_at(jnp.asarray(some)))).max() > 0.1
    np.testing.assert_allclose(np.asarray(ours._gather(some).target), expected, atol=1e-6)
    voxels = stored(theirs.trained.delta, theirs.scene)
    sizes = theirs.sizes._replace(rays=len(some))
    known = gather(theirs.scene, voxels, theirs.dataset, jnp.asarray(some), sizes).target
    np.testing.assert_allclose(np.asarray(known), expected, atol=1e-6)


def leaves(head: Any) -> list[np.ndarray]:
    return [np.asarray(a) for a in jax.tree.leaves(head)]


@pytest.mark.parametrize("style", ["object", "diffuse", "forward", "by opacity", "cells of 1", "cells of 3", "coarse"])
def test_a_step_moves_cells_and_view_mlp_alike(dataset: RayDataset, style: str) -> None:
    pack = pack_of(diffuse=style == "diffuse")
    pack = replace(pack, ndc=style == "forward")
    both, ids = both_of(pack, dataset, {"cells of 1": 1, "cells of 3": 3}.get(style, 4), style == "by opacity",
                        COARSE if style == "coarse" else EXACT)  # fmt: skip
    made_equal(both)
    ours, theirs = both
    for tuner in both:
        tuner.update(drawn(ids, tuner), RATES, 0)
    slopes, known = ours.first / (1 - BETAS[0]), np.asarray(theirs.first.delta) / (1 - BETAS[0])
    assert slopes.shape == known.shape and not slopes[0].any()
    scale = np.abs(known).max(axis=0)
    coloured = 4 if style == "diffuse" else 8
    assert (scale[:coloured] > 0).all(), "each part has a slope"
    off = np.abs(slopes - known)[:, :coloured] / scale[:coloured]
    assert np.mean(off > 1e-3) < 5e-3, "but for samples at a threshold, or rays that begin a step apart by rounding"
    met = [np.any(np.asarray(a) != 0, axis=1) for a in (ours.delta, theirs.trained.delta)]
    assert np.mean(met[0] != met[1]) < 5e-3 and met[0].mean() > 0.2
    moved = np.abs(ours.delta - np.asarray(theirs.trained.delta)) / RATES[:8]
    assert np.mean(moved > 0.02) < 0.01
    for own, other in zip(leaves(ours.head_moments[0]), leaves(theirs.first.head), strict=True):
        np.testing.assert_allclose(own, other, atol=2e-3 * np.abs(other).max())


@pytest.mark.parametrize("steps", [EXACT, COARSE, ALL_COARSE])
def test_what_has_moved_is_stored_alike_in_every_copy(dataset: RayDataset, steps: Steps) -> None:
    (ours, theirs), _ = both_of(pack_of(4, whole_blocks=True), dataset, steps=steps)
    delta = np.random.default_rng(0).normal(0, [0.2] * 3 + [1.5] + [0.2] * 4, ours.delta.shape).astype(np.float32)
    delta[0] = 0
    one, other = (t.tuned(t.snapshot()._replace(delta=delta)) for t in (ours, theirs))
    for name in ("atlas_rgba", "atlas_features"):
        a, b = getattr(one, name).astype(int), getattr(other, name).astype(int)
        assert np.abs(a - b).max() <= max(steps) and np.mean(a != b) < 1e-3, "but for ties"
    assert np.mean(one.atlas_rgba != pack_of(4, whole_blocks=True).atlas_rgba) > 0.05


def test_colours_of_neighbours_are_rounded_up_and_down_so_that_their_mean_stays(dataset: RayDataset) -> None:
    pack = pack_of(4, whole_blocks=True)
    rgba, features = np.zeros_like(pack.atlas_rgba), np.zeros_like(pack.atlas_features)
    rgba[...], features[...] = (101, 102, 103, 230), (50, 57, 60, 61)
    pack = replace(pack, atlas_rgba=rgba, atlas_features=features)
    both, _ = both_of(pack, dataset, steps=COARSE)
    x, y, z = (int(i) * 6 for i in pack.atlas_indices[tuple(np.argwhere(pack.occupied)[0])])
    eight = (slice(z + 1, z + 3), slice(y + 1, y + 3), slice(x + 1, x + 3))
    for tuner in both:
        stored = tuner.tuned(tuner.snapshot())
        values = np.concatenate([stored.atlas_rgba[eight], stored.atlas_features[eight]], axis=-1).reshape(8, 8)
        np.testing.assert_allclose(values[:, :4].mean(axis=0), [101, 102, 103, 230], atol=0.25)
        assert set(np.unique(values[:, 0])) == {100, 104}
        assert np.all(values[:, 4:] == [48, 64, 64, 64]), "features are rounded to the nearest"


def test_what_is_as_bright_as_can_be_stays_so_in_coarse_steps(dataset: RayDataset) -> None:
    pack = pack_of(4, whole_blocks=True)
    rgba, features = np.zeros_like(pack.atlas_rgba), np.zeros_like(pack.atlas_features)
    rgba[...], features[...] = (102, 101, 3, 102), (102, 100, 0, 102)
    both, _ = both_of(replace(pack, atlas_rgba=rgba, atlas_features=features), dataset, steps=COARSE)
    x, y, z = (int(i) * 6 for i in pack.atlas_indices[tuple(np.argwhere(pack.occupied)[0])])
    eight = (slice(z + 1, z + 3), slice(y + 1, y + 3), slice(x + 1, x + 3))
    for tuner in both:
        stored = tuner.tuned(tuner.snapshot())
        values = np.concatenate([stored.atlas_rgba[eight], stored.atlas_features[eight]], axis=-1).reshape(8, 8)
        assert np.all(values[:, [0, 3, 4, 7]] == 102) and not values[:, 6].any()
        assert set(np.unique(values[:, 1])) == {100, 102} and np.all(values[:, 5] == 102)
        assert abs(values[:, 1].mean() - 101) <= 0.25 and abs(values[:, 2].mean() - 3) <= 0.5


def test_what_has_moved_back_is_to_the_byte_as_it_was(dataset: RayDataset) -> None:
    pack = pack_of()
    assert pack.atlas_features is not None
    rgba, features = pack.atlas_rgba.copy(), pack.atlas_features.copy()
    (ours, _), ids = both_of(pack, dataset)
    start = ours.snapshot()
    for count in range(3):
        ours.update(drawn(ids, ours, count), 5 * RATES, count)
    assert not np.array_equal(ours.tables.rgba, rgba.reshape(-1, 4)) and not start.delta.any()
    assert np.shares_memory(ours.tables.rgba, pack.atlas_rgba), "an atlas of 1000³ is a gigabyte: there is one"
    again = ours.tuned(start)
    assert np.array_equal(again.atlas_rgba, rgba) and np.array_equal(again.atlas_features, features)


@pytest.mark.parametrize("by_opacity", [False, True])
def test_a_run_of_steps_scores_alike(dataset: RayDataset, by_opacity: bool) -> None:
    both, ids = both_of(pack_of(), dataset, by_opacity=by_opacity)
    made_equal(both)
    scores = []
    for tuner in both:
        before = tuner.score(drawn(ids, tuner, 99))
        for count in range(25):
            tuner.update(drawn(ids, tuner, count), 5 * RATES, count)
        scores.append((before, tuner.score(drawn(ids, tuner, 99))))
    (before, after), (known_before, known_after) = scores
    np.testing.assert_allclose(before, known_before, rtol=2e-3)
    np.testing.assert_allclose(after, known_after, rtol=4e-3)
    assert after[0] > before[0] + 0.5


def test_threads_change_nothing(dataset: RayDataset) -> None:
    found = []
    for threads in (1, 3):
        tuner = FusedTuner(pack_of(), dataset, 4, Look(False, False), EXACT)
        tuner.workers = Workers(threads)
        tuner.found = [fused_tuner.room_for_samples() for _ in range(threads)]
        every = np.arange(dataset.count, dtype=np.int32)
        tuner.fill(every, SAMPLES, 0)
        for count in range(4):
            tuner.update(drawn(every, tuner, count), 5 * RATES, count)
        found.append((tuner.delta.copy(), tuner.tables.rgba.copy(), tuner.score(every[::9])))
    assert np.array_equal(found[0][0], found[1][0]) and np.array_equal(found[0][1], found[1][1])
    assert found[0][2] == found[1][2]


def test_rays_without_room_count_for_nothing(dataset: RayDataset) -> None:
    (ours, _), ids = both_of(pack_of(), dataset)
    some = drawn(ids, ours)
    ours._gather(some)
    counts = np.diff(ours.work.first, axis=1)
    sums = ours.work.sums.copy()
    assert ours.work.whole.all()
    ours.work = fused_tuner.work_for(ours.rays, int(counts.sum(1).max()) // 2)
    ours._gather(some)
    whole = ours.work.whole
    assert 0.2 < whole.mean() < 0.9
    assert np.array_equal(ours.work.sums[whole], sums[whole])
    assert not ours.work.sums[~whole, :7].any() and (ours.work.sums[~whole, 7] == 1).all()
    ours.update(some, RATES, 0)
    assert np.isfinite(ours.delta).all() and ours.delta.any()


@pytest.mark.parametrize("compiled", [True, False])
def test_what_steps_cost_is_told_and_the_pack_stays(
    dataset: RayDataset, monkeypatch: pytest.MonkeyPatch, compiled: bool
) -> None:
    monkeypatch.setattr("baker.tuning.tuner.compiled_loops", lambda: compiled)
    pack, steps = pack_of(), Steps(32, 64, 64)
    before = pack.atlas_rgba.copy()
    theirs = JaxTuner(pack, dataset, 4, Look(pack.ndc, False), steps)
    rounded = theirs.tuned(theirs.snapshot())
    expected = joint_loop.shown_psnr(pack, dataset, 0) - joint_loop.shown_psnr(rounded, dataset, 0)
    assert abs(expected) > 0.02
    assert joint_loop.lost_to_steps(pack, dataset, steps, 0) == pytest.approx(expected, abs=0.005)
    assert joint_loop.lost_to_steps(pack, dataset, EXACT, 0) == pytest.approx(0, abs=1e-4)
    assert np.array_equal(pack.atlas_rgba, before)
