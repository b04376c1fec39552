"""The fast field: training learns, repeats itself, and compiles nothing between its stages."""

from __future__ import annotations

import dataclasses

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


def test_a_small_scene_is_learnt_and_a_restored_state_goes_on_to_the_same_losses(
    procedural_scene, small_config
) -> None:
    dataset = make_dataset(procedural_scene)
    method = VoxelMethod(small_config, dataset)
    state = method.start(jax.random.key(0))
    losses, saved = [], None
    for step in range(small_config.steps):
        if step == 80:
            saved = method.save(state)
        state, metrics = method.step(state, step)
        losses.append(float(metrics["loss"]))
    assert saved is not None

    camera = procedural_scene.splits["test"][0].camera
    picture = np.asarray(method.render(state, dataset.view_rays(camera)).rgb).reshape(camera.height, camera.width, 3)
    rgba = procedural_scene.splits["test"][0].load()
    truth = rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]
    mse, flat = np.mean((picture - truth) ** 2), np.mean((truth.mean((0, 1)) - truth) ** 2)
    assert mse < 0.4 * flat, "far better than the mean colour (4 dB) in a view never seen"
    present = present_voxels(state.layout).sum() * float(np.prod(np.asarray(state.layout.voxel)))
    assert present < 0.75 * np.prod(dataset.aabb[1] - dataset.aabb[0]), "empty space was pruned"

    again = VoxelMethod(small_config, dataset)
    restored = again.restore(saved)
    for step in range(80, small_config.steps):
        restored, metrics = again.step(restored, step)
        assert float(metrics["loss"]) == losses[step]


def test_nothing_compiles_between_the_announced_stages_and_old_buffers_are_given_away(
    procedural_scene, small_config
) -> None:
    method = VoxelMethod(small_config, make_dataset(procedural_scene))
    state = method.start(jax.random.key(0))
    compiled: list[str] = []
    jax.clear_caches()  # what other tests compiled would hide a second compilation here

    def listen(event: str, duration: float, **_) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        voxels = small_config.voxels
        later = (int(np.ceil(at * small_config.steps)) for at in (voxels.finer_samples_from, voxels.close_holes_from))
        announced = {0, *method.plan.schedule, *later}
        for step in range(small_config.steps):
            before, old = len(compiled), state.trainable.rows
            state, _ = method.step(state, step)
            if step == 0:
                assert len(compiled) > 0, "the listener hears compilations"
            if step not in announced:
                assert len(compiled) == before, f"step {step} compiled something"
                assert old.is_deleted(), "the old values' memory is used again"
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def test_the_queried_field_is_empty_outside_of_its_voxels(procedural_scene, small_config) -> None:
    method = VoxelMethod(small_config, make_dataset(procedural_scene))
    state = method.start(jax.random.key(0))
    far = jnp.asarray([[100.0, 0, 0], [0, -100.0, 0]])
    assert np.all(np.asarray(method.query(state, far).density) == 0)
