"""What a config means for a dataset: stages and samples that follow the photographs, and what older configs meant."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from console import UserError
from training.config import CPU, TrainConfig, from_json, to_json
from training.dataset import RayDataset, make_dataset
from training.scenes import Scene
from training.scenes.scene import Kind
from training.voxels.config import BY_KIND, VoxelConfig
from training.voxels.settings import MOST_FINER, VOXELS_PER_PIXEL, plan_of, schedule, settings_of


@pytest.fixture(scope="module")
def dataset(procedural_scene: Scene) -> RayDataset:
    return make_dataset(procedural_scene)


def of_photographs(dataset: RayDataset, *sizes: tuple[int, int]) -> RayDataset:
    """The dataset as if its photographs were so wide and high; nothing decodes them."""
    pixels = [width * height for width, height in sizes]
    first = np.concatenate([[0], np.cumsum(pixels)[:-1]]).astype(np.int32)
    width = jnp.asarray([width for width, _ in sizes], jnp.int32)
    return dataclasses.replace(dataset, first=jnp.asarray(first), width=width, count=sum(pixels))


@pytest.mark.parametrize("side", [48, 100, 200, 256, 400, 800, 4000])
def test_the_last_grid_is_about_as_fine_as_the_photographs_and_no_stage_is_much_finer_than_the_one_before(
    dataset: RayDataset, side: int
) -> None:
    resolutions = plan_of(CPU, of_photographs(dataset, (side, side))).resolutions
    assert resolutions[0] == 64 and len(resolutions) in (3, 4)
    finest = resolutions[-1]
    assert finest % 32 == 0 and 96 <= finest <= 512
    assert finest in (96, 512) or 0 <= VOXELS_PER_PIXEL * side - finest < 32
    finer = np.divide(resolutions[1:], resolutions[:-1])
    assert finer.min() > 1.1 and finer.max() < 1.01 * MOST_FINER  # but for whole voxels
    np.testing.assert_allclose(finer, finer.mean(), rtol=0.02, err_msg="each stage is as much finer")


def test_the_longest_side_of_any_photograph_decides(dataset: RayDataset) -> None:
    alone = plan_of(CPU, of_photographs(dataset, (300, 200))).resolutions
    assert plan_of(CPU, of_photographs(dataset, (200, 300))).resolutions == alone
    assert plan_of(CPU, of_photographs(dataset, (100, 80), (200, 300), (64, 64))).resolutions == alone
    assert plan_of(CPU, of_photographs(dataset, (100, 80))).resolutions != alone


def test_what_is_said_outright_is_not_chosen(dataset: RayDataset) -> None:
    said = dataclasses.replace(CPU, voxels=VoxelConfig(resolutions=(32, 48, 56), samples_per_step=5000))
    plan = plan_of(said, of_photographs(dataset, (800, 800)))
    assert plan.resolutions == (32, 48, 56) and plan.samples == 5000


def test_a_step_of_a_finer_grid_takes_more_samples_within_bounds(dataset: RayDataset) -> None:
    def samples(finest: int) -> int:
        return plan_of(dataclasses.replace(CPU, voxels=VoxelConfig(resolutions=(64, 80, finest))), dataset).samples

    assert samples(96) == samples(256) == 65_536
    assert samples(384) == 65_536 * 9 // 4
    assert samples(512) == samples(1000) == 4 * 65_536


def test_with_one_resolution_more_than_starts_the_second_stage_is_split_and_the_finest_waits() -> None:
    three, four = (
        schedule(BY_KIND["object"], 6000, (64, 128, 256)),
        schedule(BY_KIND["object"], 6000, (64, 128, 256, 512)),
    )
    assert three == {0: 64, 90: 64, 240: 128, 600: 128, 1200: 256, 1800: 256, 3600: 256}
    assert four == {0: 64, 90: 64, 120: 128, 360: 256, 600: 256, 1500: 512, 1800: 512, 3600: 512}


@pytest.mark.parametrize("steps", [400, 6000, 60_000])
@pytest.mark.parametrize("kind", ["object", "surroundings", "forward"])
def test_every_stage_has_its_turn_whether_there_are_three_or_four_and_no_coarse_one_lasts_long(
    kind: Kind, steps: int
) -> None:
    for resolutions in ((64, 128, 256), (64, 128, 256, 512)):
        events = schedule(BY_KIND[kind], steps, resolutions)
        assert sorted(events) == list(events), "in order"
        assert tuple(dict.fromkeys(events.values())) == resolutions, "each resolution, coarse to fine"
        prunings = {round(steps * share) for share in BY_KIND[kind].prunings if steps * share > 100}
        assert prunings <= set(events)
        finest = min(step for step, resolution in events.items() if resolution == resolutions[-1])
        assert finest <= 0.5 * min(steps, 6000) + (steps == 400) * 100


def test_two_resolutions_begin_where_they_are_told() -> None:
    by_kind = dataclasses.replace(BY_KIND["object"], stage_starts=(0.0, 0.5), prunings=())
    assert schedule(by_kind, 1000, (32, 64)) == {0: 32, 500: 64}


def test_runs_of_before_random_backgrounds_keep_the_scenes_own(dataset: RayDataset) -> None:
    stored = to_json(CPU)
    assert from_json(TrainConfig, stored, "config.json").voxels.random_background
    del stored["voxels"]["random_background"]
    older = from_json(TrainConfig, stored, "config.json")
    assert older == dataclasses.replace(CPU, voxels=dataclasses.replace(CPU.voxels, random_background=False))
    assert dataset.kind == "object"
    drawn = [settings_of(config, dataset, plan_of(config, dataset)).random_background for config in (CPU, older)]
    assert drawn == [True, False]


@pytest.mark.parametrize("resolutions", [(64,), (64, 96), (64, 96, 128, 160, 192)])
def test_resolutions_without_a_start_for_each_are_refused_in_one_line(
    dataset: RayDataset, resolutions: tuple[int, ...]
) -> None:
    with pytest.raises(UserError) as raised:
        plan_of(dataclasses.replace(CPU, voxels=VoxelConfig(resolutions=resolutions)), dataset)
    told = str(raised.value)
    assert "--voxels.resolutions" in told and "3 or 4" in told and "--voxels.stage-starts" in told
