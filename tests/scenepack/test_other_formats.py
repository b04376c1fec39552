"""Scenes of other programs are refused by name, in one line."""

from __future__ import annotations

import gzip
import json
import struct
import zipfile
from pathlib import Path

import pytest

from baker.commands.pack import main as snerg_pack
from console import UserError
from scenepack import load_pack, save_pack
from tests.scenepack.helpers import small_pack

MERF = {"triplane_resolution": 2048, "triplane_voxel_size": 0.002, "sparse_grid_resolution": 512, "num_slices": 3,
        "data_block_size": 8, "atlas_width": 512, "atlas_height": 512, "atlas_depth": 96, "slice_depth": 1}  # fmt: skip
GAUSSIANS = "ply\nformat binary_little_endian 1.0\nelement vertex 1\n" + "".join(
    f"property float {name}\n" for name in ("x", "y", "z", "f_dc_0", "opacity", "scale_0", "rot_0")
)
POINTS = "ply\r\nformat ascii 1.0\r\nelement vertex 1\r\nproperty float x\r\nend_header\r\n0\r\n"
MESH = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nelement face 1\nend_header\n"


@pytest.mark.parametrize(
    ("params", "name"),
    [
        (MERF, "a MERF pack"),
        ({"sparse_grid_resolution": 1024, "scene_scale_factor": 1.0}, "a binary opacity grid"),
        ({**MERF, "num_local_submodels": 3, "sm_to_params": [0, 1, 2]}, "a SMERF pack"),
    ],
)
@pytest.mark.parametrize("zipped", [False, True])
def test_packs_of_other_methods_are_named(params: dict, name: str, zipped: bool, tmp_path: Path) -> None:
    path = tmp_path / ("pack.zip" if zipped else "pack")
    if zipped:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("scene_params.json", json.dumps(params))
    else:
        path.mkdir()
        (path / "scene_params.json").write_text(json.dumps(params))
    with pytest.raises(UserError, match=f"this is {name} .*snerg opens SNeRG packs.*snerg-make"):
        load_pack(path)


@pytest.mark.parametrize(
    ("file", "content", "name"),
    [
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
def test_files_of_other_programs_are_named(
    file: str, content: bytes, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / file).write_bytes(content)
    assert snerg_pack(["info", str(tmp_path / file)]) == 2
    line = capsys.readouterr().err
    assert f"this is {name}" in line and "snerg opens SNeRG packs" in line and line.count("\n") == 1


@pytest.mark.parametrize(("file", "words"), [("plane_features_0.png", "a MERF pack"), ("a.splat", "3D Gaussians")])
def test_folders_of_other_programs_are_named(file: str, words: str, tmp_path: Path) -> None:
    (tmp_path / file).write_bytes(b"x")
    with pytest.raises(UserError, match=words):
        load_pack(tmp_path)


def test_a_pack_under_another_name_opens(tmp_path: Path) -> None:
    save_pack(small_pack(), tmp_path / "pack.zip")
    (tmp_path / "pack.zip").rename(tmp_path / "pack.splat")
    assert load_pack(tmp_path / "pack.splat").grid_size == small_pack().grid_size
