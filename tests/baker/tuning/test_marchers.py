"""The two marchers of a pack agree on what training rays see of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baker.tuning.fused.marcher import FusedMarcher
from baker.tuning.jax_marcher import JaxMarcher
from scenepack import Pack
from tests.scenepack.random_packs import random_pack


def in_view(pack: Pack) -> Pack:
    """The pack as large as what the cameras look at."""
    size = np.array(pack.grid_size)
    voxel = 2.0 / size.max()
    return replace(pack, voxel_size=voxel, min_xyz=-0.5 * size * voxel)


@pytest.fixture(scope="module", params=["blob", "noise", "diffuse"])
def both(request, dataset) -> tuple[FusedMarcher, JaxMarcher]:
    style = {"diffuse": "blob"}.get(request.param, request.param)
    pack = in_view(
        random_pack(np.random.default_rng(3), block_size=14, grid_blocks=(4, 3, 5), alpha_style="any", style=style)
    )
    if request.param == "diffuse":
        pack = replace(pack, atlas_features=None, view_mlp=None)
    return FusedMarcher(pack, dataset), JaxMarcher(pack, dataset)


def rays_of(dataset, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    return random.integers(0, dataset.count, count, np.int32), random.uniform(-0.5, 0.5, (count, 2)).astype(np.float32)


def test_no_ray_that_meets_content_is_said_to_miss_it(both, dataset) -> None:
    ours, theirs = both
    ids, away = rays_of(dataset)
    meets, may = ours.meets(ids, away), theirs.meets(ids, away)
    assert not (meets & ~may).any() and 0.1 < meets.mean() < 1
    sums = ours.accumulate(ids)
    assert not (np.asarray(sums.transmittance)[~ours.meets(ids)] < 1).any()


def test_what_a_ray_accumulates_is_the_same(both, dataset) -> None:
    ours, theirs = both
    ids, _ = rays_of(dataset)
    found, known = ours.accumulate(ids), theirs.accumulate(ids)
    assert np.asarray(known.transmittance).min() < 0.5
    for name, values in known._asdict().items():
        off = np.abs(np.asarray(getattr(found, name)) - values) > 2e-3
        assert off.mean() < 5e-3, (
            f"{name}: but for a sample at a threshold, or rays that begin a step apart by rounding"
        )


def test_the_same_light_arrives(both, dataset) -> None:
    ours, theirs = both
    ids, away = rays_of(dataset)
    shares: list[float] = []
    found, known = ours.light(ids, away, shares.append), theirs.light(ids, away)
    assert found.shape == known.shape and known.any() and shares[-1] == 1.0
    off = np.abs(found.astype(int) - known) > 1
    assert off.mean() < 2e-3
    depths = np.abs(ours.half_depths(ids) - theirs.half_depths(ids))
    assert (depths > 1e-2).mean() < 5e-3 and theirs.half_depths(ids).max() > 1


def test_threads_change_nothing(both, dataset) -> None:
    ours, _ = both
    ids, away = rays_of(dataset)
    light, sums = ours.light(ids, away), ours.accumulate(ids)
    ours.workers = type(ours.workers)(1)
    assert np.array_equal(ours.light(ids, away), light)
    for one, many in zip(ours.accumulate(ids), sums, strict=True):
        assert np.array_equal(one, many)
