"""What pruning takes: what no photograph shows, and of what they do show a tenth at most."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from training.config import CPU
from training.dataset import make_dataset
from training.scenes import Scene
from training.voxels.config import VoxelConfig
from training.voxels.refine import MOST_FAINT, dense_start, refine, worth_keeping
from training.voxels.settings import plan_of
from training.voxels.sparse_grid import occupancy_of, present_voxels

KEEP_WEIGHT = 0.01


def mist(voxels: int = 5000) -> tuple[np.ndarray, np.ndarray]:
    """Weights of a young field: nothing is opaque, and nearly all voxels are fainter than what pruning usually takes."""
    random = np.random.default_rng(0)
    best = random.uniform(0.0, 0.012, voxels).astype(np.float32)
    return best, (best * random.uniform(1, 50, voxels)).astype(np.float32)


@pytest.mark.parametrize("steps_of_brightness", [None, 3, 1])
def test_in_mist_a_pruning_takes_at_most_a_tenth_of_what_photographs_show(steps_of_brightness: int | None) -> None:
    best, total = mist()
    if steps_of_brightness is not None:  # many voxels of one weight, as in a field that has hardly been trained
        best = (np.ceil(best / best.max() * steps_of_brightness) / steps_of_brightness * 0.009).astype(np.float32)
    taken = total[~worth_keeping(best, total, KEEP_WEIGHT)].sum() / total.sum()
    assert total[best < KEEP_WEIGHT].sum() / total.sum() > 0.5, "the usual threshold alone would take most of it"
    assert taken <= MOST_FAINT
    if steps_of_brightness is None:
        assert taken > 0.9 * MOST_FAINT, "the faintest do go"


def test_where_content_is_settled_the_usual_threshold_decides() -> None:
    best, total = mist()
    best[:500], total[:500] = 0.9, 1000.0
    assert np.array_equal(worth_keeping(best, total, KEEP_WEIGHT), best > KEEP_WEIGHT)


def test_what_no_photograph_shows_goes_even_from_mist() -> None:
    best, total = mist()
    best[::2] = total[::2] = 0.0
    assert not worth_keeping(best, total, KEEP_WEIGHT)[::2].any()


def test_of_a_field_that_nobody_sees_yet_nothing_is_taken(procedural_scene: Scene) -> None:
    dataset = make_dataset(procedural_scene)
    voxels = VoxelConfig(resolutions=(12, 24), stage_starts=(0.0, 0.5), prunings=())
    plan = plan_of(dataclasses.replace(CPU, voxels=voxels), dataset)
    state = dense_start(plan, dataset, None)
    unseen = np.zeros(present_voxels(state.layout).sum() + 1, np.float32)
    engine: Any = SimpleNamespace(
        occupancy=lambda state: occupancy_of(state.layout),
        drawn=lambda state: (np.asarray(state.hits), int(state.hit_count)),
        visible_weights=lambda state, ids: (unseen, unseen),
    )
    assert refine(engine, state, 24, plan) is state
