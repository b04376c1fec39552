"""A .zip whose directory says nonsense is a dialog or a line, whoever looks into it."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from console import UserError
from scenepack import load_pack
from tests.scenepack.helpers import small_pack, written
from viewer.core.files import kind_of


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return written(tmp_path_factory.mktemp("zips") / "pack.zip", small_pack()).read_bytes()


def entry(field: int, value: bytes) -> Callable[[bytes], bytes]:
    """Spoils a field of the directory's first entry, whose fixed part has 46 bytes."""

    def spoil(data: bytes) -> bytes:
        at = data.index(b"PK\1\2") + field
        return data[:at] + value + data[at + len(value) :]

    return spoil


@pytest.mark.parametrize(
    "spoil",
    [
        entry(6, b"\x47\0"),  # version needed: 7.1
        lambda data: entry(8, struct.pack("<H", 0x800))(entry(46, b"\x80\xff")(data)),  # a name that is no UTF-8
        lambda data: entry(28, struct.pack("<H", 0))(data),  # no name
        entry(10, b"\x63\0"),  # a method of compression that nobody knows
        entry(8, b"\1\0"),  # encrypted
        entry(42, b"\xff\xff\xff\x7f"),  # beyond the end
    ],
    ids=["version", "name", "no name", "method", "encrypted", "offset"],
)
def test_a_directory_that_says_nonsense_is_refused_in_one_line(
    whole: bytes, tmp_path: Path, spoil: Callable[[bytes], bytes]
) -> None:
    file = tmp_path / "pack.zip"
    file.write_bytes(spoil(whole))
    assert kind_of(file) in ("pack", "unknown")
    with pytest.raises(UserError, match=r"pack\.zip"):
        load_pack(file)


@pytest.mark.filterwarnings("ignore::scenepack.PackWarning")
def test_whatever_the_directory_says_nothing_but_a_refusal_comes_of_it(whole: bytes, tmp_path: Path) -> None:
    dice, start, file = random.Random(4), whole.index(b"PK\1\2"), tmp_path / "pack.zip"
    for _ in range(150):
        data = bytearray(whole)
        for _ in range(dice.randint(1, 6)):
            data[dice.randrange(start, len(data))] = dice.choice([0, 255, 128, dice.randrange(256)])
        file.write_bytes(data)
        kind_of(file)
        try:
            load_pack(file)
        except UserError as error:
            assert "\n" not in str(error)
