"""Voxels and view MLP tuned together: the gradient of a step past the rounding, what is stored in every copy, and which rays
are taken for how long.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from baker.tuning import joint_tuning
from baker.tuning.cells import BETAS, CHUNK, work_for
from baker.tuning.joint_tuning import JointConfig, Tuner, joint_tune
from baker.tuning.marcher import PackMarcher
from scenepack import Pack, check_pack
from scenepack.codecs.quantisation import EXACT, Steps
from scenepack.pack import ViewMlp
from tests.baker.tuning.reference import accumulated, cells_of_atlas, moved, pack_of, shown, voxel_rays
from tests.scenepack.helpers import same_pack
from tests.scenepack.volumes import features_of
from training.dataset import RayDataset

SAMPLES = 32_768
RATES = np.array([*[4e-3] * 3, 0.03, *[4e-3] * 4, 1e-3], np.float32)
JOINT = JointConfig(passes=2, samples=SAMPLES, rate=20.0, density_rate=0.3, head_rate=1e-2)
pytestmark = pytest.mark.usefixtures("hardly_optimised")


def tuner_of(pack: Pack, dataset: RayDataset, cell: int = 4, **options: Any) -> tuple[Tuner, np.ndarray]:
    """A tuner that is ready for steps, and the rays that meet its pack."""
    tuner = Tuner(pack, dataset, cell, **options)
    every = np.arange(dataset.count, dtype=np.int32)
    ids = every[tuner.marcher.meets(every)]
    tuner.fill(ids, SAMPLES, 0)
    return tuner, ids


def is_sound(pack: Pack) -> bool:
    return not [finding for finding in check_pack(pack) if finding.severity in ("warning", "error")]


def drawn(ids: np.ndarray, tuner: Tuner, seed: int = 1) -> np.ndarray:
    return np.resize(np.random.default_rng(seed).choice(ids, 2048), tuner.rays).astype(np.int32)


@pytest.mark.parametrize("style", ["object", "diffuse", "forward", "by opacity", "cells of 1"])
def test_gradients_are_finite_differences_of_the_loss_as_if_nothing_were_rounded(dataset, style):
    """The loss in float64, by the reference marcher: (L(x + h v) - L(x - h v)) / 2 h against the gradient along v."""
    pack = replace(pack_of(diffuse=style == "diffuse"), ndc=style == "forward")
    tuner, ids = tuner_of(deepcopy(pack), dataset, 1 if style == "cells of 1" else 4, by_opacity=style == "by opacity")
    tuner.rays, tuner.work = CHUNK, work_for(CHUNK, 200 * CHUNK)
    some = drawn(ids, tuner)
    tuner.update(some, RATES, 0)
    assert tuner.work.whole.all()
    # of cells [K + 1, 8], and of the view MLP: weights, then biases
    slopes = tuner.first / (1 - BETAS[0])
    head_slopes = [np.asarray(a) / (1 - BETAS[0]) for a in jax.tree.leaves(tuner.head_moments.mu)]
    cells, rays = cells_of_atlas(pack, tuner.cells.side), voxel_rays(pack, dataset, some)
    assert cells.max() == tuner.cells.occupied and not slopes[0].any()
    before = accumulated(pack, rays)
    weight = 1 - before[2] if style == "by opacity" else np.ones(CHUNK)

    def loss(sums: tuple[np.ndarray, np.ndarray, np.ndarray], mlp: ViewMlp | None) -> float:
        off = weight[:, None] * (shown(replace(pack, view_mlp=mlp), sums, rays, dataset.background) - rays.target)
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
            a, b, c, *biases = (part + h * step if i == place else part for i, part in enumerate(parts))
            return loss(before, ViewMlp((a, b, c), (biases[0], biases[1], biases[2])))

        scale = np.sqrt(np.square(own * step).sum())
        assert scale > 0 and abs((own * step).sum() - difference(of)) < 0.01 * scale


def test_a_move_too_small_to_change_a_byte_has_a_gradient_all_the_same(dataset: RayDataset) -> None:
    pack = pack_of()
    tuner, ids = tuner_of(deepcopy(pack), dataset)
    tuner.update(drawn(ids, tuner), np.full(9, 1e-5, np.float32), 0)
    assert tuner.delta.any() and np.array_equal(tuner.tables.rgba, pack.atlas_rgba.reshape(-1, 4))
    assert np.mean(np.any(tuner.first != 0, axis=1)) > 0.2


@pytest.mark.parametrize("steps", [EXACT, Steps(4, 16), Steps(4, 16, 4)])
def test_what_has_moved_is_stored_by_the_formulas_in_every_copy_and_never_appears_or_vanishes(dataset, steps):
    pack = pack_of(4, whole_blocks=True)
    tuner = Tuner(deepcopy(pack), dataset, 4)
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
        (features_of(stored), np.clip(features_of(exact), 0, alpha), steps.feature + steps.alpha),
    ):
        off = np.abs(found - wanted)[cells > 0]
        assert np.mean(off > 1.01 * most) < 1e-3 and off.max() <= 2 * most + 1
    assert np.array_equal(stored.atlas_rgba[..., 3] > 0, pack.atlas_rgba[..., 3] > 0)
    assert np.mean(stored.atlas_rgba != pack.atlas_rgba) > 0.05
    assert is_sound(stored)


def test_what_is_shown_scores_as_the_tuner_scores_it(dataset: RayDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joint_tuning, "SPARE", 8.0)
    pack = pack_of()
    every = np.arange(dataset.count, dtype=np.int32)
    tuner = Tuner(deepcopy(pack), dataset, 4)
    tuner.fill(every, SAMPLES, 0)
    assert dataset.count <= joint_tuning.SCORED_RAYS, "so that all rays are looked at"
    known = tuner.score(every)[0]
    assert tuner.work.whole[: len(every)].all(), "no ray is left out for want of capacity"
    assert joint_tuning.shown_psnr(pack, dataset, 0) == pytest.approx(known, abs=0.005)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_pack_so_that_a_bake_that_goes_on_ends_alike(dataset: RayDataset) -> None:
    pack = pack_of()
    (one, figures), (two, again) = (joint_tune(deepcopy(pack), dataset, JOINT) for _ in range(2))
    assert figures == again and figures["train_psnr_after"] > figures["train_psnr_before"]
    assert not np.array_equal(one.atlas_rgba, pack.atlas_rgba)
    assert same_pack(one, two) and is_sound(one)
    still = replace(JOINT, passes=0, rate=0.0, density_rate=0.0, head_rate=0.0)
    untouched = joint_tune(deepcopy(one), dataset, still)[0]
    assert np.array_equal(untouched.atlas_rgba, one.atlas_rgba), "cells that have not moved change no byte"


@pytest.mark.slow
def test_tuning_harms_no_pack_that_shows_its_photographs_already(dataset: RayDataset) -> None:
    pack = pack_of(diffuse=True)
    sums = PackMarcher(pack, dataset).accumulate(np.arange(dataset.count, dtype=np.int32))
    colours = sums[:, :3] + sums[:, 7:] * np.asarray(dataset.background)
    shown = replace(dataset, pixels=jnp.asarray(np.round(255 * colours), jnp.uint8))
    figures = joint_tune(pack, shown, JointConfig(samples=SAMPLES))[1]
    assert figures["train_psnr_before"] > 50 and figures["train_psnr_after"] > 50, "errors stay below a level of 8 bits"


@pytest.mark.slow
@pytest.mark.parametrize("steps", [Steps(4, 16), Steps(4, 12, 8)])
def test_in_coarse_steps_little_is_lost_and_all_that_is_stored_is_a_multiple_or_as_bright_as_can_be(dataset, steps):
    pack = pack_of()
    empty = pack.atlas_rgba[..., 3] == 0
    coarse, figures = joint_tune(pack, dataset, replace(JOINT, steps=steps))
    alpha = coarse.atlas_rgba[..., 3:]
    for values, step in ((coarse.atlas_rgba[..., :3], steps.colour), (features_of(coarse), steps.feature)):
        assert np.all((values % step == 0) | (values == alpha)) and np.any(values % step == 0)
    assert np.all((alpha % steps.alpha == 0) | (alpha == 255)) and np.array_equal(alpha[..., 0] == 0, empty)
    assert len(np.unique(alpha)) > 128 // steps.alpha, "opacity is stored in all its steps"
    fine = joint_tune(pack_of(), dataset, JOINT)[1]
    assert figures["train_psnr_after"] > fine["train_psnr_after"] - 0.5
    assert is_sound(coarse)
