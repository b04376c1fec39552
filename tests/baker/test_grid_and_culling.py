"""Where voxels lie, and which macroblocks are dropped."""

from __future__ import annotations

import numpy as np
import pytest

from baker.culling import content_box, cull
from baker.grid import box_in_grid_frame, make_grid
from baker.supersample import BlockStore, supersample
from console import UserError
from tests.baker.analytic import COLOUR, DENSITY, FEATURES, RADIUS, ball, nothing
from tests.scenepack.random_packs import BLENDER_FRAME

LOW, HIGH = np.full(3, -1.5), np.full(3, 1.5)


def test_the_box_in_the_grid_frame_holds_the_same_points() -> None:
    aabb = np.array([[-1.0, -2.0, -3.0], [0.5, 1.0, 4.0]])
    low, high = box_in_grid_frame(aabb, BLENDER_FRAME)
    grid_T_world = np.linalg.inv(BLENDER_FRAME)[:3, :3]
    points = np.random.default_rng(0).uniform(aabb[0], aabb[1], (100, 3)) @ grid_T_world.T
    assert np.all(points >= low - 1e-9) and np.all(points <= high + 1e-9)
    np.testing.assert_allclose(np.sort(high - low), np.sort(aabb[1] - aabb[0]))


def test_the_grid_covers_its_box_with_whole_blocks_and_stays_centred() -> None:
    grid = make_grid(np.array([0.0, 0, 0]), np.array([2.0, 1.0, 0.1]), 100, 30, BLENDER_FRAME)
    assert grid.voxel_size == pytest.approx(0.02)
    assert grid.blocks == (4, 2, 1)
    far = grid.min_xyz + np.array(grid.size) * grid.voxel_size
    assert np.all(grid.min_xyz <= 0) and np.all(far >= [2.0, 1.0, 0.1])
    np.testing.assert_allclose(grid.min_xyz + far, [2.0, 1.0, 0.1], atol=1e-9)


def test_more_than_254_blocks_an_axis_are_refused_in_one_line() -> None:
    with pytest.raises(UserError, match=r"--resolution.*at most 7620"):
        make_grid(LOW, HIGH, 7700, 30, BLENDER_FRAME)


def test_the_content_box_fits_the_ball_within_a_probe_cell() -> None:
    box = content_box(ball, LOW, HIGH, 120, BLENDER_FRAME)
    assert box is not None
    cell = 3.0 / 120
    assert np.all(np.abs(box[0] + RADIUS) < 2.5 * cell) and np.all(np.abs(box[1] - RADIUS) < 2.5 * cell)
    assert content_box(nothing, LOW, HIGH, 64, BLENDER_FRAME) is None


def test_a_floating_speck_does_not_stretch_the_box() -> None:
    def with_speck(points: np.ndarray):
        field = ball(points)
        speck = np.linalg.norm(points - np.array([1.4, 1.4, 1.4]), axis=-1) < 0.03
        return field._replace(density=field.density + 400.0 * speck)

    box = content_box(with_speck, LOW, HIGH, 120, BLENDER_FRAME)
    assert box is not None and np.all(box[1] < 1.2 * RADIUS) and np.all(box[0] > -1.2 * RADIUS)
    assert np.all(box[1] >= RADIUS - 0.03) and np.all(box[0] <= -RADIUS + 0.03)


def test_culling_keeps_the_shell_of_an_opaque_ball_and_drops_air_and_the_hidden_middle(dataset) -> None:
    grid = make_grid(LOW * 0.7, HIGH * 0.7, 360, 30, BLENDER_FRAME)  # 12 blocks a side; the ball's radius is 4.6 blocks
    culling = cull(ball, grid, dataset)
    centres = (
        np.stack(np.meshgrid(*(np.arange(12),) * 3, indexing="ij"), -1) + 0.5
    ) * 30 * grid.voxel_size + grid.min_xyz[0]
    distance, diagonal = np.linalg.norm(centres, axis=-1), 30 * grid.voxel_size * np.sqrt(3) / 2
    assert not culling.kept[distance > RADIUS + diagonal].any(), "air is dropped"
    middle = distance < RADIUS - 2.2 * diagonal
    assert middle.sum() >= 8 and not culling.kept[middle].any(), "the hidden middle is dropped"
    assert culling.hidden >= middle.sum() and culling.opaque - culling.hidden == culling.kept.sum()
    facing = np.abs(distance - RADIUS) < 0.2 * diagonal
    seen = facing & (centres[..., 0] > 0)  # grid z up in z, y, x order: what the cameras above look at
    assert culling.kept[facing & seen].mean() > 0.6


def test_supersampled_voxels_are_premultiplied_rounded_and_antialiased(dataset) -> None:
    grid = make_grid(np.full(3, -0.9), np.full(3, 0.9), 60, 30, BLENDER_FRAME)
    culling = cull(ball, grid, dataset)
    store = supersample(ball, grid, culling)
    rgba, features = store.read_box((0, 0, 0), (60, 60, 60))
    alpha = rgba[..., 3].astype(float) / 255
    full = 1 - np.exp(-DENSITY * grid.voxel_size)
    solid = alpha > 0.999 * full - 0.5 / 255
    assert solid.any()
    np.testing.assert_allclose(rgba[solid][:, :3], np.round(255 * COLOUR * full) * np.ones((solid.sum(), 1)), atol=1)
    np.testing.assert_allclose(features[solid], np.round(255 * FEATURES * full) * np.ones((solid.sum(), 1)), atol=1)
    edge = (alpha > 0.02) & ~solid
    assert edge.any(), "the border of the ball is averaged, not a staircase"
    np.testing.assert_allclose(rgba[edge][:, :3] / 255, alpha[edge][:, None] * COLOUR, atol=1.01 / 255)


def test_a_block_store_reads_boxes_across_blocks_and_zeros_where_nothing_was_kept() -> None:
    rng = np.random.default_rng(0)
    kept = rng.random((2, 3, 2)) < 0.6
    store = BlockStore(kept, 4)
    store.voxels[:] = rng.integers(0, 256, store.voxels.shape)
    dense = np.zeros((8, 12, 8, 8), np.uint8)
    for slot, (k, j, i) in enumerate(np.argwhere(kept)):
        dense[4 * k : 4 * k + 4, 4 * j : 4 * j + 4, 4 * i : 4 * i + 4] = store.voxels[slot]
    rgba, features = store.read_box((1, 2, 0), (8, 11, 7))
    assert np.array_equal(np.concatenate([rgba, features], -1), dense[1:8, 2:11, 0:7])
