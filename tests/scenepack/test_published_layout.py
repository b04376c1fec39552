"""A PNG pack has the published layout to the letter, read here with json, Pillow and NumPy alone.

What follows is written from the description of the layout (docs/format.md), not from the reader, and shares no
code with it; only `save_pack` makes the pack.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scenepack import save_pack
from tests.scenepack.random_packs import random_pack
from tests.scenepack.volumes import atlas_from_dense

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


def image(file: Path) -> np.ndarray:
    with Image.open(file) as opened:
        assert opened.format == "PNG" and opened.mode == "RGBA"
        return np.asarray(opened)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_files_keys_types_and_frame_are_the_published_ones_and_no_others(options, tmp_path: Path) -> None:
    shape = {"block_size": 6, "grid_blocks": (3, 4, 2), "style": "blob", **options}
    save_pack(random_pack(np.random.default_rng(3), **shape), tmp_path / "pack")
    params = json.loads((tmp_path / "pack" / "scene_params.json").read_text(encoding="utf-8"))
    count = params["num_slices"]
    assert 4 * (count - 1) < params["atlas_depth"] <= 4 * count
    parts = ("rgba",) if options.get("diffuse") else ("rgba", "feature")
    images = {f"{part}_{k:03d}.png" for part in parts for k in range(count)}
    assert {file.name for file in (tmp_path / "pack").iterdir()} == {"scene_params.json", "atlas_indices.png"} | images

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
    save_pack(pack, tmp_path / "pack")
    groups = [image(file) for file in sorted((tmp_path / "pack").glob("rgba_*.png"))]
    lines = image(tmp_path / "pack" / "atlas_indices.png")[..., :3]  # all y of one z, then of the next
    # four planes, one below another
    assert {group.shape for group in groups} == {(4 * rgba.shape[1], rgba.shape[2], 4)}
    assert lines.shape == (blocks[2] * blocks[1], blocks[0], 3)
    atlas, grid = np.concatenate(groups).reshape(rgba.shape), lines.reshape(*blocks[::-1], 3)
    for bz, by, bx in np.ndindex(grid.shape[:3]):
        ax, ay, az = (int(i) * (size + 2) + 1 for i in grid[bz, by, bx])
        for corner in (0, size - 1):
            voxel = atlas[az + corner, ay + corner, ax + corner]
            assert voxel.tolist() == [bx * size + corner, by * size + corner, bz * size + corner, 255]
        # The voxel before the first is the neighbour's last, or nothing at the grid's edge.
        before = atlas[az, ay, ax - 1].tolist()
        assert before == ([bx * size - 1, by * size, bz * size, 255] if bx else [0, 0, 0, 0])
