"""Choosing voxels and taking them away: each selector against the same on a dense grid, and packs without what was chosen."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from scipy import ndimage

from console import UserError
from scenepack import Pack, check_pack, load_pack, save_pack
from scenepack.blocks import dense_from_pack
from scenepack.editing import Selection, Voxels, without
from scenepack.exports.field import ExportFrame
from tests.scenepack.helpers import small_pack, smooth_pack
from tests.scenepack.volumes import dense_of

TOUCHING = np.ones((3, 3, 3))


@pytest.fixture(params=["specks", "shell", "contracted", "forward-facing"])
def pack(request) -> Pack:
    """Noise in a few macroblocks: many parts, and some that only hang together across macroblocks."""
    if request.param == "shell":
        return smooth_pack()
    made = small_pack(occupancy=0.06)
    whole = Voxels(made).everything()
    thinned = without(made, Selection({4: whole.bits[4]}), [])  # one macroblock between others is empty
    if request.param == "contracted":
        half = 0.5 * made.voxel_size * np.array(made.grid_size)
        return replace(thinned, min_xyz=-half).with_metadata(contraction=0.6 * half.min())
    if request.param == "forward-facing":
        camera = {"input_width": 100.0, "input_height": 80.0, "input_focal": 90.0}
        frame = np.diag([1.0, 1.0, -1.0, 1.0])
        return replace(thinned, ndc=True, min_xyz=np.full(3, -1.0), voxel_size=0.1, worldspace_T_opengl=frame, **camera)
    return thinned


def dense(pack: Pack, selection: Selection) -> np.ndarray:
    """bool [z, y, x] of the whole grid."""
    voxels, size = Voxels(pack), pack.block_size
    grid = np.zeros([n * size for n in pack.occupied.shape], bool)
    for number, place in enumerate(voxels.places):
        grid[tuple(slice(i * size, (i + 1) * size) for i in place)] = voxels.mask(selection, number)
    x, y, z = pack.grid_size
    return grid[:z, :y, :x]


def alphas(pack: Pack) -> np.ndarray:
    return dense_from_pack(pack)[0][..., 3]


def centres(pack: Pack) -> np.ndarray:
    """Of all voxels, in the grid frame: float64 [z, y, x, 3]."""
    z, y, x = np.indices(alphas(pack).shape)
    positions = np.stack([x, y, z], axis=-1).reshape(-1, 3) + 0.5
    with np.errstate(all="ignore"):
        return ExportFrame(pack).points(positions).reshape(*z.shape, 3)


def test_every_selector_chooses_what_it_would_on_a_dense_grid(pack):
    voxels, alpha, at = Voxels(pack), alphas(pack), centres(pack)
    some = alpha > 0
    assert np.array_equal(dense(pack, voxels.everything()), some) and voxels.everything().count == some.sum() > 0
    assert np.array_equal(dense(pack, voxels.fainter_than(0.4)), some & (alpha < 0.4 * 255))
    middle = np.median(at[some], axis=0)
    away = np.linalg.norm(at - middle, axis=-1)
    for radius in 1.0001 * np.quantile(away[some], [0.05, 0.5]):  # between voxels
        chosen = voxels.in_sphere(middle, radius)
        assert np.array_equal(dense(pack, chosen), some & (away <= radius)) and 0 < chosen.count < some.sum()
        ball = voxels.in_ball(np.array([9.3, 8.1, 7.7]), 5.2)
        z, y, x = np.indices(some.shape) + 0.5
        near = np.square(np.stack([x - 9.3, y - 8.1, z - 7.7])).sum(axis=0) <= 5.2**2
        assert np.array_equal(dense(pack, ball), some & near) and ball.count
        low, high = middle - radius, middle + 0.5 * radius
        inside = np.all((at >= low) & (at <= high), axis=-1)
        assert np.array_equal(dense(pack, voxels.in_box((tuple(high), tuple(low)))), some & inside)


def test_parts_are_those_of_the_dense_grid_across_macroblocks(pack):
    labels = np.zeros(alphas(pack).shape, np.int32)
    ndimage.label(alphas(pack) > 0, TOUCHING, labels)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    parts = Voxels(pack).parts()
    for limit in (2, 5, 20, inf):
        chosen = dense(pack, parts.smaller_than(limit))
        assert np.array_equal(chosen, ((sizes < limit) & (sizes < sizes.max()) & (sizes > 0))[labels])
    assert len(sizes) > 2 or parts.smaller_than().count == 0


def test_growing_and_shrinking_go_one_voxel_far_and_across_macroblocks(pack):
    voxels, some = Voxels(pack), alphas(pack) > 0
    chosen = voxels.fainter_than(0.3)
    before = dense(pack, chosen)
    grown = np.logical_and(ndimage.binary_dilation(before, TOUCHING), some)
    assert np.array_equal(dense(pack, voxels.grown(chosen)), grown) and grown.sum() > before.sum()
    shrunk = np.greater(before, ndimage.binary_dilation(some & ~before, TOUCHING))
    assert np.array_equal(dense(pack, voxels.shrunk(chosen)), shrunk)


def test_selections_add_and_subtract_and_share_what_they_do_not_change(pack):
    voxels = Voxels(pack)
    one, other = voxels.fainter_than(0.5), voxels.in_sphere(np.median(centres(pack)[alphas(pack) > 0], axis=0), 0.4)
    a, b = dense(pack, one), dense(pack, other)
    assert np.array_equal(dense(pack, one | other), a | b) and np.array_equal(dense(pack, one - other), a & ~b)
    assert (one - one).count == 0 and not (one - one).bits
    untouched = set(one.bits) - set(other.bits)
    assert all((one | other).bits[k] is (one - other).bits[k] is one.bits[k] for k in untouched)


def test_a_saved_pack_has_the_voxels_that_are_left_and_no_others(pack, tmp_path):
    voxels = Voxels(pack)
    removed = voxels.fainter_than(0.5)
    save_pack(without(pack, removed, ["by hand"]), tmp_path / "new", codec="webp")
    after = load_pack(tmp_path / "new")
    for old, new in zip(dense_of(pack), dense_of(after), strict=True):
        assert np.array_equal(new, np.where(dense(pack, removed)[..., None], 0, old))
    left = [voxels.content(k) & ~voxels.mask(removed, k) for k in range(len(voxels.places))]
    assert after.occupied.sum() == sum(content.any() for content in left)
    assert not [f for f in check_pack(after) if f.severity in ("warning", "error") and f.rule != "premultiplied"]
    assert after.metadata["provenance"]["edits"][-1]["voxels_removed"] == removed.count > 0
    assert after.contraction == pack.contraction and after.ndc == pack.ndc


def test_a_selection_comes_back_from_its_file_and_not_for_another_pack(tmp_path, pack):
    chosen = Voxels(pack).fainter_than(0.5)
    chosen.save(tmp_path / "voxels.npz")
    again = Selection.load(tmp_path / "voxels.npz", pack)
    assert np.array_equal(dense(pack, again), dense(pack, chosen))
    other = small_pack(block_size=7)
    for file, of in ((tmp_path / "voxels.npz", other), (tmp_path / "none.npz", pack)):
        with pytest.raises(UserError, match="is not a selection of this pack's voxels"):
            Selection.load(file, of)
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(UserError, match="is not a selection"):
        Selection.load(tmp_path / "bad.npz", pack)
