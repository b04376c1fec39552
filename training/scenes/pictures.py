"""Decoding and shrinking of photographs.

Notation: a picture is float32 [H, W, 4] in [0, 1], RGB not premultiplied, alpha 1 where opaque; k the
downscale factor. Shrinking averages exactly over areas, of colour premultiplied by alpha, so that the
invisible RGB of transparent pixels does not bleed into edges.
"""

from __future__ import annotations

import io
import math
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError
from PIL.JpegImagePlugin import JpegImageFile

from console import UserError
from console.contents import HEAD_BYTES, told

Image.MAX_IMAGE_PIXELS = None  # gigapixel photographs are big, not an attack
# Pillow goes by a file's content, and knows formats that start other programs (Ghostscript for PostScript).
FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
# Of a mask that is all white, as DEFLATE stores it; photographs have a few. Pictures up to the latter size need not tell.
MOST_PIXELS_PER_BYTE, UNDOUBTED_PIXELS = 1100, 1 << 24
# A JPEG goes over all its pixels once for each scan, which may have 30 bytes: cameras write 1, other programs 10 to 64.
MOST_SCANS, SCAN = 100, b"\xff\xda"
BAND_PIXELS = 1 << 21  # that are shrunk at once: 32 MiB of floats
# What Pillow raises for damaged files; its readers were not written with one error in mind.
UNREADABLE = (
    OSError, SyntaxError, ValueError, AssertionError, LookupError, TypeError, ArithmeticError, AttributeError, EOFError,
    struct.error, zlib.error,
)  # fmt: skip
MASK_SUFFIXES = (".png", ".jpg", ".jpeg")
_EXPECTED = "PNG, JPEG, WebP, TIFF or BMP"


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) of a picture from its header. UserError where it is missing or no picture."""
    if not os.path.isfile(path):  # also where the system would not even look for such a name
        raise UserError("picture not found", where=path, remedy="the scene lists it; restore it or remove its frame")
    try:
        with opened(path) as image:
            return image.size
    except UnidentifiedImageError as error:
        found = told(_head(path))
        raise UserError("not a readable picture", where=path, expected=_EXPECTED, found=found) from error
    except UNREADABLE as error:
        raise UserError("not a readable picture", where=path, expected=_EXPECTED, found=_short(error)) from error


def find_mask(folder: Path, name: str) -> Path | None:
    """The mask of a picture in a folder of masks: NAME.png as COLMAP calls its own, the same name, or NAME_mask."""
    exact = folder / name
    stem = exact.with_suffix("")
    candidates = [folder / f"{name}.png", *(stem.with_suffix(suffix) for suffix in MASK_SUFFIXES), exact]
    candidates.append(stem.with_name(stem.name + "_mask.png"))
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def may_be_transparent(path: Path) -> bool:
    """Whether a picture has alpha at all, from its header. UserError where it is missing or no picture."""
    picture_size(path)
    with opened(path) as image:
        return image.has_transparency_data


def read_picture(path: Path) -> np.ndarray:
    """Decodes 8 or 16 bit grey, RGB(A) or palette pictures to float32 [H, W, 4]. UserError where that fails."""
    return with_alpha(as_floats(decoded(path)))


def decoded(path: Path) -> np.ndarray:
    """What read_picture decodes, as it is stored: uint8 [H, W, 3 or 4], float32 [H, W, 3] where that has 16 bits."""
    picture_size(path)
    try:
        with decodable(path) as image:
            if image.mode.startswith("I"):  # 16 bit grey
                return np.repeat(np.asarray(image, np.float32)[..., None] / 65535.0, 3, axis=-1)
            mode = "RGBA" if image.has_transparency_data else "RGB"
            return np.asarray(image if image.mode == mode else image.convert(mode))
    except UNREADABLE as error:
        raise UserError(
            "the picture cannot be decoded",
            where=path,
            found=_short(error),
            remedy="it may be truncated: copy it again",
        ) from error


def as_floats(picture: np.ndarray) -> np.ndarray:
    """uint8 as float32 in [0, 1]; what is float32 stays."""
    return picture.astype(np.float32) / np.float32(255.0) if picture.dtype == np.uint8 else picture


def with_alpha(picture: np.ndarray) -> np.ndarray:
    """float32 [H, W, 3 or 4] as [H, W, 4]: opaque where it has no alpha."""
    if picture.shape[-1] == 4:
        return picture
    return np.concatenate([picture, np.ones_like(picture[..., :1])], axis=-1)


def as_bytes(picture: np.ndarray) -> np.ndarray:
    """float32 in [0, 1] as uint8, rounded; what is uint8 stays."""
    return picture if picture.dtype == np.uint8 else np.rint(picture * 255.0).astype(np.uint8)


@contextmanager
def opened(path: Path, formats: tuple[str, ...] = FORMATS) -> Iterator[Image.Image]:
    """The picture, its pixels not decoded yet. OSError where its header claims more of them than its bytes can hold."""
    with _Bounded(io.FileIO(path)) as file, Image.open(file, formats=formats) as image:
        most = MOST_PIXELS_PER_BYTE * os.path.getsize(path) * (8 if image.mode == "1" else 1)
        if image.width * image.height > max(most, UNDOUBTED_PIXELS):
            raise OSError(
                f"its header claims {times(image.size)} pixels, more than {os.path.getsize(path)} bytes can hold"
            )
        yield image


@contextmanager
def decodable(path: Path, formats: tuple[str, ...] = FORMATS) -> Iterator[Image.Image]:
    """The same, whose pixels take no longer than its size explains: so it may be decoded here, without a process and a clock."""
    with opened(path, formats) as image:
        if isinstance(image, JpegImageFile) and (scans := _scans(path)) > MOST_SCANS:
            raise OSError(f"it has {scans} scans; at most {MOST_SCANS} are read")
        yield image


def _scans(path: Path) -> int:
    """How many scans a JPEG has. Its marker stands nowhere else in compressed data; a copy for the camera's screen has some."""
    count, last = 0, b""
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            count += (last + block).count(SCAN)
            last = block[-1:]
    return count


class _Bounded(io.BufferedReader):
    """A file that is never asked for more than it has: room for all that is asked for would be made at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(os.fstat(self.fileno()).st_size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD_BYTES)


def shrunk_size(width: int, height: int, downscale: int) -> tuple[int, int]:
    """(width, height) after a downscale by an integer >= 1; fractions are floored and the area stretched to fit."""
    if width // downscale < 1 or height // downscale < 1:
        raise UserError(
            "downscale leaves no picture",
            where=f"--downscale {downscale}",
            found=f"{width}x{height}",
            remedy="use a smaller factor",
        )
    return width // downscale, height // downscale


def shrink(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """Area average of a picture [H, W, 3 or 4] to [height, width, ...], premultiplied by alpha while averaging."""
    if picture.shape[:2] == (height, width):
        return picture
    if picture.shape[-1] == 3 or np.all(picture[..., 3] == 1.0):
        return area_average(area_average(picture, height, 0), width, 1)
    weighted = np.concatenate([picture[..., :3] * picture[..., 3:], picture[..., 3:]], axis=-1)
    mean = area_average(area_average(weighted, height, 0), width, 1)
    alpha = mean[..., 3:]
    straight = np.where(alpha > 0, mean[..., :3] / np.maximum(alpha, 1e-8), 0.0)
    return np.concatenate([np.clip(straight, 0, 1), alpha], axis=-1).astype(np.float32)


def shrunk_bytes(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """`shrink` of a picture uint8 or float32 [H, W, 3 or 4], rounded to uint8: some rows at a time, so that floats of the whole
    picture are never held."""
    if picture.shape[:2] == (height, width):
        return as_bytes(picture)
    parts = math.gcd(picture.shape[0], height)  # bands of so many rows begin where a row of the result does
    rows, rows_out = picture.shape[0] // parts, height // parts
    together = max(BAND_PIXELS // (rows * picture.shape[1]), 1)
    bands = []
    for first in range(0, parts, together):
        last = min(first + together, parts)
        band = as_floats(picture[first * rows : last * rows])
        bands.append(as_bytes(shrink(band, width, (last - first) * rows_out)))
    return np.concatenate(bands)


def area_average(values: np.ndarray, size: int, axis: int) -> np.ndarray:
    """Means over `size` equal intervals of an axis, cells cut by an interval's end counted by their share."""
    values = np.moveaxis(values, axis, 0)
    cells = values.shape[0]
    if cells % size == 0:
        mean = values.reshape(size, cells // size, *values.shape[1:]).mean(axis=1)
    else:
        # row i of `share`: how much of each cell lies in interval i
        edges = np.arange(size + 1) * (cells / size)
        low, high = edges[:-1, None], edges[1:, None]
        cell = np.arange(cells)[None]
        share = np.clip(np.minimum(high, cell + 1) - np.maximum(low, cell), 0, 1) * (size / cells)
        mean = np.tensordot(share.astype(np.float32), values, axes=1)
    return np.moveaxis(mean, 0, axis)


@dataclass(frozen=True)
class PictureLoader:
    """A Photograph.load of a file: decodes `path`, checks that it still has source_size, applies a mask, shrinks to `size`.

    mask: a picture of the same size; black hides (alpha 0), white shows. Sizes are (width, height).
    """

    path: Path
    source_size: tuple[int, int]
    size: tuple[int, int]
    mask: Path | None = None

    def __call__(self) -> np.ndarray:
        return shrink(with_alpha(as_floats(self._decoded())), *self.size)

    def pixels(self) -> np.ndarray:
        """The same as uint8 [H, W, 3 or 4], without ever holding floats of a whole photograph."""
        return shrunk_bytes(self._decoded(), *self.size)

    def _decoded(self) -> np.ndarray:
        """The picture in full size, as `decoded` gives it, what the mask hides transparent."""
        picture = decoded(self.path)
        self._check(self.path, picture.shape[1::-1], "the picture")
        if self.mask is None:
            return picture
        shown = decoded(self.mask)
        self._check(self.mask, shown.shape[1::-1], "the mask")
        alpha = as_floats(shown[..., :1])
        if picture.shape[-1] == 4:
            alpha = as_floats(picture[..., 3:]) * alpha
        if picture.dtype == np.uint8:
            alpha = as_bytes(alpha)
        return np.concatenate([picture[..., :3], alpha], axis=-1)

    def may_be_transparent(self) -> bool:
        """Whether there may be alpha below 1, from the picture's header."""
        return self.mask is not None or may_be_transparent(self.path)

    def thumbnail(self, side: int) -> Image.Image:
        """The picture in RGBA, at most `side` pixels a side; a JPEG is decoded at no more than it takes. Errors as above."""
        picture_size(self.path)
        try:
            small = _small(self.path, side, "RGBA")
            if self.mask is not None:
                small.putalpha(_small(self.mask, side, "L").resize(small.size))
        except UNREADABLE as error:
            raise UserError("the picture cannot be decoded", where=self.path, found=_short(error)) from error
        return small

    def _check(self, path: Path, found: Sequence[int], what: str) -> None:
        if tuple(found) != self.source_size:
            raise UserError(
                f"{what} is of another size",
                where=path,
                expected=times(self.source_size),
                found=times(found),
                remedy="the file changed after the scene was read",
            )


def _small(path: Path, side: int, mode: str) -> Image.Image:
    with decodable(path) as image:
        image.draft("RGB", (2 * side, 2 * side))
        if image.mode.startswith("I"):  # 16 bit; Pillow clips where it should scale
            picture = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8)).convert(mode)
        else:
            picture = image.convert(mode)
    picture.thumbnail((side, side), Image.Resampling.BOX, reducing_gap=2.0)
    return picture


def over_background(picture: np.ndarray, background: Sequence[float]) -> np.ndarray:
    """A picture [..., 3 or 4] in [0, 1] composited over a colour: float32 [..., 3]."""
    if picture.shape[-1] == 3:
        return picture.astype(np.float32)
    alpha = picture[..., 3:]
    return (picture[..., :3] * alpha + np.asarray(background, np.float32) * (1 - alpha)).astype(np.float32)


def times(size: Sequence[int]) -> str:
    """A size for messages."""
    return f"{size[0]}x{size[1]}"


def _short(error: Exception) -> str:
    """The first sentence of a decoder's complaint, without the path that we print already."""
    return str(error).split("\n")[0][:120] or type(error).__name__
