"""The JAX march of a pack gives what the slow reference gives, and fine-tuning improves the view MLP on it."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from baker.reference_marcher import render_reference
from baker.tuning.fine_tune import fine_tune
from baker.tuning.joint_loop import JointConfig, joint_tune
from baker.tuning.pack_layout import accumulate, pack_layout, pack_sizes, pack_voxels
from scenepack import check_pack
from tests.scenepack.random_packs import random_pack, random_view_mlp
from training.marching.rays import in_grid_frame
from training.scenes import Camera
from viewer.rendering.camera import ViewCamera

pytestmark = pytest.mark.slow


def rays_of(dataset, pack, camera: Camera):
    rays = dataset.view_rays(camera)
    rays = rays._replace(near=jnp.full_like(rays.near, pack.near), far=jnp.full_like(rays.far, jnp.inf))
    return in_grid_frame(rays, jnp.asarray(np.linalg.inv(pack.worldspace_T_opengl), jnp.float32))


@pytest.mark.parametrize(("seed", "block_size", "near"), [(0, 14, 0.0), (1, 30, 0.0), (2, 14, 1.5)])
def test_accumulated_colour_features_and_transmittance_match_the_reference(
    dataset, seed: int, block_size: int, near: float
) -> None:
    pack = random_pack(
        np.random.default_rng(seed),
        block_size=block_size,
        grid_blocks=(2, 2, 2),
        alpha_style="any",
        style="blob",
    )
    middle = pack.worldspace_T_opengl[:3, :3] @ (0.5 * (pack.min_xyz + pack.max_xyz))
    across = np.linalg.norm(pack.max_xyz - pack.min_xyz)
    pack = pack.with_metadata(near=near * across)
    pose = np.eye(4)
    pose[:3, 3] = middle + np.array([0, 0, 1.6 * across])
    camera = Camera(pose, 40, 40, 55.0, 55.0, 20.0, 20.0)
    layout, voxels = pack_layout(pack), pack_voxels(pack)
    sums, complete = accumulate(layout, voxels, rays_of(dataset, pack, camera), pack_sizes(pack, 65536))
    assert bool(complete.all())
    truth = render_reference(pack, ViewCamera.from_scene_camera(pack, camera), background=(0.0, 0.0, 0.0))
    got = np.asarray(sums.colour).reshape(40, 40, 3)
    assert truth.alpha.max() > 0.2
    # float32 against float64: a sample at a threshold may fall either way
    close = np.abs(got - truth.diffuse).max(-1) < 2e-3
    assert close.mean() > 0.99
    assert np.abs(np.asarray(sums.features).reshape(40, 40, 4) - truth.features)[close].max() < 6e-3
    assert np.abs(1 - np.asarray(sums.transmittance).reshape(40, 40) - truth.alpha)[close].max() < 6e-3


def test_fine_tuning_brings_a_spoilt_view_mlp_closer_to_the_photographs(scene, dataset) -> None:
    pack = random_pack(np.random.default_rng(7), block_size=14, grid_blocks=(3, 3, 3))
    size = np.array(pack.grid_size) * 0.05
    spoilt = random_view_mlp(np.random.default_rng(8))
    pack = replace(pack, voxel_size=0.05, min_xyz=-0.5 * size, view_mlp=spoilt)
    tuned, before, after = fine_tune(pack, dataset, epochs=500)
    assert after > before + 0.5
    assert tuned.view_mlp is not None and not np.array_equal(tuned.view_mlp.weights[0], spoilt.weights[0])
    assert tuned.atlas_rgba is pack.atlas_rgba, "the grid is left as it is"


def test_a_diffuse_pack_has_nothing_to_tune(dataset) -> None:
    pack = random_pack(np.random.default_rng(3), block_size=14, grid_blocks=(2, 2, 2), diffuse=True)
    assert fine_tune(pack, dataset, epochs=3)[0] is pack


def test_tuning_voxels_and_view_mlp_together_shows_the_photographs_better_and_keeps_all_copies_alike(dataset) -> None:
    pack = random_pack(np.random.default_rng(7), block_size=14, grid_blocks=(3, 3, 3))
    size = np.array(pack.grid_size) * 0.05
    pack = replace(pack, voxel_size=0.05, min_xyz=-0.5 * size, view_mlp=random_view_mlp(np.random.default_rng(8)))
    config = JointConfig(passes=20, samples=32_768, cell=1, rate=30.0, density_rate=0.5, held_out=0)
    before = pack.atlas_rgba.copy()
    tuned, figures = joint_tune(pack, dataset, config)
    assert figures["held_out_psnr_after"] > figures["held_out_psnr_before"] + 0.3
    assert not np.array_equal(tuned.atlas_rgba, before)
    before = tuned.atlas_rgba.copy()
    untouched = joint_tune(tuned, dataset, replace(config, passes=0, rate=0.0, density_rate=0.0, head_rate=0.0))[0]
    assert np.array_equal(untouched.atlas_rgba, before), "cells that have not moved change no byte"
    assert not [f.message for f in check_pack(tuned) if f.severity in ("warning", "error")]
