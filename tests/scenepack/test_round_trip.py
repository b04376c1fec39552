"""What is saved is what is loaded, in pixels and key for key."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from console import UserError
from scenepack import PackWarning, ViewMlp, check_pack, load_pack, save_pack
from scenepack.blocks import MAX_SLICE_SIDE, atlas_shape, choose_atlas_blocks
from tests.scenepack.helpers import edit_json, read_image, read_json, same_pack, small_pack, written
from tests.scenepack.random_packs import packs


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pack=packs(block_sizes=(3, 14), ndc=None), as_zip=st.booleans())
def test_any_valid_pack_survives_saving_and_loading(tmp_path: Path, pack, as_zip: bool) -> None:
    path = tmp_path / "deep" / "er" / ("pack.zip" if as_zip else "pack")
    save_pack(pack, path)
    assert same_pack(load_pack(path), pack)


def test_a_real_pack_round_trips_byte_for_byte_in_pixels_and_key_for_key(real_data: Path, tmp_path: Path) -> None:
    source = real_data / "packs/flowerbangle_480"
    with pytest.warns(PackWarning, match="all zero"):
        pack = load_pack(source)
    assert pack.view_mlp is None and pack.atlas_rgba.shape == (32, 1024, 1024, 4)
    assert not [finding for finding in check_pack(pack) if finding.severity == "error"]
    save_pack(pack, tmp_path / "pack")
    del pack
    assert {f.name for f in source.iterdir()} == {f.name for f in (tmp_path / "pack").iterdir()}
    for file in source.glob("*.png"):
        assert np.array_equal(read_image(file), read_image(tmp_path / "pack" / file.name))
    before, after = read_json(source), read_json(tmp_path / "pack")
    assert list(before) == list(after)
    assert json.dumps(before) == json.dumps(after)


def test_unknown_keys_and_untouched_spellings_survive(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    edit_json(folder, lambda p: p.update(author={"name": "Ada", "tags": [1, None]}, min_x=-1, voxel_size=1))
    edit_json(folder, lambda p: p.pop("snerg"))
    before = read_json(folder)
    save_pack(load_pack(folder), tmp_path / "again")
    assert json.dumps(read_json(tmp_path / "again")) == json.dumps(before)


def test_metadata_lies_under_one_key_and_takes_numpy_values(tmp_path: Path) -> None:
    pack = small_pack().with_metadata(steps=np.int64(3), psnr=np.float32(0.5), poses=np.eye(2), scene=Path("a/b"))
    metadata = load_pack(written(tmp_path / "pack", pack)).metadata
    assert metadata["steps"] == 3 and metadata["psnr"] == 0.5
    assert metadata["poses"] == [[1, 0], [0, 1]] and metadata["scene"] == "a/b"
    assert metadata["codec"] == "png" and metadata["version"]


def test_equal_packs_make_equal_zips(tmp_path: Path) -> None:
    written(tmp_path / "a.zip")
    written(tmp_path / "b.zip")
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


def test_packs_that_break_their_own_rules_are_not_written(tmp_path: Path) -> None:
    pack = small_pack()
    assert pack.view_mlp is not None
    nan = ViewMlp(pack.view_mlp.weights, (pack.view_mlp.biases[0] * np.nan, *pack.view_mlp.biases[1:]))
    for wrong in (
        replace(pack, voxel_size=-1.0),
        replace(pack, view_mlp=nan),
        replace(pack, ndc=True),
        replace(pack, atlas_features=None),
        replace(pack, atlas_rgba=pack.atlas_rgba.astype(float)),
        replace(pack, grid_size=(1, 1, 1)),
        replace(pack, atlas_indices=np.zeros_like(pack.atlas_indices) + np.uint8(200)),
    ):
        with pytest.raises((UserError, ValueError)):
            save_pack(wrong, tmp_path / "pack")
    assert not list(tmp_path.iterdir())


@given(count=st.integers(0, 200_000), block_size=st.sampled_from([1, 6, 14, 30, 62]))
def test_the_chosen_layout_holds_all_and_stays_within_bounds(count: int, block_size: int) -> None:
    x, y, z = choose_atlas_blocks(count, block_size)
    assert x * y * z >= count and max(x, y, z) <= 255
    depth, height, width = atlas_shape((x, y, z), block_size)
    assert max(height, width) <= MAX_SLICE_SIDE and depth % 4 == 0
    assert count < 2 or x * y * z <= 1.5 * count + 2
