"""poses_bounds.npy of anybody's making: refused in one line, before what its header claims is believed."""

from __future__ import annotations

import io
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.training.test_captures import circle, complaint, forward, write_llff
from training.scenes import load_scene

ROWS = np.ones((10, 17))


def with_header(text: str, data: bytes = ROWS.tobytes(), version: bytes = b"\1\0") -> bytes:
    """A .npy file whose header is `text`."""
    head = text.encode() + b"\n"
    size = struct.pack("<H" if version[0] == 1 else "<I", len(head))
    return b"\x93NUMPY" + version + size + head + data


def shaped(shape: str, kind: str = "'<f8'", more: str = "") -> bytes:
    return with_header(f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}{more}}}")


def archive() -> bytes:
    file = io.BytesIO()
    np.savez(file, ROWS)
    return file.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        archive(),
        shaped("(1000000000, 17)"),  # 127 GiB
        shaped("(100000000000000000000, 17)"),
        shaped("(-1, 17)"),
        shaped("(0, 17)"),
        shaped("(10, 0)"),
        shaped("(True, 17)"),
        shaped("10"),
        shaped("('10', 17)"),
        shaped("(10, 17)", "'O'"),
        shaped("(10, 17)", "'<c16'"),
        shaped("(10, 17)", "'<M8[s]'"),
        shaped("(10, 17)", "'nonsense'"),
        shaped("(10, 17)", "[('a', '<f8')]"),
        shaped("(10, 17)", "None"),
        shaped("(10, 17)", more=", 'x': 1"),
        with_header("(" * 5000),
        with_header("{" * 200),
        with_header("-" * 9000 + "1"),
        with_header("lambda: 0"),
        with_header("{'descr': '<f8'"),
        with_header("\0\0\0"),
        with_header("'" + "9" * 9000),
        with_header("9" * 9000),
        with_header("x" * 40, version=b"\2\0"),
        with_header("x" * 40, version=b"\3\0"),
        with_header("x" * 40, version=b"\xff\xff"),
        with_header("", b""),
        b"\x93NUMPY",
        b"\x93NUMPY\1\0\xff\xff",
        b"",
    ],
)
def test_a_header_that_says_nonsense_is_refused(tmp_path: Path, data: bytes) -> None:
    path = write_llff(tmp_path, forward())
    (path / "poses_bounds.npy").write_bytes(data)
    tracemalloc.start()
    words = complaint(path)
    assert tracemalloc.get_traced_memory()[1] < 64 << 20
    tracemalloc.stop()
    assert "poses_bounds.npy" in words and len(words) < 400


def at_one_place(P: np.ndarray) -> np.ndarray:
    P[:, :3, 3] = 0
    return P


def far_away(P: np.ndarray) -> np.ndarray:
    P[:, :3, 3] *= 1e250
    return P


def upside_down_in_pairs(P: np.ndarray) -> np.ndarray:
    P[::2, :3, :2] *= -1  # so that no direction is up
    return P


@pytest.mark.parametrize(
    ("spoil", "words"),
    [(at_one_place, "stand at the point"), (far_away, "too large"), (upside_down_in_pairs, "placed")],
)
def test_cameras_of_which_no_scene_comes_are_refused(
    tmp_path: Path, spoil: Callable[[np.ndarray], np.ndarray], words: str
) -> None:
    around = spoil is not upside_down_in_pairs
    path = write_llff(tmp_path, spoil(circle(8) if around else np.repeat(forward(1), 8, axis=0)))
    assert words in complaint(path, spherify=around)


def test_pictures_of_no_size_are_refused(tmp_path: Path) -> None:
    path = write_llff(tmp_path, forward())
    rows = np.load(path / "poses_bounds.npy")
    rows[:, [4, 9]] = 0.2  # height and width
    np.save(path / "poses_bounds.npy", rows)
    assert "must be positive" in complaint(path)


@pytest.mark.parametrize("change", [np.asfortranarray, lambda rows: rows.astype(">f4"), np.float32])
def test_files_as_other_programs_write_them_are_read_all_the_same(
    tmp_path: Path, change: Callable[[np.ndarray], np.ndarray]
) -> None:
    path = write_llff(tmp_path, forward())
    before = load_scene(path).splits["train"][2].camera.world_T_camera
    np.save(path / "poses_bounds.npy", change(np.load(path / "poses_bounds.npy")))
    np.testing.assert_allclose(load_scene(path).splits["train"][2].camera.world_T_camera, before, atol=1e-5)
