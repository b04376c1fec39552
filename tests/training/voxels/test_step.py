"""The seam for other engines: a step is the gradient of a batch that can be drawn on its own, and Adam."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from training.config import CPU
from training.dataset import make_dataset
from training.voxels.config import VoxelConfig
from training.voxels.method import VoxelMethod
from training.voxels.step import adam, draw, gradient_parts, loss_and_gradient

VOXELS = VoxelConfig(resolutions=(16,), stage_starts=(0.0,), prunings=(), samples_per_step=2048)
CONFIG = dataclasses.replace(CPU, batch_size=64, voxels=VOXELS)


@pytest.fixture(scope="module")
def method(procedural_scene) -> VoxelMethod:
    return VoxelMethod(CONFIG, make_dataset(procedural_scene))


def test_a_step_is_a_drawn_batch_its_gradient_and_adam(method: VoxelMethod) -> None:
    state, again = method.start(jax.random.key(0)), method.start(jax.random.key(0))
    settings, mesh = method.settings, method.dataset.mesh
    batch = jax.jit(draw, static_argnames=("rays", "settings"))(
        state.stage, method.dataset, jax.random.key(CONFIG.seed), np.int32(7), state.rays, settings
    )
    gradient, loss, terms = jax.jit(loss_and_gradient, static_argnames=("mesh", "sizes", "settings"))(
        state.trainable, state.stage, batch, mesh, sizes=state.sizes, settings=settings
    )
    expected = adam(state.optimised, gradient, jnp.float32(0.25), settings)
    found, metrics = method.engine.step(again, 7, 0.25)
    assert float(loss) == pytest.approx(float(metrics["loss"]), rel=1e-5) and set(terms) < set(metrics)
    assert np.abs(np.asarray(gradient.rows)).max() > 0 and int(found.updates) == 1
    for ours, theirs in zip(jax.tree.leaves(expected), jax.tree.leaves(found.optimised), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=1e-6)
    assert found.sizes == again.sizes and found.layout is again.layout


def test_the_parts_of_a_step_are_those_that_are_profiled(method: VoxelMethod) -> None:
    from training.profile_report import JAX_PARTS

    state = method.start(jax.random.key(0))

    def run(trainable, stage):
        batch = draw(stage, method.dataset, jax.random.key(0), jnp.int32(0), state.rays, method.settings)
        made = gradient_parts(
            trainable, stage, batch, method.dataset.mesh, sizes=state.sizes, settings=method.settings
        )  # fmt: skip
        names.extend(name for name, _ in made)

    names = ["draw"]
    jax.eval_shape(run, state.trainable, state.stage)
    assert names == [name for name in JAX_PARTS if name not in ("variation", "adam", "remember")]
