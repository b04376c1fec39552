"""Which voxels are emptied because no training view shows enough of them."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np

from baker.baking.culling import cull
from baker.baking.grid import make_grid
from baker.tuning import pruning
from baker.tuning.pruning import closing_gain, prune
from scenepack import Pack, check_pack
from scenepack.blocks import atlas_from_dense, dense_from_pack
from tests.baker.analytic import RADIUS, ball
from tests.baker.baking.test_grid_and_culling import baked
from tests.scenepack.random_packs import BLENDER_FRAME

HAZE = 2  # of 255


def hazy_ball(dataset) -> tuple[Pack, np.ndarray]:
    """The baked ball in thin haze that fills its grid of 4³ macroblocks, and each voxel's distance from the middle."""
    grid = make_grid(np.full(3, -1.5), np.full(3, 1.5), 56, 14, BLENDER_FRAME)
    pack = baked(cull(ball, grid, dataset), grid)
    rgba, features = dense_from_pack(pack)
    empty = rgba[..., 3] == 0
    rgba[empty] = (0, 0, HAZE, HAZE)
    atlas = atlas_from_dense(rgba, features, grid.block_size)
    centres = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in rgba.shape[:3]), indexing="ij"), -1)
    distance = np.linalg.norm(centres[..., ::-1] * pack.voxel_size + pack.min_xyz, axis=-1)
    return replace(pack, atlas_indices=atlas[0], atlas_rgba=atlas[1], atlas_features=atlas[2]), distance


def test_haze_and_the_hidden_middle_go_and_what_cameras_see_stays(dataset) -> None:
    pack, distance = hazy_ball(dataset)
    before = dense_from_pack(pack)[0]
    thinner, figures = prune(pack, dataset, tau_weight=0.02)
    after, features = dense_from_pack(thinner)
    assert features is not None
    stays = after[..., 3] > 0
    assert np.all(after[stays] >= before[stays]), "what stays is as it was, or denser"
    assert not features[~stays].any() and not after[~stays].any()
    voxel = pack.voxel_size
    assert not stays[distance > RADIUS + 3 * voxel].any(), "haze goes"
    assert not stays[distance < RADIUS - 4 * voxel].any(), "nobody sees the middle"
    lit = stays & (distance > RADIUS + 0.2 * voxel) & (np.arange(len(stays)) > 0.7 * len(stays))[:, None, None]  # above
    assert lit.any() and np.array_equal(after[lit], before[lit]), "what is in full light is as it was"
    shell = (np.abs(distance - RADIUS) < 0.5 * voxel) & (before[..., 3] > 100)
    assert stays[shell].mean() > 0.6, "cameras look from above"
    assert figures.voxels_before == np.count_nonzero(before[..., 3]) and figures.voxels_after == stays.sum()
    assert figures.macroblocks == pack.occupied.sum() - thinner.occupied.sum() > 0
    assert all(finding.severity in ("ok", "note") for finding in check_pack(thinner))


def test_a_lower_threshold_keeps_the_haze_in_front_of_the_ball_and_none_goes_twice(dataset) -> None:
    pack, distance = hazy_ball(dataset)
    thin = prune(pack, dataset, tau_weight=0.001)[0]
    stays = dense_from_pack(thin)[0][..., 3] > 0
    assert stays[distance > RADIUS + 4 * pack.voxel_size].mean() > 0.1
    once = prune(thin, dataset, tau_weight=0.02)[1]
    again = prune(prune(hazy_ball(dataset)[0], dataset, 0.02)[0], dataset, 0.02)[1]
    assert once.voxels_after < once.voxels_before
    assert again.voxels_after > 0.85 * again.voxels_before, "a pack that was thinned has little left to lose"


def test_a_pack_that_no_camera_sees_is_left_alone(dataset) -> None:
    pack, _ = hazy_ball(dataset)
    away = replace(pack, min_xyz=np.asarray(pack.min_xyz) + 100.0)
    untouched, figures = prune(away, dataset)
    assert untouched is away and figures.voxels_after == figures.voxels_before > 0


def test_what_little_light_arrives_at_gets_denser_and_keeps_its_colour() -> None:
    alpha, transmittance = np.full(4, 51, np.uint8), np.array([255, 77, 38, 3], np.uint8)
    made = alpha * closing_gain(alpha, transmittance)
    assert np.all(np.round(made[:2]) == 51), "with a transmittance above HIDDEN nothing changes"
    assert 51 < made[2] < made[3] <= 255
    np.testing.assert_allclose(made[3] / 255, 1 - 0.8**20, rtol=0.02)


def test_early_termination_changes_nothing_but_the_work(dataset, monkeypatch) -> None:
    pack, _ = hazy_ball(dataset)
    taken = []
    march = pruning.march

    def counting(*arguments):
        samples = march(*arguments)
        jax.debug.callback(lambda valid: taken.append(int(valid.sum())), samples.valid)
        return samples

    monkeypatch.setattr(pruning, "march", counting)
    found = []
    for depth_where in (pruning.depth_where, lambda transmittance: None):
        monkeypatch.setattr(pruning, "depth_where", depth_where)
        jax.clear_caches()
        taken.clear()
        found.append((pruning._transmittance(pack, dataset, 0.02, 0, None), sum(taken)))
    jax.clear_caches()
    (ended, fewer), (whole, all_of_them) = found
    assert np.array_equal(ended, whole)
    assert 0 < fewer < 0.9 * all_of_them
