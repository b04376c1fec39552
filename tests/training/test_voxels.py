"""The fast field: the sparse grid interpolates like a dense one, the march leaves nothing out, training repeats
itself.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from training.config import PRESETS
from training.dataset import make_dataset
from training.method import Rays
from training.voxels.config import VoxelConfig
from training.voxels.march import MarchSizes, march, to_grid, transmittance
from training.voxels.method import VoxelMethod
from training.voxels.sparse_grid import build_layout, interpolate, present_voxels, voxel_centres

SHAPE = (9, 11, 14)  # z, y, x
ORIGIN, VOXEL = np.array([-0.3, 0.2, 1.0]), 0.1


@pytest.fixture
def present() -> np.ndarray:
    return np.random.default_rng(0).random(SHAPE) < 0.15


def random_rays(count: int, seed: int = 0) -> Rays:
    """Rays through the grid, some axis-parallel, some that miss it."""
    rng = np.random.default_rng(seed)
    target = ORIGIN + rng.random((count, 3)) * np.array(SHAPE[::-1]) * VOXEL * 1.3
    origins = target + rng.normal(size=(count, 3))
    directions = target - origins
    directions[: count // 8] = np.eye(3)[rng.integers(0, 3, count // 8)]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    f32 = [jnp.asarray(a, jnp.float32) for a in (origins, directions, directions)]
    return Rays(*f32, jnp.zeros(count), jnp.full(count, 10.0))


def test_a_sparse_grid_interpolates_as_a_dense_one_with_row_zero_where_nothing_is(present: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    layout = build_layout(present, ORIGIN, VOXEL)
    rows = rng.normal(size=(present.sum() + 1, 8)).astype(np.float32)
    rows[0] = 0
    dense = np.zeros((*SHAPE, 8), np.float32)
    dense[present] = rows[1:]
    g = rng.random((500, 3)) * np.array(SHAPE[::-1])
    expected = np.stack(
        [map_coordinates(np.pad(dense[..., c], 1), g[:, ::-1].T + 0.5, order=1) for c in range(8)], axis=-1
    )
    got = interpolate(jnp.asarray(rows), layout, jnp.asarray(g, jnp.float32))
    np.testing.assert_allclose(got, expected, atol=2e-5)


def test_rows_are_numbered_as_voxel_centres_are_listed(present: np.ndarray) -> None:
    layout = build_layout(present, ORIGIN, VOXEL)
    centres = voxel_centres(present, ORIGIN, VOXEL)
    rows = np.concatenate([np.zeros((1, 3)), centres]).astype(np.float32)
    rows = np.pad(rows, ((0, 0), (0, 5)))
    got = interpolate(jnp.asarray(rows), layout, (jnp.asarray(centres) - layout.origin) / layout.voxel)
    np.testing.assert_allclose(got[:, :3], centres, atol=1e-5)
    assert np.array_equal(present_voxels(layout), present)


def test_support_is_told_exactly_and_coarse_occupancy_never_hides_content(present: np.ndarray) -> None:
    layout = build_layout(present, ORIGIN, VOXEL)
    rng = np.random.default_rng(2)
    g = jnp.asarray(rng.random((4000, 3)) * np.array(SHAPE[::-1]), jnp.float32)
    ids, _ = layout.corners(g)
    supported = np.asarray(ids > 0).any(-1)
    assert np.array_equal(np.asarray(layout.has_support(g)), supported)
    nearby = g + jnp.asarray(rng.uniform(-1.999, 1.999, g.shape) / np.sqrt(3), jnp.float32)
    nearby = jnp.clip(nearby, 0, layout.dims)
    assert np.asarray(layout.near_content(nearby))[supported].all()


@pytest.mark.parametrize("samples", [4096, 600])
def test_the_march_lists_every_sample_with_support_and_says_which_rays_did_not_fit(
    present: np.ndarray, samples: int
) -> None:
    layout, rays = build_layout(present, ORIGIN, VOXEL), random_rays(256)
    grid_rays = to_grid(layout, rays)
    phase = jnp.asarray(np.random.default_rng(3).random(256), jnp.float32)
    found = march(layout, grid_rays, phase, MarchSizes(8, 2048, samples, 40), 1.0)
    start, end = np.asarray(grid_rays.start), np.asarray(grid_rays.end)
    listed = [[] for _ in range(256)]
    for ray, t in zip(np.asarray(found.ray)[found.valid], np.asarray(found.t)[found.valid], strict=True):
        listed[ray].append(float(t))
    for ray in range(256):
        t = start[ray] + np.asarray(phase)[ray] + np.arange(40)
        t = t[t < end[ray]].astype(np.float32)
        g = grid_rays.origins[ray] + t[:, None] * grid_rays.directions[ray]
        expected = t[np.asarray(layout.has_support(g))] if len(t) else t
        if found.complete[ray]:
            np.testing.assert_allclose(listed[ray], expected, atol=1e-4)
        else:
            assert listed[ray] == [], "a ray that is not complete must not contribute"
    assert bool(found.complete.all()) == (samples == 4096)
    assert int(found.complete.sum()) > 20


def test_transmittance_is_the_running_product_of_each_ray(present: np.ndarray) -> None:
    layout, rays = build_layout(present, ORIGIN, VOXEL), random_rays(128, seed=5)
    found = march(layout, to_grid(layout, rays), jnp.full(128, 0.5), MarchSizes(8, 2048, 4096, 40), 1.0)
    tau = jnp.asarray(np.random.default_rng(4).exponential(1.0, 4096), jnp.float32)
    before, behind = transmittance(found, tau, 128, 40)
    for ray in range(128):
        own = np.asarray((found.ray == ray) & found.valid)
        optical = np.asarray(tau)[own]
        np.testing.assert_allclose(np.asarray(before)[own], np.exp(np.cumsum(-optical) + optical), rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(behind[ray], np.exp(-optical.sum()), rtol=1e-4, atol=1e-6)


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
        announced = {0, *method.schedule}
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
