"""Which engine computes a run's steps: chosen where it begins, kept from then on, and never missed where nothing is trained."""

from __future__ import annotations

import dataclasses
import importlib.util

import jax
import numpy as np
import pytest

from console import Notice, UserError
from training.config import CPU, PRESETS, TrainConfig, from_json, to_json
from training.dataset import make_dataset
from training.methods import settled
from training.voxels.config import VoxelConfig
from training.voxels.engines import chosen_engine
from training.voxels.method import VoxelMethod

VOXELS = VoxelConfig(resolutions=(16,), stage_starts=(0.0,), prunings=(), samples_per_step=2048)
CONFIG = dataclasses.replace(CPU, batch_size=64, voxels=VOXELS, engine="fused")


@pytest.fixture
def without_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "numba" else find(name, *rest))


def test_a_run_that_begins_on_a_processor_takes_the_fused_loops_and_says_so_in_its_config() -> None:
    pytest.importorskip("numba", reason="pip install 'snerg[train]'")
    assert chosen_engine("auto") == "fused" and settled(PRESETS["cpu"]).engine == "fused"
    assert chosen_engine("jax") == "jax" and settled(dataclasses.replace(PRESETS["cpu"], engine="jax")).engine == "jax"
    assert settled(PRESETS["tiny"]).engine == "jax", "networks have one engine"


def test_without_numba_jax_goes_on_and_one_line_says_what_would_be_faster(without_numba: None) -> None:
    with pytest.warns(Notice, match=r"several times as fast with Numba: pip install 'snerg\[train\]'"):
        assert chosen_engine("auto") == "jax"


def test_a_run_of_before_there_was_a_choice_stays_with_jax() -> None:
    stored = to_json(PRESETS["cpu"])
    del stored["engine"]
    assert from_json(TrainConfig, stored, "config.json").engine == "jax"


def test_where_the_fused_loops_are_missing_a_run_of_theirs_is_rendered_but_not_trained(
    procedural_scene, without_numba: None
) -> None:
    method = VoxelMethod(CONFIG, make_dataset(procedural_scene))
    state = method.start(jax.random.key(0))
    points = np.zeros((4, 3), np.float32)
    assert np.isfinite(np.asarray(method.query(state, points).density)).all() and method.save(state)
    with pytest.raises(UserError, match="fused engine") as raised:
        method.step(state, 0)
    assert "Numba is not installed" in str(raised.value) and "pip install" in str(raised.value)
