"""Streams: cubes of voxels as pictures of a film or an image sequence, without premultiplication.

Notation: c premultiplied colour or feature, a alpha, both 0 … 255; c̄ = c / a straight; ⟨·⟩ the mean over the 3³ neighbours
weighted 1 2 1 along each axis. A renderer adds up a·c̄, so that an error in c̄ counts a / 255 times; a codec does not know that,
and spends most of its bits on the noise of nearly transparent voxels. Therefore
- each voxel's c̄ is drawn towards its surroundings, the more the fainter it is:
  c̄ = (c + k·⟨c⟩/⟨a⟩) / (a + k), with k = `smoothing` in units of alpha: two thirds fewer bits at equal quality;
- empty voxels, whose colour is invisible, continue their neighbours by means over 2³, 4³, … voxels ("pull-push"), so that no edge
  is coded at the surface; voxels far from all content are grey.
All is done within cells of 16³ voxels, the unit of most codecs' own macroblocks: cells without content cost nothing.

A piece is [D, H, W]; its frames are its D planes, filled up to whole cells. Files of piece N: occupied_NNN.xz, which voxels have
any alpha, exactly; alpha, grey; rgb; feature, the first three channels; feature_w, the fourth, grey. What was empty decodes to
zero, what was not to an alpha of at least 1.
"""

import lzma
from math import prod
from typing import ClassVar

import numpy as np

from scenepack.codecs.base import Codec, CodecError, Decoded, Shape, cut_off, decoding, in_few_levels

CELL = 16  # voxels
GREY = 128
CELLS_AT_ONCE = 128


def padded(values: np.ndarray) -> np.ndarray:
    """[D, H, W, …] with rows and columns filled up to whole cells, by zeros."""
    return np.pad(values, [(0, 0), *((0, -side % CELL) for side in values.shape[1:3]), *[(0, 0)] * (values.ndim - 3)])


def premultiplied(values: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Straight values times alpha, uint8 [D, H, W, C]; never brighter than alpha, zero where alpha is zero."""
    _, height, width = alpha.shape
    return ((values[:, :height, :width].astype(np.uint16) * alpha[..., None] + 127) // 255).astype(np.uint8)


def filled(values: np.ndarray, alpha: np.ndarray, smoothing: float = 0.0, *, premultiplied: bool = False) -> np.ndarray:
    """uint8 [D, H, W, C] in whole cells: straight if it was `premultiplied`, and continued where alpha uint8 [D, H, W] is 0."""
    depth, height, width, channels = values.shape
    counts = tuple(-(-side // CELL) for side in (depth, height, width))
    result = np.full((depth, counts[1] * CELL, counts[2] * CELL, channels), GREY, np.uint8)
    cells = [tuple(slice(i * CELL, (i + 1) * CELL) for i in cell) for cell in np.ndindex(counts)]
    cells = [cell for cell in cells if alpha[cell].any()]
    for start in range(0, len(cells), CELLS_AT_ONCE):
        some = cells[start : start + CELLS_AT_ONCE]
        weight = np.zeros((len(some), CELL, CELL, CELL, 1), np.float32)
        colour = np.zeros((len(some), CELL, CELL, CELL, channels), np.float32)
        for i, cell in enumerate(some):
            d, h, w = alpha[cell].shape
            weight[i, :d, :h, :w, 0] = alpha[cell]
            colour[i, :d, :h, :w] = values[cell]
        if not premultiplied:
            weight = (weight > 0).astype(np.float32)
            colour *= weight
        elif smoothing > 0:
            surroundings = _blurred(colour) / np.maximum(_blurred(weight), 1e-6)
            inside = smoothing * (weight > 0)
            colour, weight = colour + inside * surroundings, weight + inside
        mean = _pull_push(colour, weight) * (255 if premultiplied else 1)
        cube = np.clip(np.rint(mean), 0, 255).astype(np.uint8)
        for i, cell in enumerate(some):
            d = result[cell].shape[0]
            result[cell] = cube[i, :d]
    return result


def _blurred(values: np.ndarray) -> np.ndarray:
    """Weights 1 2 1 along axes 1, 2, 3, zeros outside; not normalised."""
    for axis in (1, 2, 3):
        line = np.moveaxis(values, axis, 0)
        spread = 2 * line
        spread[1:] += line[:-1]
        spread[:-1] += line[1:]
        values = np.moveaxis(spread, 0, axis)
    return values


def _pull_push(total: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """total / weight [n, s, s, s, c], and where the weight is zero, that of the smallest 2³, 4³, … around with any."""
    mean = total / np.maximum(weight, 1e-6)
    side = total.shape[1]
    if side == 1:
        return mean
    pairs = (len(total), side // 2, 2, side // 2, 2, side // 2, 2, -1)
    coarse = _pull_push(total.reshape(pairs).sum((2, 4, 6)), weight.reshape(pairs).sum((2, 4, 6)))
    for axis in (1, 2, 3):
        coarse = coarse.repeat(2, axis)
    return np.where(weight > 0, mean, coarse)


# --- Lossy codecs that show a piece's planes as the frames of short films ---

CUBE = 2  # voxels a side that share a byte of the occupancy
FIRST_SMOOTHING, SMOOTHED_FROM = 8.0, 75.0  # in units of alpha, at this quality and below; none at 100
_XZ = b"\xfd7zXZ\x00"


class StreamCodec(Codec):
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
            return filled(values, alpha, k, premultiplied=True) if self.straight else padded(values)

        grey = filled(alpha[..., None], alpha)[..., 0] if self.straight else padded(alpha)
        files = [pack_occupancy(alpha > 0), self.film(grey, "alpha", quality)]
        files.append(self.film(colours(rgba[..., :3]), "rgb", quality))
        if features is not None:
            values, part = colours(features), "fine feature" if in_few_levels(features) else "feature"
            files.append(self.film(np.ascontiguousarray(values[..., :3]), part, quality))
            files.append(self.film(np.ascontiguousarray(values[..., 3]), part, quality))
        return tuple(files)

    def decode(self, files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool) -> Decoded:
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
        """uint8 frames [D, H, W] grey or [D, H, W, 3] coded; part: "alpha", "rgb", "feature", "fine feature" (in_few_levels)."""
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
    cubes = np.unpackbits(np.frombuffer(cubes_in(data, shape), np.uint8)).reshape(d, h, w, CUBE, CUBE, CUBE)
    occupied = cubes.transpose(0, 3, 1, 4, 2, 5).reshape(d * CUBE, h * CUBE, w * CUBE)
    return occupied[: shape[0], : shape[1], : shape[2]].astype(bool)


def cubes_in(data: bytes, shape: Shape) -> bytes:
    """What is in the xz of pack_occupancy: the bytes of cubes. CodecError or LZMAError."""
    count = prod(-(-side // CUBE) for side in shape)
    unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ)
    cubes = unpacker.decompress(data, max_length=count + 1)
    if len(cubes) != count or not unpacker.eof:
        raise CodecError(f"it holds {len(cubes)} bytes, expected {count}")
    return cubes


def _frames(shape: Shape) -> Shape:
    return shape[0], -(-shape[1] // CELL) * CELL, -(-shape[2] // CELL) * CELL
