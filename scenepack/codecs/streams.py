"""Lossy codecs that show a piece's planes as the frames of short films.

Notation: a piece is [D, H, W]; its frames are its D planes, filled up to whole cells of 16 (the macroblocks of video
codecs). Files of piece N: occupied_NNN.xz, which voxels have any alpha, exactly; alpha, grey; rgb; feature, the first
three channels; feature_w, the fourth, grey. What was empty decodes to zero, what was not to an alpha of at least 1.
"""

from __future__ import annotations

import lzma
from typing import ClassVar

import numpy as np

from scenepack.codecs.base import CodecError, Shape, cut_off, decoding
from scenepack.codecs.unpremultiply import CELL, filled, padded, premultiplied, unpremultiply

CUBE = 2  # voxels a side that share a byte of the occupancy
FIRST_SMOOTHING, SMOOTHED_FROM = 8.0, 75.0  # in units of alpha, at this quality and below; none at 100
_XZ = b"\xfd7zXZ\x00"


class StreamCodec:
    """What h264 and avif share; see the module. straight: colours are stored straight, else premultiplied."""

    straight: ClassVar[bool]
    suffix: ClassVar[str]

    def names(self, number: int, shape: Shape, features: bool) -> tuple[str, ...]:
        end = f"{number:03d}.{self.suffix}"
        names = (f"occupied_{number:03d}.xz", f"alpha_{end}", f"rgb_{end}")
        return (*names, f"feature_{end}", f"feature_w_{end}") if features else names

    def check(self, name: str, head: bytes, shape: Shape) -> None:
        if len(head) < len(_XZ):
            raise cut_off(head)
        if not name.endswith(".xz"):
            self.check_film(head, _frames(shape))
        elif not head.startswith(_XZ):
            raise CodecError("it is not an .xz")

    def encode(self, rgba: np.ndarray, features: np.ndarray | None, quality: int) -> tuple[bytes, ...]:
        alpha = np.ascontiguousarray(rgba[..., 3])
        k = FIRST_SMOOTHING * min(1.0, (100 - quality) / (100 - SMOOTHED_FROM))

        def colours(values: np.ndarray) -> np.ndarray:
            return unpremultiply(values, alpha, k) if self.straight else padded(values, 0)

        grey = filled(alpha[..., None], alpha)[..., 0] if self.straight else padded(alpha, 0)
        files = [pack_occupancy(alpha > 0), self.film(grey, "alpha", quality)]
        files.append(self.film(colours(rgba[..., :3]), "rgb", quality))
        if features is not None:
            values = colours(features)
            files.append(self.film(np.ascontiguousarray(values[..., :3]), "feature", quality))
            files.append(self.film(np.ascontiguousarray(values[..., 3]), "feature", quality))
        return tuple(files)

    def decode(
        self, files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool
    ) -> tuple[np.ndarray, np.ndarray | None]:
        _, height, width = shape
        frames = _frames(shape)
        with decoding(names[0]):
            occupied = unpack_occupancy(files[names[0]], shape)
        with decoding(names[1]):
            alpha = self.frames(files[names[1]], frames, colour=False)[:, :height, :width]
        alpha = np.where(occupied, np.maximum(alpha, 1), 0).astype(np.uint8)

        def colours(name: str, colour: bool) -> np.ndarray:
            with decoding(name):
                values = self.frames(files[name], frames, colour=colour).reshape(*frames, -1)
            if self.straight:
                return premultiplied(values, alpha)
            return np.minimum(values[:, :height, :width], alpha[..., None])

        rgba = np.concatenate([colours(names[2], True), alpha[..., None]], axis=-1)
        if not features:
            return rgba, None
        return rgba, np.concatenate([colours(names[3], True), colours(names[4], False)], axis=-1)

    def film(self, frames: np.ndarray, part: str, quality: int) -> bytes:
        """uint8 frames [D, H, W] grey or [D, H, W, 3] coded; part: "alpha", "rgb" or "feature"."""
        raise NotImplementedError

    def frames(self, data: bytes, shape: Shape, *, colour: bool) -> np.ndarray:
        """The frames back, uint8 [D, H, W] or [D, H, W, 3]. Raises anything."""
        raise NotImplementedError

    def check_film(self, head: bytes, shape: Shape) -> None:
        """CodecError where a film's first header_bytes tell that it is none of these frames."""
        raise NotImplementedError


def pack_occupancy(occupied: np.ndarray) -> bytes:
    """bool [D, H, W] as xz of one byte for each cube of 2³ voxels, which compresses better than rows of bits."""
    even = np.pad(occupied, [(0, side % CUBE) for side in occupied.shape])
    d, h, w = (side // CUBE for side in even.shape)
    cubes = even.reshape(d, CUBE, h, CUBE, w, CUBE).transpose(0, 2, 4, 1, 3, 5)
    return lzma.compress(np.packbits(cubes).tobytes(), preset=6)


def unpack_occupancy(data: bytes, shape: Shape) -> np.ndarray:
    """The inverse of pack_occupancy. CodecError or LZMAError."""
    d, h, w = (-(-side // CUBE) for side in shape)
    unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ)
    packed = unpacker.decompress(data, max_length=d * h * w + 1)
    if len(packed) != d * h * w or not unpacker.eof:
        raise CodecError(f"it holds {len(packed)} bytes, expected {d * h * w}")
    cubes = np.unpackbits(np.frombuffer(packed, np.uint8)).reshape(d, h, w, CUBE, CUBE, CUBE)
    occupied = cubes.transpose(0, 3, 1, 4, 2, 5).reshape(d * CUBE, h * CUBE, w * CUBE)
    return occupied[: shape[0], : shape[1], : shape[2]].astype(bool)


def _frames(shape: Shape) -> Shape:
    return shape[0], -(-shape[1] // CELL) * CELL, -(-shape[2] // CELL) * CELL
