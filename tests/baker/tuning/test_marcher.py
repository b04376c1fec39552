"""The marcher of a pack finds along training rays what the slow reference finds, taking every sample."""

from dataclasses import replace

import numpy as np
import pytest

from baker.tuning.marcher import PackMarcher
from scenepack import Pack
from tests.baker.tuning.reference import sampled, voxel_rays
from tests.reference_marcher import render_reference
from tests.scenepack.random_packs import random_pack
from tests.viewer.rendering.shapes import surroundings_pack
from training.dataset import RayDataset, make_dataset
from training.scenes import Scene
from viewer.rendering.camera import ViewCamera

COUNT = 1500


def pack_in_view(style: str) -> Pack:
    """A random pack as large as what the cameras look at."""
    diffuse = style == "diffuse"
    style = "blob" if diffuse else style
    pack = random_pack(np.random.default_rng(3), grid_blocks=(4, 3, 5), style=style, diffuse=diffuse)
    size = np.array(pack.grid_size)
    voxel = 2.0 / size.max()
    return replace(pack, voxel_size=voxel, min_xyz=-0.5 * size * voxel)


@pytest.fixture(scope="module", params=["blob", "noise", "diffuse"])
def pack(request: pytest.FixtureRequest) -> Pack:
    return pack_in_view(request.param)


@pytest.fixture(scope="module")
def dataset(scene: Scene) -> RayDataset:
    """Rays that begin within what the packs hold."""
    return make_dataset(replace(scene, near=3.8))


@pytest.fixture(scope="module")
def marcher(pack: Pack, dataset: RayDataset) -> PackMarcher:
    return PackMarcher(pack, dataset)


@pytest.fixture(scope="module")
def ids(dataset: RayDataset) -> np.ndarray:
    return np.random.default_rng(0).integers(0, dataset.count, COUNT, np.int32)


def test_no_ray_that_meets_content_is_said_to_miss_it(pack, marcher, dataset, ids):
    meets, found = marcher.meets(ids), (sampled(pack, voxel_rays(pack, dataset, ids))[1] > 0).any(1)
    assert np.mean(found & ~meets) < 1e-3, "but for rays that begin a step apart by rounding"
    assert 0.1 < meets.mean() < 1 and found.mean() > 0.5 * meets.mean()
    assert not (marcher.accumulate(ids)[~meets, 7] < 1).any()


@pytest.mark.parametrize(
    ("near", "style"), [(0.0, "blob"), (0.0, "noise"), (0.0, "diffuse"), (3.9, "blob"), (0.5, "contracted")]
)
def test_a_photograph_is_seen_as_the_reference_draws_the_pack(scene: Scene, near: float, style: str) -> None:
    alone = replace(scene, near=near, splits={"train": scene.splits["train"][:1]})
    pack = surroundings_pack(64, radius=1.1) if style == "contracted" else pack_in_view(style)
    pack, camera = pack.with_metadata(near=near), scene.splits["train"][0].camera
    seen = make_dataset(alone)
    sums = PackMarcher(pack, seen).accumulate(np.arange(seen.count, dtype=np.int32))
    truth = render_reference(pack, ViewCamera.from_scene_camera(pack, camera), background=(0.0, 0.0, 0.0))
    shape = truth.alpha.shape
    assert truth.alpha.max() > 0.2
    close = np.abs(sums[:, :3].reshape(*shape, 3) - truth.diffuse).max(-1) < 2e-3
    assert close.mean() > 0.99, "float32 against float64: a sample at a threshold may fall either way"
    assert np.abs(sums[:, 3:7].reshape(*shape, 4) - truth.features)[close].max() < 6e-3
    assert np.abs(1 - sums[:, 7].reshape(shape) - truth.alpha)[close].max() < 6e-3


def test_the_light_of_every_sample_arrives_at_the_voxels_around_it(pack, marcher, dataset, ids):
    away = np.random.default_rng(1).uniform(-0.5, 0.5, (COUNT, 2)).astype(np.float32)
    rays = voxel_rays(pack, dataset, ids, away)
    t, alpha, before = sampled(pack, rays)
    ray, k = np.nonzero((alpha > 0) & (before > 0))
    at = rays.origins[ray] + t[ray, k, None] * rays.directions[ray]
    block = np.clip(np.floor(at / pack.block_size).astype(int), 0, np.array(pack.grid_blocks) - 1)
    slots = np.cumsum(pack.occupied).reshape(pack.occupied.shape) - 1
    low = np.floor(at - block * pack.block_size + 0.5).astype(int)
    found = marcher.transmittance((ids[half], away[half]) for half in (slice(0, 99), slice(99, None)))
    known = np.zeros(found.shape, int)
    for corner in np.ndindex(2, 2, 2):  # z, y, x
        x, y, z = np.minimum(low + corner[::-1], pack.padded_block_size - 1).T
        np.maximum.at(known, (slots[tuple(block.T[::-1])], z, y, x), np.ceil(255 * before[ray, k]).astype(int))
    assert known.any()
    assert np.mean(np.abs(found - known) > 1) < 5e-3, "but for samples at a threshold, or on a face between voxels"
