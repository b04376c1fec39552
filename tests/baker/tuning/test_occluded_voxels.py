"""What little light reaches is like its neighbour, and everything else is as it was."""

from __future__ import annotations

import numpy as np
import pytest

from baker.tuning.occluded_voxels import HIDDEN, follow_neighbours, smooth_hidden
from baker.tuning.pruning import ArrivingTransmittance
from scenepack import Pack, save_pack
from scenepack.blocks import dense_from_pack
from scenepack.codecs.quantisation import EXACT, Steps, steps_of
from scenepack.piece_files import follows_grid
from tests.baker.tuning.helpers import pack_of
from tests.scenepack.test_quantisation import in_steps

STEPS = Steps(4, 12, 8)


@pytest.fixture
def pack() -> Pack:
    return in_steps(pack_of(), STEPS.colour, STEPS.feature, STEPS.alpha)


def light(pack: Pack, *, hidden: bool) -> ArrivingTransmittance:
    """Little light on all of the pack, or full light on its far half along x and little on the rest."""
    size, blocks = pack.block_size, pack.occupied.shape
    arriving = np.full([n * size for n in blocks], HIDDEN[0] - 1, np.uint8)
    if not hidden:
        arriving[:, :, arriving.shape[2] // 2 :] = 255
    return ArrivingTransmittance(arriving, size, 0)


def test_only_what_little_light_reaches_changes_and_no_alpha_does(pack: Pack) -> None:
    half = light(pack, hidden=False)
    before, of_features = (volume.copy() for volume in dense_from_pack(pack))
    after, features = dense_from_pack(follow_neighbours(pack, half, STEPS, HIDDEN[0]))
    lit = half.transmittance[tuple(slice(n) for n in before.shape[:3])] == 255
    assert np.array_equal(after[lit], before[lit]) and np.array_equal(features[lit], of_features[lit])
    assert np.array_equal(after[..., 3], before[..., 3])
    shown = ~lit & (before[..., 3] > 0)
    assert np.any(after[shown] != before[shown], axis=-1).mean() > 0.5


def test_a_hidden_voxel_has_the_counts_of_the_one_before_it_as_far_as_its_alpha_allows(pack: Pack) -> None:
    after, features = dense_from_pack(follow_neighbours(pack, light(pack, hidden=True), STEPS, HIDDEN[0]))
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
    assert smooth.atlas_features is not None
    assert np.all(smooth.atlas_rgba[..., :3] <= smooth.atlas_rgba[..., 3:])
    assert np.all(smooth.atlas_features <= smooth.atlas_rgba[..., 3:])
    assert steps == EXACT or steps_of(smooth.atlas_rgba, smooth.atlas_features) == steps
    assert all(follows_grid(smooth, part) for part in (smooth.atlas_rgba, smooth.atlas_features))


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
