"""What the fast field does differently for objects, surroundings and forward-facing captures."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.training.test_captures import circle, forward, write_llff, write_transforms
from training.config import PRESETS
from training.dataset import make_dataset
from training.scenes import Camera, Scene, load_scene
from training.voxels.config import BY_KIND, VoxelConfig, settings_for
from training.voxels.coverage import views_that_see
from training.voxels.method import VoxelMethod
from training.voxels.sparse_grid import build_layout, present_voxels, voxel_centres
from training.voxels.step import draw


def pixel_of(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Pixel coordinates [N, 2] of points [N, 3] of a pinhole camera; far outside where they lie behind it."""
    seen = (points - camera.world_T_camera[:3, 3]) @ camera.world_T_camera[:3, :3]
    at = np.stack([camera.fx * seen[:, 0], -camera.fy * seen[:, 1]], -1) / np.maximum(-seen[:, 2:], 1e-9)
    return np.where(seen[:, 2:] < 0, at + np.array([camera.cx, camera.cy]), -1e9)


def test_coverage_counts_the_photographs_that_see_a_voxel(procedural_scene: Scene) -> None:
    dataset = make_dataset(procedural_scene)
    low, high = procedural_scene.aabb
    present = np.ones((48, 48, 48), bool)
    layout = build_layout(present, low, (high - low).max() / 48)
    counted = views_that_see(dataset, layout).ravel()
    centres = voxel_centres(present, low, (high - low).max() / 48)
    surely, maybe = np.zeros(len(centres), int), np.zeros(len(centres), int)
    for photograph in procedural_scene.splits["train"]:
        x, y = pixel_of(photograph.camera, centres).T
        width, height = photograph.camera.width, photograph.camera.height
        distance = np.linalg.norm(centres - photograph.camera.world_T_camera[:3, 3], axis=-1)
        between = (distance > procedural_scene.near + 0.2) & (distance < procedural_scene.far - 0.2)
        surely += (x > 2) & (x < width - 2) & (y > 2) & (y < height - 2) & between
        maybe += (x > -2) & (x < width + 2) & (y > -2) & (y < height + 2)
    assert (counted >= surely).all() and (counted <= maybe).all()
    assert surely.max() == len(procedural_scene.splits["train"]) and maybe.min() < surely.max(), "the test tells apart"


def test_the_kind_is_told_by_alpha_and_by_where_cameras_look(procedural_scene: Scene, tmp_path: Path) -> None:
    surroundings = load_scene(write_transforms(tmp_path / "t", circle()))
    facing = load_scene(write_llff(tmp_path / "f", forward()))
    kinds = [make_dataset(scene).kind for scene in (procedural_scene, surroundings, facing)]
    assert kinds == ["object", "surroundings", "forward"]


@pytest.mark.parametrize("kind", ["object", "surroundings", "forward"])
def test_what_is_said_outright_wins_over_the_kind(kind) -> None:
    assert settings_for(VoxelConfig(), kind) == BY_KIND[kind]
    said = settings_for(VoxelConfig(prunings=(0.5,), distortion_weight=0.0, least_views=2), kind)
    assert said == dataclasses.replace(BY_KIND[kind], prunings=(0.5,), distortion_weight=0.0, least_views=2)


def test_what_few_photographs_see_is_left_out_from_the_start(procedural_scene: Scene) -> None:
    dataset = make_dataset(procedural_scene)
    voxels = VoxelConfig(resolutions=(16,), stage_starts=(0.0,), prunings=(), samples_per_step=2048, least_views=8)
    method = VoxelMethod(dataclasses.replace(PRESETS["cpu"], batch_size=64, voxels=voxels), dataset)
    state = method.start(jax.random.key(0))
    present = present_voxels(state.layout)
    assert 0 < present.sum() < present.size
    whole = build_layout(np.ones_like(present), state.layout.origin, np.asarray(state.layout.voxel))
    assert np.array_equal(present, views_that_see(dataset, whole) >= 8)


def test_a_handful_of_opaque_photographs_begins_with_voxels(tmp_path: Path) -> None:
    dataset = make_dataset(load_scene(write_transforms(tmp_path / "t", circle(6))))
    assert dataset.kind == "surroundings" and dataset.views == 5 < BY_KIND["surroundings"].least_views
    voxels = VoxelConfig(resolutions=(16,), stage_starts=(0.0,), prunings=(), samples_per_step=2048)
    method = VoxelMethod(dataclasses.replace(PRESETS["cpu"], engine="jax", batch_size=64, voxels=voxels), dataset)
    state = method.start(jax.random.key(0))
    assert present_voxels(state.layout).any()
    # what every ray may be drawn from needs no list of them
    assert state.hits.shape == (0,) and int(state.hit_count) == dataset.count
    arrays = method.save(state)
    again = method.restore(arrays)
    assert again.hits.shape == (0,) and int(again.hit_count) == dataset.count
    del arrays["hit_count"]  # runs of before kept the list
    older = method.restore({**arrays, "hits": np.arange(dataset.count, dtype=np.int32)})
    drawn = [draw(s.stage, dataset, jax.random.key(0), np.int32(0), 64, method.settings) for s in (again, older)]
    np.testing.assert_array_equal(np.asarray(drawn[0].target), np.asarray(drawn[1].target))


def test_photographs_that_share_little_begin_with_what_most_of_them_see(tmp_path: Path) -> None:
    """Cameras that stand together and look outwards: no part of the box is in all five pictures."""
    outward = circle(6, radius=0.2)
    outward[:, :3, 0] *= -1
    outward[:, :3, 2] *= -1
    dataset = make_dataset(load_scene(write_transforms(tmp_path / "t", outward, cx=15, cy=10)))
    voxels = VoxelConfig(resolutions=(16,), stage_starts=(0.0,), prunings=(), samples_per_step=2048)
    method = VoxelMethod(dataclasses.replace(PRESETS["cpu"], engine="jax", batch_size=64, voxels=voxels), dataset)
    layout = method.start(jax.random.key(0)).layout
    present = present_voxels(layout)
    seen = views_that_see(dataset, build_layout(np.ones_like(present), layout.origin, np.asarray(layout.voxel)))
    assert seen.max() < dataset.views < BY_KIND["surroundings"].least_views
    assert present.any() and np.array_equal(present, seen == seen.max())


def test_transparent_pixels_take_the_background_that_is_asked_for(procedural_scene: Scene) -> None:
    dataset = make_dataset(procedural_scene)
    ids = jnp.arange(dataset.count)
    alpha = np.asarray(dataset.pixels)[: dataset.count, 3] / 255
    red, blue = (dataset.colours_over(ids, jnp.asarray(c, jnp.float32)) for c in ([1.0, 0, 0], [0, 0, 1.0]))
    np.testing.assert_allclose(np.asarray(red - blue)[:, 0], 1 - alpha, atol=1e-6)
    np.testing.assert_allclose(
        dataset.colours_at(ids), dataset.colours_over(ids, jnp.ones((len(ids), 3))), atol=1e-6
    )  # the scene's own is white
