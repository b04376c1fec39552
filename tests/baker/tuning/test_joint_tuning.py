"""Voxels and view MLP tuned together: the gradient past the rounding, copies and cells, limits, and what is kept."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from baker.tuning import joint_loop
from baker.tuning.fused import tuner as fused_tuner
from baker.tuning.jax_tuner import (
    Scene,
    Sizes,
    gather,
    list_sizes,
    scene_of,
    score_some,
    start,
    stored,
    update,
)
from baker.tuning.joint_loop import JointConfig, cell_for, joint_tune, split_by_view
from baker.tuning.joint_rows import VoxelRows, cells_of_rows, rows_by_slot, voxel_rows, with_content
from baker.tuning.pack_layout import composite, pack_sizes, pack_voxels
from baker.tuning.tuner import BETAS, Look, Trained, shown
from scenepack import Pack, check_pack
from scenepack.blocks import dense_from_pack
from scenepack.codecs.steps import EXACT, Steps
from tests.baker.tuning.helpers import pack_of
from training.dataset import RayDataset
from training.marching.batches import rays_that_meet
from training.marching.layout import blend

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("hardly_optimised")]

SAMPLES = 32_768
SHOWN = Look(ndc=False, by_opacity=False)


class Problem(NamedTuple):
    """A pack ready to be tuned; ids: the training rays that meet its content."""

    pack: Pack
    rows: VoxelRows
    scene: Scene
    trained: Trained
    ids: np.ndarray
    sizes: Sizes


def problem_of(pack: Pack, dataset: RayDataset, cell: int = 4) -> Problem:
    rows = voxel_rows(pack)
    scene = scene_of(pack, rows, dataset, cell)
    every = np.arange(dataset.count, dtype=np.int32)
    ids = every[rays_that_meet(scene.layout, scene.rays, every, pack_sizes(pack, SAMPLES).segments)]
    trained = start(scene, pack)
    return Problem(pack, rows, scene, trained, ids, list_sizes(scene, trained, dataset, pack, ids, SAMPLES, 0))


@pytest.fixture(scope="module")
def problem(dataset: RayDataset) -> Problem:
    return problem_of(pack_of(), dataset)


def batch_of(problem: Problem) -> jax.Array:
    return jnp.asarray(np.random.default_rng(1).choice(problem.ids, problem.sizes.rays).astype(np.int32))


def step(problem: Problem, dataset: RayDataset, sizes: Sizes | None = None, look: Look = SHOWN, rate: float = 1e-3):
    """Trained, first and second moments, and the loss, of one update from nothing."""
    own = jax.tree.map(jnp.array, problem.trained)  # update gives away what it is handed
    zeros = [jax.tree.map(jnp.zeros_like, own) for _ in range(2)]
    rates = np.full(9, rate, np.float32)
    return update(
        own, *zeros, problem.scene, dataset, batch_of(problem), jnp.int32(0), rates, sizes or problem.sizes, look
    )


# --- rounding ---


def test_what_has_not_moved_is_stored_as_it_was_to_the_byte(problem: Problem) -> None:
    assert np.array_equal(stored(problem.trained.delta, problem.scene), problem.rows.content)
    alpha = np.arange(256)
    every = np.stack([alpha // 2, 0 * alpha, alpha, alpha, alpha, np.minimum(alpha, 1), alpha // 3, 0 * alpha], -1)
    none = jnp.zeros((256, 8))
    scene = problem.scene._replace(content=jnp.asarray(every, jnp.uint8), cells=jnp.arange(256), dither=none)
    assert np.array_equal(stored(jnp.zeros((256, 8)), scene), every)


def test_what_has_moved_is_stored_by_the_formulas_and_never_appears_or_vanishes(problem: Problem) -> None:
    rng = np.random.default_rng(0)
    delta = rng.normal(0, [0.3] * 3 + [2.0] + [0.3] * 4, problem.trained.delta.shape).astype(np.float32)
    found = np.asarray(stored(jnp.asarray(delta), problem.scene)).astype(int)
    content, moved = problem.rows.content.astype(float), delta[np.asarray(problem.scene.cells)]
    alpha = np.rint(255 * (1 - (1 - content[:, 3] / 255) ** np.exp(moved[:, 3].astype(float))))
    alpha = np.where(content[:, 3] > 0, np.maximum(alpha, 1), 0)
    straight = np.clip(content / np.maximum(content[:, 3:4], 1) + moved, 0, 1)
    expected = np.rint(straight * alpha[:, None])
    expected[:, 3] = alpha
    off = np.abs(found - expected)
    assert off.max() <= 1 and np.mean(off > 0) < 1e-3, "but for ties"
    assert np.array_equal(found[:, 3] > 0, content[:, 3] > 0)
    assert np.all(found <= found[:, 3:4]), "premultiplied"


@pytest.mark.parametrize("ndc", [False, True])
@pytest.mark.parametrize("cell", [1, 4])
def test_the_gradient_is_that_of_the_picture_as_if_nothing_were_rounded(
    dataset: RayDataset, cell: int, ndc: bool
) -> None:
    """Checked by differentiating, as a whole and in one go, a picture of voxels that are not rounded."""
    problem = problem_of(pack_of(), dataset, cell)
    scene, sizes = problem.scene, problem.sizes
    got = gather(scene, scene.content, dataset, batch_of(problem), sizes)
    assert got.whole.mean() > 0.9 and got.samples.valid.sum() > 1000
    content = scene.content.astype(jnp.float32) / 255

    def loss_of(trained: Trained) -> jax.Array:
        moved, before = trained.delta[scene.cells], content[:, 3:4]
        alpha = 1 - (1 - before) ** jnp.exp(moved[:, 3:4])
        values = (content / jnp.maximum(before, 1e-6) + moved) * alpha
        values = jnp.where(before > 0, values.at[:, 3:4].set(alpha), 0)
        sums = composite(got.samples, blend(values[got.ids], got.weights), sizes.rays, sizes.per_ray)
        rgb = shown(sums, trained.head, got.viewdirs, dataset.background, ndc)
        error = jnp.square(jnp.minimum(rgb, 1) - got.target).sum(-1)
        return jnp.where(got.whole, error, 0).sum() / got.whole.sum()

    expected_loss, expected = jax.value_and_grad(loss_of)(problem.trained)
    _, first, _, loss = step(problem, dataset, look=Look(ndc, False))
    np.testing.assert_allclose(3 * loss, expected_loss, rtol=1e-4)
    for found, wanted in zip(jax.tree.leaves(first), jax.tree.leaves(expected), strict=True):
        found, wanted = np.asarray(found) / (1 - BETAS[0]), np.asarray(wanted)
        scale = np.abs(wanted).max(axis=0) if wanted.shape == problem.trained.delta.shape else np.abs(wanted).max()
        assert np.all(scale > 0), "each part has a gradient"
        np.testing.assert_array_less(np.abs(found - wanted) / scale, 1e-3)


def test_a_move_too_small_to_change_a_byte_has_a_gradient_all_the_same(problem: Problem, dataset: RayDataset) -> None:
    trained, first, _, _ = step(problem, dataset, rate=1e-5)
    assert np.abs(np.asarray(trained.delta)).max() > 0
    assert np.array_equal(stored(trained.delta, problem.scene), problem.rows.content)
    assert np.mean(np.any(np.asarray(first.delta) != 0, axis=1)) > 0.5


def test_cells_that_no_ray_met_stay_with_their_moments(problem: Problem, dataset: RayDataset) -> None:
    _, first, _, _ = step(problem, dataset)
    met = np.any(np.asarray(first.delta) != 0, axis=1)
    assert met.any() and not met[0]
    rng = np.random.default_rng(3)
    delta, m, v = (rng.uniform(0.1, 1, np.shape(first.delta)).astype(np.float32) for _ in range(3))
    delta = delta * 1e-4
    ids = jnp.full(problem.sizes.rays, batch_of(problem)[0])  # one ray: few cells are met
    arguments = [problem.trained._replace(delta=jnp.array(part)) for part in (delta, m, v)]
    arguments = [jax.tree.map(jnp.array, part) for part in arguments]
    after = update(
        *arguments, problem.scene, dataset, ids, jnp.int32(5), np.full(9, 1e-3, np.float32), problem.sizes, SHOWN
    )
    same = [np.all(np.asarray(now.delta) == was, axis=1) for now, was in zip(after[:3], (delta, m, v), strict=True)]
    assert np.array_equal(same[0], same[1]) and np.array_equal(same[1], same[2])
    assert same[0][0] and 0 < np.mean(~same[0]) < 0.7


# --- copies and cells ---


@pytest.mark.parametrize("options", [{}, {"diffuse": True}, {"whole_blocks": True}])
def test_rows_hold_each_voxel_once_and_stand_for_all_its_copies(options: dict[str, Any]) -> None:
    pack = pack_of(2, **options)
    rows = voxel_rows(pack)
    rgba, _ = dense_from_pack(pack)
    assert len(rows.content) == 1 + np.count_nonzero(rgba[..., 3]) and not rows.content[0].any()
    assert np.array_equal(rows.content[rows_by_slot(pack, rows)], pack_voxels(pack))
    again = with_content(pack, rows, rows.content)
    assert np.array_equal(again.atlas_rgba, pack.atlas_rgba)
    assert pack.atlas_features is None or np.array_equal(again.atlas_features, pack.atlas_features)  # type: ignore[arg-type]
    assert (again.atlas_features is None) == (pack.atlas_features is None)


def test_copies_at_the_borders_of_macroblocks_move_with_what_they_copy() -> None:
    pack = pack_of(4, whole_blocks=True)
    rows = voxel_rows(pack)
    rng = np.random.default_rng(0)
    content = np.zeros_like(rows.content)
    content[1:, 3] = rng.integers(1, 256, len(content) - 1)
    content[1:, [0, 1, 2, 4, 5, 6, 7]] = rng.integers(0, content[1:, 3:4].astype(int) + 1, (len(content) - 1, 7))
    changed = with_content(pack, rows, content)
    assert np.mean(np.any(changed.atlas_rgba != pack.atlas_rgba, axis=-1)) > 0.05
    findings = {finding.rule: finding.severity for finding in check_pack(changed)}
    assert {findings[rule] for rule in ("padding rgba", "padding features", "premultiplied")} == {"ok"}


@pytest.mark.parametrize("side", [1, 3, 4])
def test_cells_are_cubes_of_the_grid_across_the_borders_of_macroblocks(side: int) -> None:
    pack = pack_of(5)
    rows = voxel_rows(pack)
    cells = cells_of_rows(pack, rows, side)
    # By another way: the rows' places in the grid, from an atlas that holds their numbers as colours.
    numbers = np.zeros_like(rows.content)
    numbers[:, :4] = np.arange(len(rows.content), dtype="<u4").view(np.uint8).reshape(-1, 4)
    dense = dense_from_pack(with_content(pack, rows, numbers))[0]
    row = np.ascontiguousarray(dense).view("<u4")[..., 0]
    z, y, x = np.nonzero(row)
    cubes: dict[tuple[int, ...], set[int]] = {}
    for place, number in zip(np.stack([z, y, x], -1) // side, row[z, y, x], strict=True):
        cubes.setdefault(tuple(place), set()).add(int(cells[number]))
    assert len(row[z, y, x]) == len(cells) - 1, "every voxel was found"
    assert all(len(found) == 1 for found in cubes.values()), "a cube is one cell"
    assert len(set().union(*cubes.values())) == len(cubes) and 0 not in set().union(*cubes.values()), "and no other's"
    assert cells[0] == 0 and cells.max() == len(cubes)
    border = pack.block_size // side * side
    assert side == 1 or pack.block_size % side == 0 or any(border // side in place for place in cubes), (
        "one lies across"
    )


# --- limits ---


@pytest.mark.parametrize("short", ["contributing", "per_ray"])
def test_rays_for_which_a_list_is_too_short_are_left_out_whole(
    problem: Problem, dataset: RayDataset, short: str
) -> None:
    ids, sizes = batch_of(problem), problem.sizes
    got = gather(problem.scene, problem.scene.content, dataset, ids, sizes)
    counts = np.asarray(got.samples.counts)
    assert bool(got.whole.all())
    limit = {"contributing": int(counts.sum()) // 2, "per_ray": int(np.median(counts[counts > 0]))}[short]
    fits = np.cumsum(counts) <= limit if short == "contributing" else counts <= limit
    assert 0.1 < fits.mean() < 0.9
    few = sizes._replace(**{short: limit})
    cut = gather(problem.scene, problem.scene.content, dataset, ids, few)
    assert np.array_equal(cut.whole, fits)
    error, weight, rays, samples = score_some(problem.trained, problem.scene, dataset, ids, few, SHOWN)
    assert (int(rays), int(samples)) == (fits.sum(), counts[fits].sum()) and weight == rays
    # and those that stay show what they showed
    alone = jnp.asarray(np.resize(np.asarray(ids)[fits], sizes.rays))
    expected = score_some(problem.trained, problem.scene, dataset, alone, sizes, SHOWN)
    whole_turns, rest = divmod(sizes.rays, int(fits.sum()))
    if rest == 0:
        np.testing.assert_allclose(float(expected[0]), whole_turns * float(error), rtol=1e-4)
    assert np.isfinite(np.asarray(step(problem, dataset, few)[1].delta)).all()


def test_views_are_held_out_whole_and_evenly(dataset: RayDataset) -> None:
    every = np.arange(dataset.count, dtype=np.int32)
    pixels = dataset.count // dataset.views
    trained_on, held_out = split_by_view(every, dataset, 4, seed=0)
    assert sorted(set(held_out // pixels)) == [2, 6, 10] and not set(trained_on // pixels) & {2, 6, 10}
    assert len(trained_on) == 9 * pixels and len(held_out) == min(3 * pixels, joint_loop.HELD_OUT_RAYS)
    for one_in in (0, dataset.views + 1):
        trained_on, seen = split_by_view(every, dataset, one_in, seed=0)
        assert np.array_equal(trained_on, every) and set(seen // pixels) == set(range(dataset.views))


@pytest.mark.parametrize(("rays", "cell"), [(10_000_000, 2), (2000, 2), (900, 3), (500, 4), (0, 4)])
def test_cells_are_as_large_as_the_rays_that_meet_them_ask_for(rays: int, cell: int) -> None:
    pack = pack_of()
    voxels = np.count_nonzero(pack.atlas_rgba[..., 3])
    assert cell_for(pack, int(rays * voxels / 1350)) == cell


# --- the whole ---

QUICK = JointConfig(passes=2, samples=SAMPLES, rate=20.0, density_rate=0.3, head_rate=1e-2, held_out=4, checks=3)


def copied(pack: Pack) -> Pack:
    """A pack that may be changed."""
    features = None if pack.atlas_features is None else pack.atlas_features.copy()
    return replace(pack, atlas_rgba=pack.atlas_rgba.copy(), atlas_features=features)


def test_the_same_seed_gives_the_same_pack_so_that_a_bake_that_goes_on_ends_alike(dataset: RayDataset) -> None:
    pack = pack_of()
    (one, figures), (two, again) = (joint_tune(copied(pack), dataset, QUICK) for _ in range(2))
    assert figures == again and figures["held_out_psnr_after"] > figures["held_out_psnr_before"]
    assert np.array_equal(one.atlas_rgba, two.atlas_rgba) and not np.array_equal(one.atlas_rgba, pack.atlas_rgba)
    for a, b in zip(one.view_mlp.weights, two.view_mlp.weights, strict=True):  # type: ignore[union-attr]
        assert np.array_equal(a, b)
    assert [f for f in check_pack(one) if f.severity in ("warning", "error")] == []


def test_a_pass_of_too_many_steps_is_cut_short_and_anneals_all_the_same(dataset: RayDataset, monkeypatch) -> None:
    rates: list[float] = []
    update = fused_tuner.FusedTuner.update

    def noting(self, ids, rates_now, count) -> None:
        rates.append(float(rates_now[0]))
        update(self, ids, rates_now, count)

    monkeypatch.setattr(fused_tuner.FusedTuner, "update", noting)
    figures = joint_tune(pack_of(), dataset, replace(QUICK, passes=50, most_steps=3))[1]
    assert len(rates) == 3 and 0 < figures["passes"] < 50
    np.testing.assert_allclose(rates[-1] / rates[0], QUICK.final_rate_factor ** (2 / 3), rtol=1e-5)


def test_what_is_scored_is_not_what_is_trained_on_first(dataset: RayDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without views held out, too: rays that were just trained on score better than others."""
    trained: list[np.ndarray] = []
    scored: list[np.ndarray] = []
    update, score = fused_tuner.FusedTuner.update, fused_tuner.FusedTuner.score
    monkeypatch.setattr(joint_loop, "HELD_OUT_RAYS", 512)
    monkeypatch.setattr(joint_loop, "FEWEST_SAMPLES", 4096)
    monkeypatch.setattr(
        fused_tuner.FusedTuner, "update", lambda self, ids, *more: (trained.append(ids), update(self, ids, *more))[1]
    )
    monkeypatch.setattr(fused_tuner.FusedTuner, "score", lambda self, ids: (scored.append(ids), score(self, ids))[1])
    joint_tune(pack_of(), dataset, replace(QUICK, held_out=0, most_steps=1))
    assert len(trained) == 1 and len(scored) == 2 and len(scored[0]) == 512
    assert np.isin(scored[0], trained[0]).mean() < 0.2, "by chance; 0.5 if both were drawn alike"


def test_tuning_that_makes_held_out_views_worse_leaves_the_pack_as_it_was(dataset: RayDataset) -> None:
    pack = problem_of(pack_of(), dataset).pack
    wild = replace(QUICK, rate=0.0, density_rate=50.0, head_rate=3.0)
    tuned, figures = joint_tune(copied(pack), dataset, wild)
    assert figures["held_out_psnr_after"] >= figures["held_out_psnr_before"]
    if figures["held_out_psnr_after"] == figures["held_out_psnr_before"]:
        assert np.array_equal(tuned.atlas_rgba, pack.atlas_rgba)
    spoilt, worse = joint_tune(copied(pack), dataset, replace(wild, held_out=0))
    assert worse["held_out_psnr_after"] < figures["held_out_psnr_after"], "without held-out views the last state counts"
    assert not np.array_equal(spoilt.atlas_rgba, pack.atlas_rgba)


def test_what_is_shown_scores_as_the_tuner_scores_it(dataset: RayDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fused_tuner, "SPARE", 8.0)
    pack = pack_of()
    every = np.arange(dataset.count, dtype=np.int32)
    tuner = fused_tuner.tuner_of(copied(pack), dataset, 4, Look(False, False), EXACT)
    tuner.fill(every, SAMPLES, 0)
    assert dataset.count <= joint_loop.HELD_OUT_RAYS, "so that all rays are looked at"
    known = tuner.score(every)[0]
    assert tuner.work.whole[: len(every)].all(), "no ray is left out for want of room"
    assert joint_loop.shown_psnr(pack, dataset, 0) == pytest.approx(known, abs=0.005)


@pytest.mark.parametrize(
    ("scores", "held_out", "steps"),
    [
        ([30.0, 29.8, 29.8], 4, 2),  # checks at an eighth and two eighths of eight steps
        ([30.0, 29.7, 29.9] + 6 * [29.95], 4, 8),
        ([30.0, 29.9, 29.9, 30.1, 29.5], 4, 4),
        ([30.0] + 8 * [29.0], 0, 8),
    ],
)
def test_tuning_is_given_up_where_held_out_views_have_lost_too_much_after_a_quarter(
    dataset: RayDataset, monkeypatch: pytest.MonkeyPatch, scores: list[float], held_out: int, steps: int
) -> None:
    told: list[tuple[float, str]] = []
    known = iter(scores)
    monkeypatch.setattr(fused_tuner.FusedTuner, "score", lambda self, ids: (next(known), 5.0))
    config = replace(QUICK, passes=50, most_steps=8, checks=8, held_out=held_out)
    figures = joint_tune(pack_of(), dataset, config, lambda share, text: told.append((share, text)))[1]
    made = [text for _, text in told if text.startswith("step")]
    assert len(made) == steps and told[-1][0] == 1.0 and made[-1].startswith(f"step {steps} of 8")
    assert figures["held_out_psnr_after"] == (scores[8] if not held_out else max(scores[: steps + 1]))


@pytest.mark.parametrize(("least", "kept"), [(0.1, False), (0.05, True)])
def test_tuning_must_gain_what_it_is_asked_for(dataset: RayDataset, monkeypatch, least: float, kept: bool) -> None:
    known = iter([30.0, 29.95, 30.08, 30.07])
    monkeypatch.setattr(fused_tuner.FusedTuner, "score", lambda self, ids: (next(known), 5.0))
    tuned, figures = joint_tune(pack_of(), dataset, replace(QUICK, passes=50, most_steps=3, checks=3, least_gain=least))
    assert figures["held_out_psnr_after"] == (30.08 if kept else 30.0)
    assert np.array_equal(tuned.atlas_rgba, pack_of().atlas_rgba) is not kept


def test_a_pack_that_no_ray_meets_comes_back_as_it_is(dataset: RayDataset) -> None:
    pack = replace(pack_of(), min_xyz=np.array([1e3, 1e3, 1e3]))
    assert joint_tune(pack, dataset, QUICK) == (pack, {})


@pytest.mark.parametrize("steps", [Steps(4, 16), Steps(4, 12, 8)])
def test_in_coarse_steps_little_is_lost_and_all_that_is_stored_is_a_multiple_or_as_bright_as_can_be(
    dataset: RayDataset, steps: Steps
) -> None:
    pack = pack_of()
    empty = pack.atlas_rgba[..., 3] == 0
    coarse, figures = joint_tune(pack, dataset, replace(QUICK, held_out=0, steps=steps))
    assert coarse.atlas_features is not None
    alpha = coarse.atlas_rgba[..., 3:]
    for values, step in ((coarse.atlas_rgba[..., :3], steps.colour), (coarse.atlas_features, steps.feature)):
        assert np.all((values % step == 0) | (values == alpha)) and np.any(values % step == 0)
    assert np.all((alpha % steps.alpha == 0) | (alpha == 255)) and np.array_equal(alpha[..., 0] == 0, empty)
    assert len(np.unique(alpha)) > 128 // steps.alpha, "opacity is stored in all its steps"
    fine = joint_tune(pack_of(), dataset, replace(QUICK, held_out=0))[1]
    assert figures["held_out_psnr_after"] > fine["held_out_psnr_after"] - 0.5
    assert [f for f in check_pack(coarse) if f.severity in ("warning", "error")] == []


def test_a_diffuse_pack_has_its_voxels_tuned(dataset: RayDataset) -> None:
    pack = pack_of(diffuse=True)
    tuned, figures = joint_tune(copied(pack), dataset, replace(QUICK, held_out=0))
    assert tuned.view_mlp is None and tuned.atlas_features is None
    assert figures["held_out_psnr_after"] > figures["held_out_psnr_before"]
    assert np.array_equal(tuned.atlas_rgba[..., 3] > 0, pack.atlas_rgba[..., 3] > 0)
