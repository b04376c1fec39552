"""Films for the page, out of AVIF packs."""

import struct

import numpy as np
import pytest

from scenepack.codecs.avif import AvifCodec
from viewer.web.atlas_stream import film_in

FRAMES = 5


@pytest.fixture(scope="module")
def avif() -> bytes:
    frames = np.random.default_rng(0).integers(0, 255, (FRAMES, 32, 48, 3), np.uint8)
    return AvifCodec().film(frames, "rgb", 60)


def test_files_whose_samples_lie_otherwise_are_not_taken(avif: bytes) -> None:
    film = film_in(avif, FRAMES)
    assert film is not None and len(film.sizes) == FRAMES and film.codec.startswith("av01.1.")  # profile 1: 4:4:4
    assert film_in(avif, FRAMES + 1) is None and film_in(avif[:-1], FRAMES) is None and film_in(b"", FRAMES) is None

    def with_word(box: bytes, number: int, value: int) -> bytes:
        at = avif.index(box) + 8 + 4 * number
        return avif[:at] + struct.pack(">I", value) + avif[at + 4 :]

    for changed in (with_word(b"stsz", 0, 7), with_word(b"stsz", 2, 1 << 31), with_word(b"stco", 0, 2),
                    with_word(b"stco", 1, len(avif)), avif.replace(b"av1C", b"av2C")):  # fmt: skip
        assert film_in(changed, FRAMES) is None
