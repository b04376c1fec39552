"""The fast field: training learns, repeats itself, and compiles nothing between its stages."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from training.config import PRESETS
from training.dataset import make_dataset
from training.voxels.config import VoxelConfig
from training.voxels.method import VoxelMethod
from training.voxels.sparse_grid import present_voxels

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def small_config():
    voxels = VoxelConfig(
        resolutions=(24, 48), stage_starts=(0.0, 0.3), prunings=(0.1, 0.5), samples_per_step=8192, step_voxels=1.0
    )
    return dataclasses.replace(PRESETS["cpu"], steps=160, batch_size=512, voxels=voxels)


@dataclasses.dataclass
class Learnt:
    """A training from its first step to its last. compiled: how many programs each step compiled; given_away: whether each
    step took over the memory of the values before it; saved: the state before step SAVED."""

    method: VoxelMethod
    state: Any
    losses: list[float]
    compiled: list[int]
    given_away: list[bool]
    saved: dict[str, np.ndarray]


SAVED = 80


@pytest.fixture(scope="module")
def learnt(procedural_scene, small_config) -> Learnt:
    method = VoxelMethod(small_config, make_dataset(procedural_scene))
    found = Learnt(method, method.start(jax.random.key(0)), [], [], [], {})
    compiled: list[str] = []
    jax.clear_caches()  # what other tests compiled would hide a second compilation here

    def listen(event: str, duration: float, **_) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        for step in range(small_config.steps):
            if step == SAVED:
                found.saved = method.save(found.state)
            before, old = len(compiled), found.state.trainable.rows
            found.state, metrics = method.step(found.state, step)
            found.losses.append(float(metrics["loss"]))
            found.compiled.append(len(compiled) - before)
            found.given_away.append(old.is_deleted())
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    return found


def test_a_small_scene_is_learnt_and_a_restored_state_goes_on_to_the_same_losses(
    procedural_scene, small_config, learnt: Learnt
) -> None:
    dataset, state = learnt.method.dataset, learnt.state
    camera = procedural_scene.splits["test"][0].camera
    picture = np.asarray(learnt.method.render(state, dataset.view_rays(camera)).rgb)
    picture = picture.reshape(camera.height, camera.width, 3)
    rgba = procedural_scene.splits["test"][0].load()
    truth = rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]
    mse, flat = np.mean((picture - truth) ** 2), np.mean((truth.mean((0, 1)) - truth) ** 2)
    assert mse < 0.4 * flat, "far better than the mean colour (4 dB) in a view never seen"
    present = present_voxels(state.layout).sum() * float(np.prod(np.asarray(state.layout.voxel)))
    assert present < 0.75 * np.prod(dataset.aabb[1] - dataset.aabb[0]), "empty space was pruned"

    again = VoxelMethod(small_config, dataset)
    restored = again.restore(learnt.saved)
    for step in range(SAVED, small_config.steps):
        restored, metrics = again.step(restored, step)
        assert float(metrics["loss"]) == learnt.losses[step]


def test_nothing_compiles_between_the_announced_stages_and_old_buffers_are_given_away(
    small_config, learnt: Learnt
) -> None:
    voxels = small_config.voxels
    later = (int(np.ceil(at * small_config.steps)) for at in (voxels.finer_samples_from, voxels.close_holes_from))
    announced = {0, *learnt.method.plan.schedule, *later}
    assert learnt.compiled[0] > 0, "the listener hears compilations"
    between = [step for step in range(small_config.steps) if step not in announced]
    assert between and not [step for step in between if learnt.compiled[step]], "steps that compiled something"
    assert all(learnt.given_away[step] for step in between), "the old values' memory is used again"


def test_the_queried_field_is_empty_outside_of_its_voxels(procedural_scene, small_config) -> None:
    method = VoxelMethod(small_config, make_dataset(procedural_scene))
    state = method.start(jax.random.key(0))
    far = jnp.asarray([[100.0, 0, 0], [0, -100.0, 0]])
    assert np.all(np.asarray(method.query(state, far).density) == 0)
