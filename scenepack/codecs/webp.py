"""WebP, lossless: each piece's planes one below another, RGBA, in as few pictures as WebP's size limit allows."""

from functools import partial

import imagecodecs
import numpy as np

from scenepack.codecs.base import Codec, CodecError, Decoded, Shape, cut_off, decoding

MAX_SIDE = 16383  # pixels of a WebP
METHOD = 4  # of 0 … 6; 6 takes four times as long for one per cent less
EFFORT = 50  # 100 takes twice as long for a thousandth fewer bytes


class WebpCodec(Codec):
    """rgba_NNN_I.webp and feature_NNN_I.webp: picture I of piece N."""

    name = "webp"
    layout = "grid"
    header_bytes = 64

    def names(self, number: int, shape: Shape, features: bool) -> tuple[str, ...]:
        parts = ("rgba", "feature") if features else ("rgba",)
        return tuple(f"{part}_{number:03d}_{i}.webp" for part in parts for i in range(len(_rows(shape))))

    def check(self, name: str, head: bytes, shape: Shape) -> None:
        first, end = _rows(shape)[_number(name)]
        expected, found = (shape[2], (end - first) * shape[1]), _size(head)
        if found != expected:
            raise CodecError(f"it is {found[0]}×{found[1]} pixels, expected {expected[0]}×{expected[1]}")

    def encode(self, rgba: np.ndarray, features: np.ndarray | None, quality: int) -> tuple[bytes, ...]:
        parts = [part for part in (rgba, features) if part is not None]
        pictures = [part[first:end].reshape(-1, *part.shape[2:]) for part in parts for first, end in _rows(part.shape)]
        encode = partial(imagecodecs.webp_encode, level=EFFORT, lossless=True, method=METHOD)
        return tuple(bytes(encode(np.ascontiguousarray(picture))) for picture in pictures)

    def decode(self, files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool) -> Decoded:
        rgba, feature = (np.empty((*shape, 4), np.uint8) for _ in range(2))
        for name in names:
            first, end = _rows(shape)[_number(name)]
            target = (rgba if name.startswith("rgba") else feature)[first:end]
            with decoding(name):
                self.check(name, files[name], shape)
                target[...] = imagecodecs.webp_decode(files[name], hasalpha=True).reshape(target.shape)
        return rgba, feature if features else None


def _rows(shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """The planes (first, end) of each picture."""
    step = max(1, MAX_SIDE // shape[1])
    return [(z, min(z + step, shape[0])) for z in range(0, shape[0], step)]


def _number(name: str) -> int:
    return int(name.rsplit("_", 1)[1].partition(".")[0])


def _size(head: bytes) -> tuple[int, int]:
    """Width and height from the header of a lossless WebP."""
    if len(head) < 30:
        raise cut_off(head)
    if head[:4] != b"RIFF" or head[8:16] != b"WEBPVP8L" or head[20] != 0x2F:
        raise CodecError("it is not a lossless WebP")
    bits = int.from_bytes(head[21:25], "little")
    return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
