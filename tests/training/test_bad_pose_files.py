"""poses_bounds.npy of anybody's making: refused in one line, before what its header claims is believed."""

from __future__ import annotations

import io
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.training.test_captures import complaint, forward, write_llff
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
        shaped("(1000000000, 17)"),
        shaped("(-1, 17)"),
        shaped("(True, 17)"),
        shaped("(10, 17)", "'O'"),
        shaped("(10, 17)", "[('a', '<f8')]"),
        with_header("(" * 5000),
        with_header("lambda: 0"),
        with_header("\0\0\0"),
        with_header("x" * 40, version=b"\2\0"),
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


@pytest.mark.parametrize("change", [np.asfortranarray, lambda rows: rows.astype(">f4"), np.float32])
def test_files_as_other_programs_write_them_are_read_all_the_same(
    tmp_path: Path, change: Callable[[np.ndarray], np.ndarray]
) -> None:
    path = write_llff(tmp_path, forward())
    before = load_scene(path).splits["train"][2].camera.world_T_camera
    np.save(path / "poses_bounds.npy", change(np.load(path / "poses_bounds.npy")))
    np.testing.assert_allclose(load_scene(path).splits["train"][2].camera.world_T_camera, before, atol=1e-5)
