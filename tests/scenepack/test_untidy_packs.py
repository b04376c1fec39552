"""What cannot be opened says so in one clear line that names the file or the key. Untidy packs open, with one warning line for
each thing that was repaired (docs/format.md, "Untidy packs").
"""

import gzip
import json
import shutil
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from baker.commands.pack import main as snerg_pack
from console import UserError
from scenepack import Pack, PackWarning, load_pack, save_pack
from tests.fuzz.png import png_chunks, png_of
from tests.fuzz.trees import write_tree, zipped
from tests.scenepack.helpers import edit_json, read_image, read_json, same_pack, small_pack, write_image, written
from tests.scenepack.volumes import features_of


def require_refusal(path: Path, *words: str) -> None:
    # what is refused has nothing else to say
    with pytest.raises(UserError) as caught, warnings.catch_warnings(action="error"):
        load_pack(path)
    line = str(caught.value)
    assert "\n" not in line and len(line) < 500
    for word in words:
        assert word in line, line


def test_what_is_missing_empty_or_without_the_json_is_refused(tmp_path: Path) -> None:
    require_refusal(tmp_path / "nothing", "nothing", "does not exist")
    require_refusal(tmp_path / "nothing.zip", "does not exist")
    require_refusal(tmp_path, "no files", "scene_params.json")
    (tmp_path / "photo.jpg").write_bytes(b"x")
    require_refusal(tmp_path, "not a pack", "photo.jpg")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("voxel_size", 0),
        ("voxel_size", float("nan")),
        ("voxel_size", 10**400),
        ("voxel_size", True),
        ("block_size", 6.5),
        ("grid_width", 10**6),
        ("grid_depth", -4),
        ("atlas_width", 16),
        ("atlas_depth", 10**12),
        ("ndc", "false"),
        ("format", "bmp"),
        ("worldspace_T_opengl", [[0.0] * 4] * 4),
        ("worldspace_T_opengl", [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        ("0_weights", [[0.5] * 16] * 33 + [[0.5] * 15]),
        ("1_weights", [[float("nan")] * 16] * 16),
        ("2_weights", [[1e39] * 3] * 16),
        ("2_bias", [0.0]),
        ("2_bias", [0.0, True, 0.0]),
        ("input_width", 0),
        ("input_height", "wide"),
        ("input_focal", float("nan")),
    ],
)
def test_a_value_out_of_range_is_refused(tmp_path: Path, key: str, value: Any) -> None:
    forward_facing = key.startswith("input")
    folder = json_edited(tmp_path, lambda p: p.update({key: value}), ndc=forward_facing)
    require_refusal(folder, *([key] if forward_facing else []))


@pytest.mark.parametrize("key", ["input_width", "input_height"])
def test_a_forward_facing_pack_needs_the_size_of_its_photographs(tmp_path: Path, key: str) -> None:
    require_refusal(json_edited(tmp_path, lambda p: p.pop(key), ndc=True), key, "missing")


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("rgba_000.png", lambda image: image.astype(np.uint16), ("16 bits", "8")),
        ("rgba_001.png", lambda image: image[:-1], ("size disagrees", "expected", "found")),
        ("feature_000.png", lambda image: image[:-1], ("size disagrees", "expected", "found")),
        ("atlas_indices.png", lambda image: image[:-1], ("size disagrees", "expected", "found")),
        ("rgba_001.png", None, ("is missing",)),
        ("atlas_indices.png", None, ("is missing",)),
    ],
)
def test_images_that_do_not_fit_are_refused(tmp_path, name, change, words):
    folder = written(tmp_path / "pack")
    if change is None:
        (folder / name).unlink()
    else:
        write_image(folder / name, change(read_image(folder / name)))
    require_refusal(folder, name, *words)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_indices_that_point_outside_of_the_atlas_are_refused(tmp_path: Path, axis: int) -> None:
    pack = small_pack()
    folder = written(tmp_path / "pack", pack)
    image = read_image(folder / "atlas_indices.png")
    row, column = np.argwhere(image[..., 0] != 255)[0]
    image[row, column, axis] = pack.atlas_blocks[axis]
    write_image(folder / "atlas_indices.png", image)
    require_refusal(folder, "atlas_indices.png", "outside of the atlas", "expected", "found")


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    image = folder / "rgba_000.png"
    image.write_bytes(image.read_bytes() + b"\0" * (8 << 20))
    require_refusal(Path(shutil.make_archive(str(folder), "zip", folder)), "rgba_000.png", "too large")


def test_a_second_header_of_a_png_is_refused(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    file = folder / "rgba_000.png"
    first, *others = png_chunks(file.read_bytes())
    file.write_bytes(png_of([first, (b"IHDR", struct.pack(">IIBBBBB", 40_000, 50_000, 8, 6, 0, 0, 0)), *others]))
    require_refusal(folder, "rgba_000.png", "more than one header")  # libpng would allocate for it


@pytest.mark.parametrize("codec", ["png", "webp"])
def test_a_pack_for_which_memory_is_too_small_is_refused_with_both_sizes(tmp_path, monkeypatch, codec):
    folder = tmp_path / "pack"
    save_pack(small_pack(), folder, codec=codec)
    monkeypatch.setattr("scenepack.files.free_memory", lambda: 1000)
    require_refusal(folder, "does not fit in memory", "GB", "lower resolution")


def opened(folder: Path, *lines: str) -> Pack:
    """Loads; expects exactly one warning line for each of `lines`, holding it."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        pack = load_pack(folder)
    warned = [str(w.message) for w in caught]
    assert all(issubclass(w.category, PackWarning) for w in caught)
    assert len(warned) == len(lines), warned
    for line, text in zip(lines, warned, strict=True):
        assert line in text and "\n" not in text
    return pack


def assert_kept(pack: Pack, folder: Path) -> None:
    """The pack of a folder is saved with the JSON that the folder has."""
    before = read_json(folder)
    save_pack(pack, folder)
    assert json.dumps(read_json(folder)) == json.dumps(before)


def json_edited(tmp_path: Path, change: Callable[[dict[str, Any]], Any], **options: Any) -> Path:
    folder = written(tmp_path / "pack", small_pack(**options))
    edit_json(folder, change)
    return folder


def zeros(p: dict[str, Any]) -> None:
    for key in {f"{layer}_{kind}" for layer in range(3) for kind in ("weights", "bias")}:
        p[key] = (np.array(p[key]) * 0).tolist()


def no_biases(p: dict[str, Any]) -> None:
    for layer in range(3):
        del p[f"{layer}_bias"]


@pytest.mark.parametrize(
    ("change", "missing", "warned"),
    [
        (None, "feature_*.png", ["shown as diffuse"]),
        (None, "feature_001.png", ["shown as diffuse"]),
        (zeros, None, ["all zero"]),
        (no_biases, None, []),
        (no_biases, "feature_*.png", []),
    ],
)
def test_a_pack_that_lacks_features_or_view_mlp_is_diffuse_and_keeps_its_json(tmp_path, change, missing, warned):
    folder = json_edited(tmp_path, change or (lambda p: None))
    for file in folder.glob(missing or "nothing"):
        file.unlink()
    pack = opened(folder, *warned)
    assert pack.view_mlp is None and (pack.atlas_features is None) == (missing is not None)
    assert_kept(pack, folder)


def test_images_beyond_the_atlas_depth_are_ignored(tmp_path: Path) -> None:
    pack = small_pack()
    folder = written(tmp_path / "pack", pack)
    count = pack.atlas_rgba.shape[0] // 4
    for part in ("rgba", "feature"):
        (folder / f"{part}_{count:03d}.png").write_bytes(b"never read")
    assert same_pack(opened(folder, "the rest is ignored"), pack)


@pytest.mark.parametrize("count", [1, 99, "many", None])
def test_num_slices_is_not_trusted(tmp_path: Path, count: Any) -> None:
    folder = json_edited(tmp_path, lambda p: p.update(num_slices=count))
    assert same_pack(opened(folder, "num_slices"), small_pack())


def test_an_old_forward_facing_pack_gets_the_published_viewers_camera(tmp_path: Path) -> None:
    folder = json_edited(tmp_path, lambda p: p.pop("input_focal"), ndc=True)
    pack = opened(folder, "input_focal")
    assert (pack.input_width, pack.input_height, pack.input_focal) == (1006.0, 756.0, 755.644059435)
    assert_kept(pack, folder)


def test_indices_may_be_rgb(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    write_image(folder / "atlas_indices.png", read_image(folder / "atlas_indices.png")[..., :3])
    assert same_pack(opened(folder), small_pack())


@pytest.mark.parametrize("mode", ["L", "LA", "P"])
def test_images_that_an_optimiser_repacked_are_read(tmp_path: Path, mode: str) -> None:
    folder = written(tmp_path / "pack")
    Image.open(folder / "feature_000.png").convert("RGB").convert(mode).save(folder / "feature_000.png")
    with Image.open(folder / "feature_000.png") as image:
        expected = np.asarray(image.convert("RGBA"))
    pack = opened(folder, "feature_000.png is")
    np.testing.assert_array_equal(features_of(pack)[:4].reshape(expected.shape), expected)


MERF = {"triplane_resolution": 2048, "triplane_voxel_size": 0.002, "sparse_grid_resolution": 512, "num_slices": 3,
        "data_block_size": 8, "atlas_width": 512, "atlas_height": 512, "atlas_depth": 96, "slice_depth": 1}  # fmt: skip
COLUMNS = "".join(f"property float {name}\n" for name in ("x", "y", "z", "f_dc_0", "opacity", "scale_0", "rot_0"))
GAUSSIANS = f"ply\nformat binary_little_endian 1.0\nelement vertex 1\n{COLUMNS}"
POINTS = "ply\r\nformat ascii 1.0\r\nelement vertex 1\r\nproperty float x\r\nend_header\r\n0\r\n"
MESH = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nelement face 1\nend_header\n"


def as_pack(params: dict[str, Any]) -> dict[str, bytes]:
    return {"scene_params.json": json.dumps(params).encode()}


@pytest.mark.parametrize(
    ("file", "content", "name"),
    [
        ("pack", as_pack(MERF), "a MERF pack"),
        ("pack", as_pack({"sparse_grid_resolution": 1024, "scene_scale_factor": 1.0}), "a binary opacity grid"),
        ("pack", as_pack({**MERF, "num_local_submodels": 3, "sm_to_params": [0, 1, 2]}), "a SMERF pack"),
        ("pack.zip", as_pack(MERF), "a MERF pack"),
        ("garden.ply", (GAUSSIANS + "end_header\n").encode() + bytes(28), "a file of 3D Gaussians"),
        ("points.ply", POINTS.encode(), "a cloud of points"),
        ("mesh.ply", MESH.encode(), "a mesh"),
        ("renamed.zip", (GAUSSIANS + "end_header\n").encode(), "a file of 3D Gaussians"),
        ("garden.splat", struct.pack("<6f8B", *range(6), *range(8)), "a file of 3D Gaussians"),
        ("garden.SPLAT", bytes(32), "a file of 3D Gaussians"),
        ("garden.ksplat", bytes(4096), "a file of 3D Gaussians"),
        ("garden.spz", gzip.compress(bytes(100), mtime=0), "a file of 3D Gaussians"),
        ("base.ingp", gzip.compress(bytes(100), mtime=0), "a snapshot of instant-ngp"),
        ("garden.glb", b"glTF" + bytes(20), "a mesh"),
        ("empty.splat", b"", "a file of 3D Gaussians"),
    ],
)
def test_what_other_programs_wrote_is_named(file, content, name, tmp_path, refused):
    path = tmp_path / file
    if isinstance(content, dict) and path.suffix != ".zip":
        write_tree(content, path)
    else:
        path.write_bytes(zipped(content) if isinstance(content, dict) else content)
    line = refused(snerg_pack, "info", path)
    assert f" {name} " in line and "snerg opens SNeRG packs" in line and "snerg-make" in line


def test_a_pack_under_another_name_opens(tmp_path: Path) -> None:
    save_pack(small_pack(), tmp_path / "pack.zip")
    (tmp_path / "pack.zip").rename(tmp_path / "pack.splat")
    assert load_pack(tmp_path / "pack.splat").grid_size == small_pack().grid_size
