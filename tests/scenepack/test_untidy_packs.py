"""Untidy packs open, with one warning line for each thing that was repaired (docs/format.md, "Untidy packs")."""

import gzip
import json
import struct
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from baker.commands.pack import main as snerg_pack
from scenepack import Pack, PackWarning, load_pack, save_pack
from tests.scenepack.helpers import edit_json, read_image, read_json, same_pack, small_pack, write_image, written
from tests.scenepack.volumes import features_of


def opened(folder: Path, *lines: str) -> Pack:
    """Loads; expects exactly one warning line for each of `lines`, holding it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        pack = load_pack(folder)
    warned = [str(w.message) for w in caught]
    assert all(issubclass(w.category, PackWarning) for w in caught)
    assert len(warned) == len(lines), warned
    for line, text in zip(lines, warned, strict=True):
        assert line in text and "\n" not in text
    return pack


def assert_kept(pack: Pack, folder: Path, again: Path) -> None:
    """The pack of a folder is saved with the JSON that the folder has."""
    before = read_json(folder)
    save_pack(pack, again)
    assert json.dumps(read_json(again)) == json.dumps(before)


def json_edited(tmp_path: Path, change: Callable[[dict[str, Any]], Any], **options: Any) -> Path:
    folder = written(tmp_path / "pack", small_pack(**options))
    edit_json(folder, change)
    return folder


@pytest.mark.parametrize("which", ["feature_*.png", "feature_001.png"])
def test_missing_feature_images_make_a_diffuse_pack_whose_weights_survive(tmp_path: Path, which: str) -> None:
    folder = written(tmp_path / "pack")
    for file in folder.glob(which):
        file.unlink()
    pack = opened(folder, "shown as diffuse")
    assert pack.atlas_features is None and pack.view_mlp is None
    assert_kept(pack, folder, tmp_path / "again")


def test_an_all_zero_view_mlp_is_taken_as_diffuse_and_survives(tmp_path: Path) -> None:
    def zero(p: dict[str, Any]) -> None:
        for layer in range(3):
            for kind in ("weights", "bias"):
                p[f"{layer}_{kind}"] = (np.array(p[f"{layer}_{kind}"]) * 0).tolist()

    folder = json_edited(tmp_path, zero)
    pack = opened(folder, "all zero")
    assert pack.view_mlp is None and pack.atlas_features is not None
    assert_kept(pack, folder, folder)


def test_a_pack_without_biases_is_diffuse_without_complaint(tmp_path: Path) -> None:
    folder = json_edited(tmp_path, lambda p: [p.pop(f"{layer}_bias") for layer in range(3)])
    pack = opened(folder)
    assert pack.view_mlp is None and pack.atlas_features is not None
    assert_kept(pack, folder, folder)
    for file in folder.glob("feature_*.png"):
        file.unlink()
    assert opened(folder).atlas_features is None


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
    assert_kept(pack, folder, folder)


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


# Scenes of other programs are refused by name, in one line

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
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif path.suffix == ".zip":
        with zipfile.ZipFile(path, "w") as archive:
            for inner, data in content.items():
                archive.writestr(inner, data)
    else:
        path.mkdir()
        for inner, data in content.items():
            (path / inner).write_bytes(data)
    line = refused(snerg_pack, "info", path)
    assert f" {name} " in line and "snerg opens SNeRG packs" in line and "snerg-make" in line


def test_a_pack_under_another_name_opens(tmp_path: Path) -> None:
    save_pack(small_pack(), tmp_path / "pack.zip")
    (tmp_path / "pack.zip").rename(tmp_path / "pack.splat")
    assert load_pack(tmp_path / "pack.splat").grid_size == small_pack().grid_size
