"""What cannot be opened says so in one clear line that names the file or the key."""

from __future__ import annotations

import os
import shutil
import struct
import tracemalloc
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from console import UserError
from scenepack import load_pack, save_pack
from scenepack.codecs.png import PNG_SIGNATURE
from tests.scenepack.helpers import edit_json, read_image, small_pack, write_image, written, zipped


def refused(path: Path, *words: str) -> None:
    with pytest.raises(UserError) as caught, warnings.catch_warnings():
        warnings.simplefilter("error")  # what is refused has nothing else to say
        load_pack(path)
    line = str(caught.value)
    assert "\n" not in line and len(line) < 500
    for word in words:
        assert word in line, line


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "nothing", "nothing", "does not exist")
    refused(tmp_path / "nothing.zip", "does not exist")


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    refused(tmp_path, "is empty", "scene_params.json")
    (tmp_path / "lego").mkdir()
    refused(tmp_path, "holds no files", "only folders, such as lego")


def test_a_folder_without_the_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").write_bytes(b"x")
    refused(tmp_path, "not a pack", "photo.jpg")


def test_a_folder_around_a_pack_points_at_the_pack(tmp_path: Path) -> None:
    written(tmp_path / "png")
    refused(tmp_path, "open", str(tmp_path / "png"))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("not json", "not JSON"),
        ("\xff\xfe\x00", "not JSON"),
        ("[1, 2]", "object"),
        ("3", "object"),
        ("[" * 100000, "not JSON"),
    ],
)
def test_json_that_is_none_is_refused(tmp_path: Path, text: str, word: str) -> None:
    folder = written(tmp_path / "pack")
    (folder / "scene_params.json").write_bytes(text.encode("latin-1"))
    refused(folder, "scene_params.json", word)


REQUIRED = [
    "voxel_size", "block_size", "grid_width", "grid_height", "grid_depth", "atlas_width", "atlas_height",
    "atlas_depth", "min_x", "min_y", "min_z", "worldspace_T_opengl", "ndc", "0_weights", "1_bias", "2_bias",
]  # fmt: skip


@pytest.mark.parametrize("key", REQUIRED)
def test_a_missing_key_is_refused(tmp_path: Path, key: str) -> None:
    folder = written(tmp_path / "pack")
    edit_json(folder, lambda p: p.pop(key))
    refused(folder, "scene_params.json", key, "missing")


@pytest.mark.parametrize("key", REQUIRED)
@pytest.mark.parametrize("value", ["wide", None, [1, 2], {"a": 1}])
def test_a_value_of_the_wrong_type_is_refused(tmp_path: Path, key: str, value: Any) -> None:
    folder = written(tmp_path / "pack")
    edit_json(folder, lambda p: p.update({key: value}))
    refused(folder, "scene_params.json", key)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("voxel_size", 0),
        ("voxel_size", -0.1),
        ("voxel_size", 1e-300),
        ("voxel_size", 1e30),
        ("min_y", -1e300),
        ("voxel_size", float("nan")),
        ("voxel_size", float("inf")),
        ("voxel_size", 10**400),
        ("voxel_size", True),
        ("min_x", float("nan")),
        ("block_size", 0),
        ("block_size", 6.5),
        ("block_size", 10**9),
        ("grid_width", 0),
        ("grid_width", 10**6),
        ("grid_width", 999),
        ("grid_depth", -4),
        ("atlas_width", 10**6),
        ("atlas_width", 16),
        ("atlas_height", 4),
        ("atlas_depth", 10**12),
        ("atlas_depth", 16384),
        ("ndc", "false"),
        ("ndc", 2),
        ("format", "bmp"),
        ("format", 3),
        ("worldspace_T_opengl", [[0.0] * 4] * 4),
        ("worldspace_T_opengl", [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
        ("worldspace_T_opengl", [[float("nan"), 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
        ("worldspace_T_opengl", [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        ("0_weights", [[0.5] * 16] * 33),
        ("0_weights", [[0.5] * 15] * 34),
        ("0_weights", [[0.5] * 16] * 33 + [[0.5] * 15]),
        ("1_weights", [[float("nan")] * 16] * 16),
        ("1_weights", [["0.5"] * 16] * 16),
        ("2_weights", [[1e39] * 3] * 16),
        ("2_bias", [0.0, float("inf"), 0.0]),
        ("2_bias", [0.0]),
    ],
)
def test_a_value_out_of_range_is_refused(tmp_path: Path, key: str, value: Any) -> None:
    folder = written(tmp_path / "pack")
    edit_json(folder, lambda p: p.update({key: value}))
    refused(folder)


@pytest.mark.parametrize("value", [0, -3, float("nan"), "wide", [1]])
@pytest.mark.parametrize("key", ["input_width", "input_height", "input_focal"])
def test_a_forward_facing_pack_needs_a_usable_camera(tmp_path: Path, key: str, value: Any) -> None:
    folder = written(tmp_path / "pack", small_pack(ndc=True))
    edit_json(folder, lambda p: p.update({key: value}))
    refused(folder, key)


@pytest.mark.parametrize("key", ["input_width", "input_height"])
def test_a_forward_facing_pack_with_half_a_camera_is_refused(tmp_path: Path, key: str) -> None:
    folder = written(tmp_path / "pack", small_pack(ndc=True))
    edit_json(folder, lambda p: p.pop(key))
    refused(folder, key, "missing")


@pytest.mark.parametrize("name", ["rgba_000.png", "feature_001.png", "atlas_indices.png"])
@pytest.mark.parametrize("keep", [0, 5, 20, 40, 0.5, -30])
def test_a_truncated_image_is_refused(tmp_path: Path, name: str, keep: float) -> None:
    folder = written(tmp_path / "pack", small_pack(occupancy=0.5))
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[: int(keep * len(data)) if isinstance(keep, float) else keep])
    refused(folder, name, "cannot be decoded")


@pytest.mark.parametrize("name", ["rgba_000.png", "atlas_indices.png"])
@pytest.mark.parametrize("spoil", [lambda d: b"GIF89a" + d[6:], lambda d: d[:60] + b"\0\1\2" + d[63:]])
def test_an_undecodable_image_is_refused(tmp_path: Path, name: str, spoil: Callable[[bytes], bytes]) -> None:
    folder = written(tmp_path / "pack")
    (folder / name).write_bytes(spoil((folder / name).read_bytes()))
    refused(folder, name, "cannot be decoded")


def test_sixteen_bit_images_are_refused(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    image = read_image(folder / "rgba_000.png").astype(np.uint16)
    write_image(folder / "rgba_000.png", image)
    refused(folder, "rgba_000.png", "16 bits", "8")


@pytest.mark.parametrize("name", ["rgba_001.png", "feature_000.png", "atlas_indices.png"])
def test_an_image_of_another_size_is_refused(tmp_path: Path, name: str) -> None:
    folder = written(tmp_path / "pack")
    write_image(folder / name, read_image(folder / name)[:-1])
    refused(folder, name, "size disagrees", "expected", "found")


@pytest.mark.parametrize("name", ["rgba_001.png", "atlas_indices.png"])
def test_a_missing_image_is_refused(tmp_path: Path, name: str) -> None:
    folder = written(tmp_path / "pack")
    (folder / name).unlink()
    refused(folder, name, "is missing")


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_indices_that_point_outside_of_the_atlas_are_refused(tmp_path: Path, axis: int) -> None:
    pack = small_pack()
    folder = written(tmp_path / "pack", pack)
    image = read_image(folder / "atlas_indices.png")
    row, column = np.argwhere(image[..., 0] != 255)[0]
    image[row, column, axis] = pack.atlas_blocks[axis]
    write_image(folder / "atlas_indices.png", image)
    refused(folder, "atlas_indices.png", "outside of the atlas", "expected", "found")


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.99])
def test_a_truncated_zip_is_refused(tmp_path: Path, keep: float) -> None:
    file = written(tmp_path / "pack.zip")
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * keep) if isinstance(keep, float) else keep])
    refused(file, "cannot be opened as a .zip")


def test_a_zip_with_spoiled_bytes_is_refused(tmp_path: Path) -> None:
    file = written(tmp_path / "pack.zip")
    data = bytearray(file.read_bytes())
    at = data.index(b"rgba_000.png") + 120
    data[at] ^= 0xFF
    file.write_bytes(data)
    refused(file, "rgba_000.png")


def test_a_zip_of_something_else_is_refused(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    (photos / "a.jpg").write_bytes(b"x")
    refused(zipped(photos), "not a pack")


def test_a_zip_of_two_packs_is_refused(tmp_path: Path) -> None:
    outer = tmp_path / "both"
    written(outer / "a")
    written(outer / "b")
    refused(Path(shutil.make_archive(str(outer), "zip", outer)), "2 packs")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("name", ["scene_params.json", "atlas_indices.png", "rgba_000.png", "feature_001.png", ""])
def test_a_pipe_in_place_of_a_file_is_not_waited_for(tmp_path: Path, name: str) -> None:
    folder = written(tmp_path / "pack")
    pipe = folder / name if name else tmp_path / "pack.zip"
    pipe.unlink(missing_ok=True)
    os.mkfifo(pipe)
    with warnings.catch_warnings(), pytest.raises(UserError) if "feature" not in name else nullcontext():
        warnings.simplefilter("ignore")
        load_pack(folder if name else pipe)


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    image = folder / "rgba_000.png"
    image.write_bytes(image.read_bytes() + b"\0" * (8 << 20))
    refused(Path(shutil.make_archive(str(folder), "zip", folder)), "rgba_000.png", "too large")


def test_a_file_that_is_no_pack_is_refused(tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").write_bytes(b"not a pack at all")
    refused(tmp_path / "photo.jpg", "photo.jpg")


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def claimed_png(width: int, height: int) -> bytes:
    """A PNG of RGBA whose header claims what its few bytes cannot hold."""
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0))
    return PNG_SIGNATURE + header + chunk(b"IDAT", zlib.compress(bytes(1000), 9)) + chunk(b"IEND", b"")


@contextmanager
def little_memory() -> Iterator[None]:
    """What is allocated inside stays below 64 MiB, NumPy's arrays and bytes included."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()


def test_a_second_header_is_refused_before_its_size_is_allocated(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    file = folder / "rgba_000.png"
    data = file.read_bytes()
    second = chunk(b"IHDR", struct.pack(">IIBBBBB", 40_000, 50_000, 8, 6, 0, 0, 0))
    file.write_bytes(data[:33] + second + data[33:])
    with little_memory():
        refused(folder, "rgba_000.png", "more than one header")


def test_an_atlas_that_its_bytes_cannot_hold_is_refused_before_it_is_allocated(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    for image in [*folder.glob("rgba_*.png"), *folder.glob("feature_*.png")]:
        image.unlink()
    for side, words in ((16384, ("far larger than its content",)), (1024, ("_000.png", "can hold"))):
        size = {"atlas_width": side, "atlas_height": side, "atlas_depth": 8, "num_slices": 2}
        edit_json(folder, lambda p, size=size: p.update(size))
        for name in ("rgba_000", "rgba_001", "feature_000", "feature_001"):
            (folder / f"{name}.png").write_bytes(claimed_png(side, 4 * side))
        with little_memory():
            refused(folder, *words)


def test_a_grid_that_its_bytes_cannot_hold_is_refused_before_it_is_allocated(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    edit_json(folder, lambda p: p.update(grid_width=1025, grid_height=1025, grid_depth=1025, block_size=1))
    (folder / "atlas_indices.png").write_bytes(claimed_png(1025, 1025 * 1025))
    with little_memory():
        refused(folder, "atlas_indices.png", "can hold")


def test_far_more_macroblocks_than_atlas_blocks_are_refused(tmp_path: Path) -> None:
    """Each would be copied to the graphics card, and looked through one by one."""
    folder = written(tmp_path / "pack")
    side, block = 40, small_pack().block_size
    edit_json(folder, lambda p: p.update({f"grid_{axis}": side * block for axis in ("width", "height", "depth")}))
    shared = np.zeros((side * side, side, 4), np.uint8)
    write_image(folder / "atlas_indices.png", shared)
    refused(folder, "atlas_indices.png", "64000 macroblocks share 1 blocks")
    shared[4096 // side :, :, :3] = 255  # few enough to be no burden, however they share
    write_image(folder / "atlas_indices.png", shared)
    assert load_pack(folder).occupied.sum() == 4096 // side * side


def test_pieces_are_no_deeper_than_the_grid_asks_for(tmp_path: Path) -> None:
    folder = tmp_path / "pack"
    save_pack(small_pack(), folder, codec="avif")
    step = small_pack().block_size
    edit_json(folder, lambda p: p["snerg"]["codec_settings"].update(planes=4096 // step * step))
    with little_memory():
        refused(folder, "planes is out of range")


@pytest.mark.parametrize("codec", ["png", "webp"])
def test_a_pack_for_which_memory_is_too_small_is_refused_with_both_sizes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, codec: str
) -> None:
    folder = tmp_path / "pack"
    save_pack(small_pack(), folder, codec=codec)
    monkeypatch.setattr("scenepack.budget.free_memory", lambda: 1000)
    refused(folder, "does not fit in memory", "GB", "lower resolution")


def test_json_of_more_than_16_mib_is_not_parsed(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    text = (folder / "scene_params.json").read_text()
    with zipfile.ZipFile(tmp_path / "pack.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in folder.iterdir():
            archive.write(file, file.name) if file.suffix != ".json" else None
        archive.writestr("scene_params.json", text[:-1] + ', "lists": [' + "[]," * (6 << 20) + "[]]}")
    with little_memory():
        refused(tmp_path / "pack.zip", "scene_params.json", "too large")
