"""What cannot be opened says so in one clear line that names the file or the key."""

import shutil
import struct
import tracemalloc
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from console import UserError
from scenepack import load_pack, save_pack
from tests.fuzz.png import png_chunks, png_of
from tests.scenepack.helpers import edit_json, read_image, read_json, small_pack, write_image, written


def refused(path: Path, *words: str) -> None:
    with pytest.raises(UserError) as caught, warnings.catch_warnings():
        warnings.simplefilter("error")  # what is refused has nothing else to say
        load_pack(path)
    line = str(caught.value)
    assert "\n" not in line and len(line) < 500
    for word in words:
        assert word in line, line


def test_what_is_missing_empty_or_without_the_json_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "nothing", "nothing", "does not exist")
    refused(tmp_path / "nothing.zip", "does not exist")
    refused(tmp_path, "no files", "scene_params.json")
    (tmp_path / "photo.jpg").write_bytes(b"x")
    refused(tmp_path, "not a pack", "photo.jpg")


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
    ],
)
def test_a_value_out_of_range_is_refused(tmp_path: Path, key: str, value: Any) -> None:
    folder = written(tmp_path / "pack")
    edit_json(folder, lambda p: p.update({key: value}))
    refused(folder)


def test_a_forward_facing_pack_needs_a_usable_camera(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack", small_pack(ndc=True))
    right = read_json(folder)
    for key, value in (("input_width", 0), ("input_height", "wide"), ("input_focal", float("nan"))):
        edit_json(folder, lambda p, key=key, value=value: p.update({**right, key: value}))
        refused(folder, key)
    for key in ("input_width", "input_height"):
        edit_json(folder, lambda p, key=key: (p.update(right), p.pop(key)))
        refused(folder, key, "missing")


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
    refused(folder, name, *words)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_indices_that_point_outside_of_the_atlas_are_refused(tmp_path: Path, axis: int) -> None:
    pack = small_pack()
    folder = written(tmp_path / "pack", pack)
    image = read_image(folder / "atlas_indices.png")
    row, column = np.argwhere(image[..., 0] != 255)[0]
    image[row, column, axis] = pack.atlas_blocks[axis]
    write_image(folder / "atlas_indices.png", image)
    refused(folder, "atlas_indices.png", "outside of the atlas", "expected", "found")


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    folder = written(tmp_path / "pack")
    image = folder / "rgba_000.png"
    image.write_bytes(image.read_bytes() + b"\0" * (8 << 20))
    refused(Path(shutil.make_archive(str(folder), "zip", folder)), "rgba_000.png", "too large")


def header(width: int, height: int) -> tuple[bytes, bytes]:
    """The chunk of a PNG that says how large a picture of RGBA it is."""
    return b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)


def claimed_png(width: int, height: int) -> bytes:
    """A PNG of RGBA whose header claims what its few bytes cannot hold."""
    return png_of([header(width, height), (b"IDAT", zlib.compress(bytes(1000), 9)), (b"IEND", b"")])


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
    first, *others = png_chunks(file.read_bytes())
    file.write_bytes(png_of([first, header(40_000, 50_000), *others]))
    with little_memory():
        refused(folder, "rgba_000.png", "more than one header")


def test_an_atlas_or_a_grid_that_its_bytes_cannot_hold_is_refused_before_it_is_allocated(tmp_path: Path) -> None:
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
    edit_json(folder, lambda p: p.update(grid_width=1025, grid_height=1025, grid_depth=1025, block_size=1))
    (folder / "atlas_indices.png").write_bytes(claimed_png(1025, 1025 * 1025))
    with little_memory():
        refused(folder, "atlas_indices.png", "can hold")


@pytest.mark.parametrize("codec", ["png", "webp"])
def test_a_pack_for_which_memory_is_too_small_is_refused_with_both_sizes(tmp_path, monkeypatch, codec):
    folder = tmp_path / "pack"
    save_pack(small_pack(), folder, codec=codec)
    monkeypatch.setattr("scenepack.files.free_memory", lambda: 1000)
    refused(folder, "does not fit in memory", "GB", "lower resolution")
