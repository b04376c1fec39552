"""Decoding and shrinking of photographs.

Notation: a picture is float32 [H, W, 4] in [0, 1], RGB not premultiplied, alpha 1 where opaque; k the
downscale factor. Shrinking averages exactly over areas, of colour premultiplied by alpha, so that the
invisible RGB of transparent pixels does not bleed into edges.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from console import UserError
from console.contents import HEAD_BYTES, told
from training.scenes.scene import Photograph

Image.MAX_IMAGE_PIXELS = None  # gigapixel photographs are big, not an attack
# Pillow goes by a file's content, and knows formats that start other programs (Ghostscript for PostScript).
FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
_EXPECTED = "PNG, JPEG, WebP, TIFF or BMP"


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) of a picture from its header. UserError where it is missing or no picture."""
    if not os.path.isfile(path):  # also where the system would not even look for such a name
        raise UserError("picture not found", where=path, remedy="the scene lists it; restore it or remove its frame")
    try:
        with _opened(path) as image:
            return image.size
    except UnidentifiedImageError as error:
        found = told(_head(path))
        raise UserError("not a readable picture", where=path, expected=_EXPECTED, found=found) from error
    except (OSError, SyntaxError, ValueError) as error:
        raise UserError("not a readable picture", where=path, expected=_EXPECTED, found=_short(error)) from error


def read_picture(path: Path) -> np.ndarray:
    """Decodes 8 or 16 bit grey, RGB(A) or palette pictures to float32 [H, W, 4]. UserError where that fails."""
    picture_size(path)
    try:
        with _opened(path) as image:
            if image.mode.startswith("I"):  # 16 bit grey
                grey = np.asarray(image, np.float32)[..., None] / 65535.0
                return np.concatenate([np.repeat(grey, 3, axis=-1), np.ones_like(grey)], axis=-1)
            return np.asarray(image.convert("RGBA"), np.float32) / np.float32(255.0)
    except (OSError, SyntaxError, ValueError) as error:
        raise UserError(
            "the picture cannot be decoded",
            where=path,
            found=_short(error),
            remedy="it may be truncated: copy it again",
        ) from error


def _opened(path: Path) -> Image.Image:
    return Image.open(path, formats=FORMATS)


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
    """Area average of a picture [H, W, 4] to [height, width, 4], premultiplied by alpha while averaging."""
    if picture.shape[:2] == (height, width):
        return picture
    if np.all(picture[..., 3] == 1.0):
        return area_average(area_average(picture, height, 0), width, 1)
    weighted = np.concatenate([picture[..., :3] * picture[..., 3:], picture[..., 3:]], axis=-1)
    mean = area_average(area_average(weighted, height, 0), width, 1)
    alpha = mean[..., 3:]
    straight = np.where(alpha > 0, mean[..., :3] / np.maximum(alpha, 1e-8), 0.0)
    return np.concatenate([np.clip(straight, 0, 1), alpha], axis=-1).astype(np.float32)


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
        picture = read_picture(self.path)
        self._check(self.path, picture.shape[1::-1], "the picture")
        if self.mask is not None:
            shown = read_picture(self.mask)
            self._check(self.mask, shown.shape[1::-1], "the mask")
            picture = np.concatenate([picture[..., :3], picture[..., 3:] * shown[..., :1]], axis=-1)
        return shrink(picture, *self.size)

    def thumbnail(self, side: int) -> Image.Image:
        """The picture in RGBA, at most `side` pixels a side; a JPEG is decoded at no more than it takes. Errors as above."""
        picture_size(self.path)
        try:
            small = _small(self.path, side, "RGBA")
            if self.mask is not None:
                small.putalpha(_small(self.mask, side, "L").resize(small.size))
        except (OSError, SyntaxError, ValueError) as error:
            raise UserError("the picture cannot be decoded", where=self.path, found=_short(error)) from error
        return small

    def _check(self, path: Path, found: Sequence[int], what: str) -> None:
        if tuple(found) != self.source_size:
            raise UserError(
                f"{what} is of another size",
                where=path,
                expected=_times(self.source_size),
                found=_times(found),
                remedy="the file changed after the scene was read",
            )


def _small(path: Path, side: int, mode: str) -> Image.Image:
    with _opened(path) as image:
        image.draft("RGB", (2 * side, 2 * side))
        if image.mode.startswith("I"):  # 16 bit; Pillow clips where it should scale
            picture = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8)).convert(mode)
        else:
            picture = image.convert(mode)
    picture.thumbnail((side, side), Image.Resampling.BOX, reducing_gap=2.0)
    return picture


def load_pixels(photographs: Sequence[Photograph], first: int = 0, last: int | None = None) -> np.ndarray:
    """Pixels uint8 [last - first, 4] of photographs laid end to end, row by row; their sizes may differ.

    Only those photographs are decoded (in threads) that have a pixel in [first, last); beyond the last pixel all is 0.
    UserError where a picture fails to decode, or is not of its camera's size.
    """
    if not photographs:
        raise UserError("no pictures to load", expected="at least one")
    sizes = np.array([p.camera.width * p.camera.height for p in photographs])
    starts = np.cumsum(sizes) - sizes
    last = int(sizes.sum()) if last is None else last
    pixels = np.zeros((last - first, 4), np.uint8)

    def decode(index: int) -> None:
        photograph, start = photographs[index], int(starts[index])
        picture = photograph.load()
        if picture.shape[:2] != (photograph.camera.height, photograph.camera.width):
            raise UserError(
                "the picture is of another size",
                where=photograph.name,
                expected=_times((photograph.camera.width, photograph.camera.height)),
                found=_times(picture.shape[1::-1]),
            )
        rows = np.rint(picture.reshape(-1, 4) * 255.0).astype(np.uint8)
        low, high = max(first, start), min(last, start + len(rows))
        pixels[low - first : high - first] = rows[low - start : high - start]

    needed = np.nonzero((starts < last) & (starts + sizes > first))[0]
    with ThreadPoolExecutor(min(16, (os.cpu_count() or 1) + 2)) as pool:
        list(pool.map(decode, needed))
    return pixels


def over_background(picture: np.ndarray, background: Sequence[float]) -> np.ndarray:
    """A picture [..., 3 or 4] in [0, 1] composited over a colour: float32 [..., 3]."""
    if picture.shape[-1] == 3:
        return picture.astype(np.float32)
    alpha = picture[..., 3:]
    return (picture[..., :3] * alpha + np.asarray(background, np.float32) * (1 - alpha)).astype(np.float32)


def _times(size: Sequence[int]) -> str:
    return f"{size[0]}x{size[1]}"


def _short(error: Exception) -> str:
    """The first sentence of a decoder's complaint, without the path that we print already."""
    return str(error).split("\n")[0][:120]
