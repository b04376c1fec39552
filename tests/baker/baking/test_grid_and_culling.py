"""Where voxels lie, and which macroblocks are dropped."""

import re
from contextlib import suppress
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from baker.baking import bake as baking
from baker.baking.config import BakeConfig
from baker.baking.grid import make_grid
from baker.baking.supersample import Sampler, supersample
from baker.baking.work_folder import WorkFolder
from baker.tuning import marcher
from baker.tuning.pruning import arriving_transmittance
from console import Notice
from scenepack import Pack
from scenepack.blocks import fill_atlas, restore_padding
from tests.baker.analytic import COLOUR, DENSITY, FEATURES, RADIUS, ball, culled
from tests.scenepack.helpers import same_pack
from tests.scenepack.volumes import BLENDER_FRAME, dense_of, features_of
from training.dataset import RayDataset

pytestmark = pytest.mark.usefixtures("hardly_optimised")

LOW, HIGH = np.full(3, -1.5), np.full(3, 1.5)
GRID = make_grid(0.6 * LOW, 0.6 * HIGH, 60, 30, BLENDER_FRAME)


def test_the_grid_covers_its_box_with_whole_blocks_and_stays_centred() -> None:
    grid = make_grid(np.array([0.0, 0, 0]), np.array([2.0, 1.0, 0.1]), 100, 30, BLENDER_FRAME)
    assert grid.voxel_size == pytest.approx(0.02)
    assert grid.blocks == (4, 2, 1)
    far = grid.min_xyz + np.array(grid.size) * grid.voxel_size
    assert np.all(grid.min_xyz <= 0) and np.all(far >= [2.0, 1.0, 0.1])
    np.testing.assert_allclose(grid.min_xyz + far, [2.0, 1.0, 0.1], atol=1e-9)


def test_culling_keeps_the_shell_of_an_opaque_ball_and_drops_air_and_the_hidden_middle(dataset) -> None:
    grid = make_grid(LOW * 0.7, HIGH * 0.7, 120, 10, BLENDER_FRAME)  # 12 blocks a side; the ball's radius is 4.6 blocks
    culling = culled(ball, grid, dataset)
    centres = (np.moveaxis(np.indices((12, 12, 12)), 0, -1) + 0.5) * 10 * grid.voxel_size + grid.min_xyz[0]
    distance, diagonal = np.linalg.norm(centres, axis=-1), 10 * grid.voxel_size * np.sqrt(3) / 2
    assert not culling.kept[distance > RADIUS + diagonal].any(), "air is dropped"
    middle = distance < RADIUS - 2.2 * diagonal
    assert middle.sum() >= 8 and not culling.kept[middle].any(), "the hidden middle is dropped"
    assert culling.hidden >= middle.sum() and culling.opaque - culling.hidden == culling.kept.sum()
    facing = np.abs(distance - RADIUS) < 0.2 * diagonal
    seen = facing & (centres[..., 0] > 0)  # grid z up in z, y, x order: what the cameras above look at
    assert culling.kept[facing & seen].mean() > 0.6


@pytest.mark.slow
def test_a_grid_of_more_macroblocks_than_cards_hold_is_made_coarser(scene, dataset, monkeypatch, tmp_path):
    monkeypatch.setattr(baking, "field_query", lambda run: ball)
    method = SimpleNamespace(may_hold=lambda state, low, high: None)
    run = SimpleNamespace(scene=scene, dataset=dataset, path=tmp_path, method=method, state=None)
    work = WorkFolder(tmp_path / "work", {"bake": 1})

    def kept_of(most: int) -> tuple[int, int]:
        job = baking.Bake(run, BakeConfig(120, most_macroblocks=most), work)  # type: ignore[arg-type]
        grid, culling = baking.culled_grid(job)
        return grid.resolution, int(culling.kept.sum())

    resolution, kept = kept_of(6000)
    assert resolution == 120
    with pytest.warns(Notice, match=f"120 voxels would keep {kept} macroblocks.*--most-macroblocks {kept}"):
        coarser, fewer = kept_of(kept // 2)
    assert 30 <= coarser < 120 and fewer <= kept // 2
    work.remove()


def baked(culling, grid, work=None, field=ball, on_share=lambda share: None) -> Pack:
    """What supersample gives, as a pack of its own."""
    atlas = fill_atlas(supersample(Sampler(field, grid, culling), on_share, work), culling.kept, grid.block_size)
    pack = Pack(grid.voxel_size, grid.min_xyz, grid.size, grid.block_size, *atlas, None, BLENDER_FRAME)
    for part in (pack.atlas_rgba, features_of(pack)):
        restore_padding(part, pack.atlas_indices, pack.block_size)
    return pack


def test_supersampled_voxels_are_premultiplied_rounded_and_antialiased(dataset) -> None:
    rgba, features = dense_of(baked(culled(ball, GRID, dataset), GRID))
    alpha = rgba[..., 3].astype(float) / 255
    full = 1 - np.exp(-DENSITY * GRID.voxel_size)
    solid = alpha > 0.999 * full - 0.5 / 255
    assert solid.any()
    np.testing.assert_allclose(rgba[solid][:, :3], np.round(255 * COLOUR * full) * np.ones((solid.sum(), 1)), atol=1)
    np.testing.assert_allclose(features[solid], np.round(255 * FEATURES * full) * np.ones((solid.sum(), 1)), atol=1)
    edge = (alpha > 0.02) & ~solid
    assert edge.any(), "the border of the ball is averaged, not a staircase"
    np.testing.assert_allclose(rgba[edge][:, :3] / 255, alpha[edge][:, None] * COLOUR, atol=1.01 / 255)
    centres = np.argwhere(solid) + 0.5 - 30
    assert np.linalg.norm(centres * GRID.voxel_size, axis=1).max() < RADIUS, "voxels lie where the ball is"


@pytest.mark.slow
def test_a_field_no_finer_than_the_grid_is_asked_once_a_voxel_and_stays_as_sharp_as_it_is(dataset) -> None:
    """What the paper's samples average out of an MLP, a field that is smooth within its cells never had."""
    culling, asked = culled(ball, GRID, dataset), []

    def ramp(points: np.ndarray):
        asked.append(points)
        return ball(points)._replace(density=60 * (1 + np.sin(points[:, 0] * 40)))  # type: ignore[arg-type]

    blocks = dict(supersample(Sampler(ramp, GRID, culling, np.full(3, GRID.voxel_size))))
    points = np.concatenate(asked)
    voxels = (points @ GRID.worldspace_T_opengl[:3, :3] - GRID.min_xyz) / GRID.voxel_size
    np.testing.assert_allclose(voxels % 1, 0.5, atol=1e-3)
    assert len(np.unique(np.floor(voxels), axis=0)) == len(voxels), "each once"
    place, content = next(iter(blocks.items()))
    z, y, x = np.nonzero(content[..., 3])
    centres = GRID.training_points(np.stack([x, y, z], -1) + 0.5 + np.array(place)[::-1] * 30)
    alpha = 1 - np.exp(-ramp(centres).density * GRID.voxel_size)
    np.testing.assert_allclose(content[z, y, x, 3], 255 * alpha, atol=0.51)


@pytest.mark.slow
def test_a_bake_that_was_killed_goes_on_and_ends_with_the_same_voxels(dataset, tmp_path, monkeypatch) -> None:
    grid = make_grid(np.full(3, -0.9), np.full(3, 0.9), 90, 30, BLENDER_FRAME)
    monkeypatch.setattr("baker.baking.supersample.BLOCKS_AT_ONCE", 5)
    whole = baked(culled(ball, grid, dataset), grid)
    asked = 0

    def mortal(points: np.ndarray):
        nonlocal asked
        asked += len(points)
        if asked > limit:
            raise KeyboardInterrupt
        return ball(points)

    limit, times, last = 0, 0, None
    reported: list[float] = []
    while last is None:
        times += 1
        assert times < 60, "each try must get further"
        asked, limit = 0, 2_500_000 + 10 * times  # points before the next kill
        reported.clear()
        work = WorkFolder(tmp_path / "work", {"bake": 1})
        with suppress(KeyboardInterrupt):
            last = baked(culled(mortal, grid, dataset, work), grid, work, mortal, reported.append)
        work.close()
    assert times >= 3
    assert 0 < reported[0] < reported[-1] == 1.0  # the first progress counts what was made before
    assert same_pack(last, whole)


# Geometry is computed in float32 on every card: products ask for the highest precision, where NVIDIA's default is TF32. It is
# read in the programs themselves, so that no card is needed.


def precisions(program: str) -> list[str]:
    """Of each product of a program (StableHLO text): the precision asked of its first operand."""
    products = re.findall(r"stablehlo\.dot_general.*", program)
    return [(re.search(r"precision = \[(\w+), \w+\]", product) or [product, "DEFAULT"])[1] for product in products]


def test_the_products_that_make_training_rays_ask_for_the_highest_precision(dataset: RayDataset) -> None:
    geometry_at = jax.jit(lambda dataset, ids: dataset.geometry_at(ids))
    assert precisions(geometry_at.lower(dataset, jnp.arange(8, dtype=jnp.int32)).as_text()) == ["HIGHEST"]


def test_so_do_those_of_culling_and_pruning(dataset: RayDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    programs, function = [], marcher._in_grid

    def recorded(*arguments):
        programs.append(function.lower(*arguments).as_text())
        return function(*arguments)

    monkeypatch.setattr(marcher, "_in_grid", recorded)
    culling = culled(ball, GRID, dataset)
    first = len(programs)
    arriving_transmittance(baked(culling, GRID), dataset, 0)
    assert len(programs) > first > 0
    for program in programs:
        assert len(precisions(program)) >= 3, "rays are made, and moved into the grid's frame"
        assert set(precisions(program)) == {"HIGHEST"}
