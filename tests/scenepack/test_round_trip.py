"""What is saved is what is loaded, in pixels and key for key; a PNG pack has the published layout to the letter."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from console import UserError
from scenepack import PackWarning, ViewMlp, check_pack, load_pack, save_pack
from scenepack.blocks import (
    MAX_SLICE_SIDE,
    atlas_from_volume,
    atlas_shape,
    choose_atlas_blocks,
    dense_from_pack,
    grid_block_counts,
)
from scenepack.pack import Pack
from tests.scenepack.helpers import edit_json, read_image, read_json, real_pack, same_pack, small_pack, written
from tests.scenepack.random_packs import packs, random_pack
from tests.scenepack.volumes import atlas_from_dense


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pack=packs(block_sizes=(3, 14), ndc=None), as_zip=st.booleans())
def test_any_valid_pack_survives_saving_and_loading(tmp_path: Path, pack, as_zip: bool) -> None:
    path = tmp_path / "deep" / "er" / ("pack.zip" if as_zip else "pack")
    save_pack(pack, path, png_level=0)
    assert same_pack(load_pack(path), pack)


def test_a_real_pack_round_trips_byte_for_byte_in_pixels_and_key_for_key(tmp_path: Path) -> None:
    source = real_pack()
    with pytest.warns(PackWarning, match="all zero"):
        pack = load_pack(source)
    assert pack.view_mlp is None and pack.atlas_rgba.shape == (32, 1024, 1024, 4)
    assert not [finding for finding in check_pack(pack) if finding.severity == "error"]
    save_pack(pack, tmp_path / "pack", png_level=1)
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


# Cutting a volume into padded macroblocks loses nothing


@settings(max_examples=25, deadline=None)
@given(pack=packs(block_sizes=(1, 2, 6, 14)))
def test_putting_a_pack_together_and_cutting_it_again_gives_the_same_atlas(pack: Pack) -> None:
    rgba, features = dense_from_pack(pack)
    again = atlas_from_dense(rgba, features, pack.block_size, pack.occupied, atlas_blocks=pack.atlas_blocks)
    np.testing.assert_equal(again, (pack.atlas_indices, pack.atlas_rgba, pack.atlas_features))


def test_a_volume_is_read_one_macroblock_at_a_time_and_never_outside_of_the_grid() -> None:
    size, boxes = (10, 7, 6), []

    def read_box(low: tuple[int, int, int], high: tuple[int, int, int]) -> np.ndarray:
        boxes.append((low, high))
        z, y, x = np.ogrid[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        return np.repeat((z * 100 + y * 10 + x)[..., None] % 256, 4, axis=-1).astype(np.uint8)

    occupied = np.ones(grid_block_counts(size, 4)[::-1], bool)
    indices, rgba, features = atlas_from_volume(read_box, size, 4, occupied, channels=4)
    assert features is None and len(boxes) == occupied.size
    for low, high in boxes:
        assert all(0 <= a < b <= n and b - a <= 6 for a, b, n in zip(low, high, size[::-1], strict=True))
    whole = read_box((0, 0, 0), (6, 7, 10))
    np.testing.assert_array_equal(atlas_from_dense(whole, None, 4, occupied)[1], rgba)
    assert indices.max() < 255


@given(count=st.integers(0, 200_000), block_size=st.sampled_from([1, 6, 14, 30, 62]))
def test_the_chosen_layout_holds_all_and_stays_within_bounds(count: int, block_size: int) -> None:
    x, y, z = choose_atlas_blocks(count, block_size)
    assert x * y * z >= count and max(x, y, z) <= 255
    depth, height, width = atlas_shape((x, y, z), block_size)
    assert max(height, width) <= MAX_SLICE_SIDE and depth % 4 == 0
    assert count < 2 or x * y * z <= 1.5 * count + 2


# The published layout, read here with json, Pillow and NumPy alone. What follows is written from the description of the layout
# (docs/format.md), not from the reader, and shares no code with it; only `save_pack` makes the pack.

EMPTY = 255
WHOLE = (
    "block_size", "grid_width", "grid_height", "grid_depth", "atlas_width", "atlas_height", "atlas_depth",
    "num_slices", "atlas_blocks_x", "atlas_blocks_y", "atlas_blocks_z",
)  # fmt: skip
REAL = ("voxel_size", "min_x", "min_y", "min_z")
INPUT = ("input_height", "input_width", "input_focal")
MATRICES = {
    "0_weights": (34, 16), "1_weights": (16, 16), "2_weights": (16, 3),
    "0_bias": (16,), "1_bias": (16,), "2_bias": (3,),
}  # fmt: skip
OPTIONS: list[dict[str, Any]] = [{}, {"diffuse": True}, {"ndc": True}, {"block_size": 30, "grid_blocks": (2, 2, 1)}]


class Published:
    """A pack as another program reads it: JSON, images as arrays, the atlas as [z, y, x, 4]."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.params = json.loads((folder / "scene_params.json").read_text(encoding="utf-8"))
        self.names = sorted(path.name for path in folder.iterdir())

    def image(self, name: str) -> tuple[str, np.ndarray]:
        with Image.open(self.folder / name) as image:
            assert image.format == "PNG"
            return image.mode, np.asarray(image)

    def atlas(self, part: str) -> np.ndarray:
        height, width, count = (self.params[key] for key in ("atlas_height", "atlas_width", "num_slices"))
        planes = []
        for k in range(count):
            mode, pixels = self.image(f"{part}_{k:03d}.png")
            assert mode == "RGBA" and pixels.dtype == np.uint8
            assert pixels.shape == (4 * height, width, 4)
            planes += [pixels[i * height : (i + 1) * height] for i in range(4)]
        return np.stack(planes)

    def indices(self) -> np.ndarray:
        """[blocks z, blocks y, blocks x, 3]: an atlas block (x, y, z)."""
        mode, pixels = self.image("atlas_indices.png")
        assert mode in ("RGB", "RGBA") and pixels.dtype == np.uint8
        x, y, z = self.grid_blocks()
        assert pixels.shape[:2] == (z * y, x)
        return pixels.reshape(z, y, x, -1)[..., :3]

    def grid_blocks(self) -> tuple[int, ...]:
        sides = (self.params[f"grid_{axis}"] for axis in ("width", "height", "depth"))
        return tuple(-(-side // self.params["block_size"]) for side in sides)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_files_keys_types_and_frame_are_the_published_ones_and_no_others(options, tmp_path: Path) -> None:
    shape = {"block_size": 6, "grid_blocks": (3, 4, 2), "style": "blob", **options}
    save_pack(random_pack(np.random.default_rng(3), **shape), tmp_path / "pack", png_level=1)
    published = Published(tmp_path / "pack")
    count = published.params["num_slices"]
    assert 4 * (count - 1) < published.params["atlas_depth"] <= 4 * count
    parts = ("rgba",) if options.get("diffuse") else ("rgba", "feature")
    images = {f"{part}_{k:03d}.png" for part in parts for k in range(count)}
    assert set(published.names) == {"scene_params.json", "atlas_indices.png"} | images

    params = published.params
    for key in WHOLE:
        assert type(params[key]) is int and params[key] > 0, key
    for key in REAL:
        assert type(params[key]) is float, key
    assert type(params["ndc"]) is bool and params["ndc"] == bool(options.get("ndc"))
    assert params["format"] == "png"
    layers = {} if options.get("diffuse") else MATRICES
    for key, shape in layers.items():
        assert np.array(params[key], float).shape == shape, key
    camera = INPUT if options.get("ndc") else ()
    assert all(type(params[key]) in (int, float) and params[key] > 0 for key in camera)
    known = {*WHOLE, *REAL, "ndc", "format", "worldspace_T_opengl", *layers, *camera}
    assert set(params) - known == {"snerg"}, "ours lie under one key"
    assert type(params["snerg"]) is dict

    blender = [[-1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
    forward_facing = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]
    assert params["worldspace_T_opengl"] == (forward_facing if options.get("ndc") else blender)


def test_an_index_is_x_y_z_and_leads_to_the_voxels_of_its_place_in_the_grid(tmp_path: Path) -> None:
    """A pack whose every data voxel tells its own place: x in red, y in green, z in blue, of 255."""
    size, blocks = 6, (3, 2, 4)
    x, y, z = (n * size for n in blocks)
    place = np.empty((z, y, x, 4), np.uint8)
    place[..., 0], place[..., 1], place[..., 2] = np.ogrid[:z, :y, :x][::-1]
    place[..., 3] = 255
    indices, rgba, _ = atlas_from_dense(place, None, size, np.ones(blocks[::-1], bool))
    pack = random_pack(np.random.default_rng(0), block_size=size, grid_blocks=blocks, whole_blocks=True, diffuse=True)
    pack = replace(pack, atlas_indices=indices, atlas_rgba=rgba)
    save_pack(pack, tmp_path / "pack", png_level=1)
    published = Published(tmp_path / "pack")
    atlas, grid = published.atlas("rgba"), published.indices()
    for bz, by, bx in np.ndindex(grid.shape[:3]):
        ax, ay, az = (int(i) * (size + 2) + 1 for i in grid[bz, by, bx])
        for corner in (0, size - 1):
            voxel = atlas[az + corner, ay + corner, ax + corner]
            assert voxel.tolist() == [bx * size + corner, by * size + corner, bz * size + corner, 255]
        # The voxel before the first is the neighbour's last, or nothing at the grid's edge.
        before = atlas[az, ay, ax - 1].tolist()
        assert before == ([bx * size - 1, by * size, bz * size, 255] if bx else [0, 0, 0, 0])
