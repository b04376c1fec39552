"""A step of the tuner: the gradient past the rounding, what is stored in every copy, and that threads change nothing."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

from baker.tuning import joint_tuning
from baker.tuning.cells import BETAS, CHUNK, work_for
from baker.tuning.joint_tuning import Tuner
from scenepack import Pack, check_pack
from scenepack.codecs.quantisation import EXACT, Steps
from scenepack.pack import ViewMlp
from tests.baker.tuning.reference import accumulated, cells_of_atlas, copied, moved, pack_of, shown, voxel_rays
from training.dataset import RayDataset

SAMPLES = 32_768
RATES = np.array([*[4e-3] * 3, 0.03, *[4e-3] * 4, 1e-3], np.float32)
COARSE = Steps(4, 16)
ALL_COARSE = Steps(4, 16, 4)


def tuner_of(pack: Pack, dataset: RayDataset, cell: int = 4, **options: Any) -> tuple[Tuner, np.ndarray]:
    """A tuner that is ready for steps, and the rays that meet its pack."""
    tuner = Tuner(pack, dataset, cell, **options)
    every = np.arange(dataset.count, dtype=np.int32)
    ids = every[tuner.marcher.meets(every)]
    tuner.fill(ids, SAMPLES, 0)
    return tuner, ids


def drawn(ids: np.ndarray, tuner: Tuner, seed: int = 1) -> np.ndarray:
    return np.resize(np.random.default_rng(seed).choice(ids, 2048), tuner.rays).astype(np.int32)


def slopes_of(tuner: Tuner) -> tuple[np.ndarray, list[np.ndarray]]:
    """The gradient of a tuner's first step, of cells [K + 1, 8] and of the view MLP: weights, then biases."""
    head = [np.asarray(a) / (1 - BETAS[0]) for a in jax.tree.leaves(tuner.head_moments[0])]
    return tuner.first / (1 - BETAS[0]), head


# --- the gradient ---


@pytest.mark.parametrize("style", ["object", "diffuse", "forward", "by opacity", "cells of 1"])
def test_gradients_are_finite_differences_of_the_loss_as_if_nothing_were_rounded(dataset, style):
    """The loss in float64, by the reference marcher: (L(x + h v) - L(x - h v)) / 2 h against the gradient along v."""
    pack = replace(pack_of(diffuse=style == "diffuse"), ndc=style == "forward")
    tuner, ids = tuner_of(copied(pack), dataset, 1 if style == "cells of 1" else 4, by_opacity=style == "by opacity")
    tuner.rays, tuner.work = CHUNK, work_for(CHUNK, 200 * CHUNK)
    some = drawn(ids, tuner)
    tuner.update(some, RATES, 0)
    assert tuner.work.whole.all()
    slopes, head_slopes = slopes_of(tuner)
    cells, rays = cells_of_atlas(pack, tuner.cells.side), voxel_rays(pack, dataset, some)
    assert cells.max() == tuner.cells.count and not slopes[0].any()
    before = accumulated(pack, rays)
    weight = 1 - before[2] if style == "by opacity" else np.ones(CHUNK)

    def loss(sums: tuple[np.ndarray, np.ndarray, np.ndarray], mlp: ViewMlp | None) -> float:
        off = weight[:, None] * (shown(pack, sums, mlp, rays, dataset.background) - rays.target)
        return np.square(off).sum() / np.square(weight).sum()

    def difference(of: Callable[[float], float], h: float = 1e-5) -> float:
        return (of(h) - of(-h)) / (2 * h)

    rng = np.random.default_rng(2)
    for channel in range(4 if style == "diffuse" else 8):
        own = slopes[:, channel]
        one, many = np.zeros((2, len(slopes)))  # directions: the cell that matters most, and all of them
        one[np.abs(own).argmax()], many[1:] = 1.0, rng.choice([-1.0, 1.0], len(slopes) - 1)
        for along in (one, many):
            step = np.zeros(slopes.shape)
            step[:, channel] = along
            expected = difference(lambda h, v=step: loss(accumulated(moved(pack, cells, h * v), rays), pack.view_mlp))
            scale = np.sqrt(np.square(own * along).sum())
            assert scale > 0 and abs(own @ along - expected) < 0.01 * scale, f"channel {channel}"
    if pack.view_mlp is None:
        return
    parts = [*pack.view_mlp.weights, *pack.view_mlp.biases]
    for place, own in enumerate(head_slopes):
        step = rng.normal(size=own.shape)

        def of(h: float, place: int = place, step: np.ndarray = step) -> float:
            changed = [part + h * step if i == place else part for i, part in enumerate(parts)]
            return loss(before, ViewMlp(tuple(changed[:3]), tuple(changed[3:])))

        scale = np.sqrt(np.square(own * step).sum())
        assert scale > 0 and abs((own * step).sum() - difference(of)) < 0.01 * scale


def test_a_move_too_small_to_change_a_byte_has_a_gradient_all_the_same(dataset: RayDataset) -> None:
    pack = pack_of()
    tuner, ids = tuner_of(copied(pack), dataset)
    tuner.update(drawn(ids, tuner), np.full(9, 1e-5, np.float32), 0)
    assert tuner.delta.any() and np.array_equal(tuner.tables.rgba, pack.atlas_rgba.reshape(-1, 4))
    assert np.mean(np.any(tuner.first != 0, axis=1)) > 0.2


# --- cells, and what is stored ---


@pytest.mark.parametrize("steps", [EXACT, COARSE, ALL_COARSE])
def test_what_has_moved_is_stored_by_the_formulas_in_every_copy_and_never_appears_or_vanishes(dataset, steps):
    pack = pack_of(4, whole_blocks=True)
    tuner = Tuner(copied(pack), dataset, 4)
    delta = np.random.default_rng(0).normal(0, [0.2] * 3 + [1.5] + [0.2] * 4, tuner.delta.shape).astype(np.float32)
    delta[0] = 0
    tuner.delta[:] = delta
    tuner.round_to(steps)
    stored = tuner.tuned()
    cells = cells_of_atlas(pack, 4)
    exact = moved(pack, cells, delta.astype(float))
    alpha = exact.atlas_rgba[..., 3:]
    for found, wanted, most in (
        (stored.atlas_rgba[..., 3:], alpha, steps.alpha),
        (stored.atlas_rgba[..., :3], np.clip(exact.atlas_rgba[..., :3], 0, alpha), steps.colour + steps.alpha),
        (stored.atlas_features, np.clip(exact.atlas_features, 0, alpha), steps.feature + steps.alpha),  # type: ignore[arg-type]
    ):
        off = np.abs(found - wanted)[cells > 0]
        assert np.mean(off > 1.01 * most) < 1e-3 and off.max() <= 2 * most + 1
    assert np.array_equal(stored.atlas_rgba[..., 3] > 0, pack.atlas_rgba[..., 3] > 0)
    assert np.mean(stored.atlas_rgba != pack.atlas_rgba) > 0.05
    findings = {finding.rule: finding.severity for finding in check_pack(stored)}
    assert {findings[rule] for rule in ("padding rgba", "padding features", "premultiplied")} == {"ok"}


# --- a run of steps ---


@pytest.mark.parametrize("by_opacity", [False, True])
def test_a_run_of_steps_shows_the_photographs_better(dataset: RayDataset, by_opacity: bool) -> None:
    tuner, ids = tuner_of(pack_of(), dataset, by_opacity=by_opacity)
    before = tuner.score(drawn(ids, tuner, 99))
    for count in range(25):
        tuner.update(drawn(ids, tuner, count), 5 * RATES, count)
    assert tuner.score(drawn(ids, tuner, 99))[0] > before[0] + 0.5


def test_what_is_shown_scores_as_the_tuner_scores_it(dataset: RayDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joint_tuning, "SPARE", 8.0)
    pack = pack_of()
    every = np.arange(dataset.count, dtype=np.int32)
    tuner = Tuner(copied(pack), dataset, 4)
    tuner.fill(every, SAMPLES, 0)
    assert dataset.count <= joint_tuning.SCORED_RAYS, "so that all rays are looked at"
    known = tuner.score(every)[0]
    assert tuner.work.whole[: len(every)].all(), "no ray is left out for want of capacity"
    assert joint_tuning.shown_psnr(pack, dataset, 0) == pytest.approx(known, abs=0.005)
