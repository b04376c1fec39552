"""Which voxels are emptied because no training view shows enough of them."""

from dataclasses import replace

import numpy as np
import pytest

from baker.baking.grid import make_grid
from baker.tuning import pruning
from baker.tuning.pruning import HIDDEN, Pruned, arriving_transmittance, follow_neighbours, prune, smooth_hidden
from scenepack import Pack, check_pack, save_pack
from scenepack.blocks import dense_from_pack
from scenepack.codecs.quantisation import EXACT, Steps, steps_of
from scenepack.piece_files import follows_grid
from tests.baker.analytic import RADIUS, ball, culled
from tests.baker.baking.test_grid_and_culling import baked
from tests.baker.tuning.reference import pack_of
from tests.scenepack.test_codecs import in_steps
from tests.scenepack.volumes import BLENDER_FRAME, atlas_from_dense, centres, cube_pack, dense_of, features_of
from training.dataset import RayDataset
from training.scenes import Scene

HAZE = 2  # of 255


def emptied(pack: Pack, dataset: RayDataset, tau_weight: float) -> tuple[Pack, Pruned]:
    """The pack pruned, whatever it costs."""
    light = arriving_transmittance(pack, dataset, 0)
    assert light is not None
    return prune(pack, light, lambda _: 0.0, 0.0, tau_weight)


def hazy_ball(dataset) -> tuple[Pack, np.ndarray]:
    """The baked ball in thin haze that fills its grid of 4³ macroblocks, and each voxel's distance from the middle."""
    grid = make_grid(np.full(3, -1.5), np.full(3, 1.5), 56, 14, BLENDER_FRAME)
    pack = baked(culled(ball, grid, dataset), grid)
    rgba, features = dense_from_pack(pack)
    empty = rgba[..., 3] == 0
    rgba[empty] = (0, 0, HAZE, HAZE)
    atlas = atlas_from_dense(rgba, features, grid.block_size)
    places = np.moveaxis(np.indices(rgba.shape[:3]), 0, -1) + 0.5
    distance = np.linalg.norm(places[..., ::-1] * pack.voxel_size + pack.min_xyz, axis=-1)
    return replace(pack, atlas_indices=atlas[0], atlas_rgba=atlas[1], atlas_features=atlas[2]), distance


def test_haze_and_the_hidden_middle_go_and_what_cameras_see_stays(dataset) -> None:
    pack, distance = hazy_ball(dataset)
    before = dense_from_pack(pack)[0]
    thinner, figures = emptied(pack, dataset, 0.02)
    after, features = dense_of(thinner)
    stays = after[..., 3] > 0
    assert np.all(after[stays] >= before[stays]), "what stays is as it was, or denser"
    assert not features[~stays].any() and not after[~stays].any()
    voxel = pack.voxel_size
    assert not stays[distance > RADIUS + 3 * voxel].any(), "haze goes"
    assert not stays[distance < RADIUS - 5.5 * voxel].any(), "nobody sees the middle"
    lit = stays & (distance > RADIUS + 0.2 * voxel) & (np.arange(len(stays)) > 0.7 * len(stays))[:, None, None]  # above
    assert lit.any() and np.array_equal(after[lit], before[lit]), "what is in full light is as it was"
    shell = (np.abs(distance - RADIUS) < 0.5 * voxel) & (before[..., 3] > 100)
    assert stays[shell].mean() > 0.6, "cameras look from above"
    assert figures.voxels_before == np.count_nonzero(before[..., 3]) and figures.voxels_after == stays.sum()
    assert figures.macroblocks == pack.occupied.sum() - thinner.occupied.sum() > 0
    assert all(finding.severity in ("ok", "note") for finding in check_pack(thinner))


def test_no_more_is_emptied_than_the_score_allows(dataset) -> None:
    """Mist of many voxels that show little each: together they are what photographs show."""
    pack, _ = hazy_ball(dataset)

    def lost_mist(thinner: Pack) -> float:
        return float(np.count_nonzero(thinner.atlas_rgba[..., 3] == HAZE))

    tau = 0.014  # full light keeps the mist of 2 / 255 at half of that
    hard, milder, mild = (emptied(pack, dataset, part * tau) for part in (1, 0.5, 0.25))
    most, light = lost_mist(pack), arriving_transmittance(pack, dataset, 0)
    assert light is not None
    assert most > lost_mist(mild[0]) > lost_mist(milder[0]) > lost_mist(hard[0])
    for allowed, expected in ((1e9, hard), (most - lost_mist(milder[0]), milder), (most - lost_mist(mild[0]), mild)):
        thinner, figures = prune(pack, light, lost_mist, allowed, tau)
        assert np.array_equal(thinner.atlas_rgba, expected[0].atlas_rgba) and figures == expected[1]
    untouched, figures = prune(pack, light, lost_mist, 0.0, tau)
    assert untouched is pack and figures.tau_weight == 0 and figures.voxels_after == figures.voxels_before > 0


def shown(pack: Pack, places: np.ndarray, scene: Scene, slope: float = 0.7) -> np.ndarray:
    """bool [N]: which voxels of a ball about the origin some training camera sees, no more aslant than `slope`."""
    at = ((places[:, ::-1] + 0.5) * pack.voxel_size + pack.min_xyz) @ pack.worldspace_T_opengl[:3, :3].T
    eyes = np.stack([photograph.camera.world_T_camera[:3, 3] for photograph in scene.splits["train"]])
    to = eyes[:, None] - at
    facing = (to * at).sum(-1) / np.linalg.norm(to, axis=-1) / np.linalg.norm(at, axis=-1)
    return (facing > slope).any(0)


def test_no_voxel_of_a_surface_that_photographs_show_is_emptied_however_fine_it_is(dataset, scene, monkeypatch) -> None:
    reach, side = 1.1 * RADIUS, 140  # an opaque ball in a fine grid about it
    distance = reach * np.sqrt(np.square(centres(side)).sum(axis=0))
    rgba = np.where(distance[..., None] < RADIUS, np.array([200, 100, 50, 255], np.uint8), np.uint8(0))
    pack = cube_pack(rgba, 14, features=np.zeros_like(rgba))
    pack = replace(pack, voxel_size=2 * reach / side, min_xyz=np.full(3, -reach))
    surface = np.argwhere((distance < RADIUS) & (distance > RADIUS - 0.9 * pack.voxel_size))  # z, y, x
    # fewer than a voxel of the surface has: as 1000³ of many photographs
    monkeypatch.setattr(pruning, "MOST_RAYS", 4000)
    seen = surface[shown(pack, surface, scene)]
    assert len(seen) > 4 * pruning.MOST_RAYS, "this many voxels cannot all have a ray of their own"
    before = np.count_nonzero(dense_from_pack(pack)[0][..., 3])
    thinner, figures = emptied(pack, dataset, 0.0085)
    stays = dense_from_pack(thinner)[0][..., 3] > 0
    assert stays[tuple(seen.T)].all()
    assert figures.voxels_before == before and figures.voxels_after < 0.8 * before, "what lies inside goes"


STEPS = Steps(4, 12, 8)


@pytest.fixture
def pack() -> Pack:
    return in_steps(pack_of(), STEPS.colour, STEPS.feature, STEPS.alpha)


def light(pack: Pack, *, hidden: bool) -> np.ndarray:
    """Little light on all of the pack, or full light on its far half along x and little on the rest."""
    size = pack.block_size
    dense = np.full([n * size for n in pack.occupied.shape], HIDDEN[0] - 1, np.uint8)
    if not hidden:
        dense[:, :, dense.shape[2] // 2 :] = 255
    return np.stack([dense[z : z + size, y : y + size, x : x + size] for z, y, x in np.argwhere(pack.occupied) * size])


def test_only_what_little_light_reaches_changes_and_no_alpha_does(pack: Pack) -> None:
    half = light(pack, hidden=False)
    before, of_features = (volume.copy() for volume in dense_of(pack))
    after, features = dense_of(follow_neighbours(pack, half, STEPS, HIDDEN[0]))
    middle = pack.occupied.shape[2] * pack.block_size // 2
    lit = np.broadcast_to(np.arange(before.shape[2]) >= middle, before.shape[:3])
    assert np.array_equal(after[lit], before[lit]) and np.array_equal(features[lit], of_features[lit])
    assert np.array_equal(after[..., 3], before[..., 3])
    shown = ~lit & (before[..., 3] > 0)
    assert np.any(after[shown] != before[shown], axis=-1).mean() > 0.5


def test_a_hidden_voxel_has_the_counts_of_the_one_before_it_as_far_as_its_alpha_allows(pack: Pack) -> None:
    after, features = dense_of(follow_neighbours(pack, light(pack, hidden=True), STEPS, HIDDEN[0]))
    row, own = after[:, :, :-1], after[:, :, 1:]
    seen = (row[..., 3] > 0) & (own[..., 3] > 0)
    expected = np.minimum(-(row[seen][:, :3].astype(int) // -STEPS.colour) * STEPS.colour, own[seen][:, 3:])
    assert seen.any() and np.array_equal(own[seen][:, :3], expected)
    expected = np.minimum(-(features[:, :, :-1][seen].astype(int) // -STEPS.feature) * STEPS.feature, own[seen][:, 3:])
    assert np.array_equal(features[:, :, 1:][seen], expected)


@pytest.mark.parametrize("steps", [EXACT, STEPS])
def test_values_stay_in_their_steps_below_alpha_and_padding_follows(steps: Steps) -> None:
    pack = pack_of()
    if steps != EXACT:
        pack = in_steps(pack, steps.colour, steps.feature, steps.alpha)
    smooth = follow_neighbours(pack, light(pack, hidden=True), steps, HIDDEN[0])
    rgba, features = smooth.atlas_rgba, features_of(smooth)
    assert np.all(rgba[..., :3] <= rgba[..., 3:]) and np.all(features <= rgba[..., 3:])
    assert steps == EXACT or steps_of([rgba, features]) == steps
    assert follows_grid(smooth, rgba) and follows_grid(smooth, features)


def test_it_takes_fewer_bytes(pack: Pack, tmp_path) -> None:
    def stored() -> int:
        save_pack(pack, tmp_path / "pack", codec="webp")
        return sum(file.stat().st_size for file in (tmp_path / "pack").glob("*.webp"))

    before = stored()
    pack = follow_neighbours(pack, light(pack, hidden=True), STEPS, HIDDEN[0])
    assert stored() < 0.8 * before


@pytest.mark.parametrize(("costs", "taken"), [((0.01,), 128), ((4.0, 0.2, 0.02), 32), ((4.0, 2.0, 1.0), 0)])
def test_photographs_decide_how_much_light_is_little(pack: Pack, costs: tuple[float, ...], taken: int) -> None:
    """In mist, half of what is seen lies where half of the light is gone: fern lost 2.6 dB of training rays."""
    scores = iter([30.0, *(30.0 - cost for cost in costs)])
    before = pack.atlas_rgba.copy()
    smooth, below = smooth_hidden(pack, light(pack, hidden=False), STEPS, lambda _: next(scores), 0.03)
    assert below == taken and next(scores, None) is None
    assert np.array_equal(pack.atlas_rgba, before), "what is given is left alone"
    assert (smooth is pack) == (taken == 0)
