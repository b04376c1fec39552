"""Decoding and shrinking of photographs, and the values of masks.

Notation: a picture is float32 [H, W, 4] in [0, 1], RGB not premultiplied, alpha 1 where opaque. It is *stored* as its bytes have
it, and *upright* after it was turned as its EXIF says, which it is unless `as_stored`. Sizes are (width, height). A
preview is a grey picture float32 [h, w] in [0, 1].
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from console import UserError
from training.scenes.deep_pictures import decoded_deep
from training.scenes.files import times
from training.scenes.picture_headers import LOSSY, SIDEWAYS, UNREADABLE, Header, decodable, read_header, short_reason

BAND_PIXELS = 1 << 21  # that are shrunk at once: 32 MiB of floats
MASK_SHAPE = 0.02  # how much a mask's width over its height may differ from its photograph's
NEARLY = np.uint8(8)  # of black and white in a mask: JPEG leaves neither as it was
LABELS = 1 / 8  # masks that stay below are 0 and 1, or numbers of objects
GREY = 16 / 255  # channels of a mask that differ by no more are grey
PREVIEW_SIDE = 1000  # pixels of a preview's longer side, at most
# Of panoramas, by the mean difference between neighbouring columns: that between the first and the last, at most, and that within
# the first and the last row, at most. Rendered ones have 1.9 and 0.05 at most; photographs cut to 2:1 have 2.3 and 0.6 at least.
SEAM, POLE = 2.5, 0.2
TELLING = 0.03  # standard deviation of the first column: below it, a seam says nothing
LUMA = np.array([0.299, 0.587, 0.114])  # of R'G'B' (BT.601)


def decoded(path: Path, as_stored: bool = False) -> np.ndarray:
    """A picture uint8 [H, W, 3 or 4], or float32 where the file has more than 8 bits. UserError where it cannot be decoded."""
    header = read_header(path)
    with _one_line(path):
        if header.deep is not None:
            picture = decoded_deep(path, header.deep)
        else:
            with decodable(path) as image:
                mode = "RGBA" if header.transparent else "RGB"
                picture = np.asarray(image if image.mode == mode else image.convert(mode))
        return _turned_as_asked(picture, header, as_stored)


def turned(picture: np.ndarray, orientation: int, *, back: bool = False) -> np.ndarray:
    """A picture [H, W, ...] as stored, upright: turned as EXIF's orientation says; or an upright one as it is stored."""
    if back:
        orientation = {6: 8, 8: 6}.get(orientation, orientation)
    if orientation in SIDEWAYS:
        picture = picture.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        picture = picture[::-1]
    return picture[:, ::-1] if orientation in (2, 3, 6, 7) else picture


def _turned_as_asked(picture: np.ndarray, header: Header, as_stored: bool) -> np.ndarray:
    """A decoded picture, upright or as stored."""
    if header.format == "TIFF" and not header.deep:  # which Pillow turns by itself
        return turned(picture, header.orientation, back=True) if as_stored else picture
    return picture if as_stored else turned(picture, header.orientation)


@contextmanager
def _one_line(path: Path) -> Iterator[None]:
    try:
        yield
    except UNREADABLE as error:
        raise UserError("the picture cannot be decoded", where=path, found=short_reason(error),
                        remedy="it may be truncated: copy it again") from error  # fmt: skip


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


def shrink(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """Area average of a picture [H, W, 3 or 4], premultiplied by alpha so that transparent pixels do not bleed into edges."""
    if picture.shape[:2] == (height, width):
        return picture
    if picture.shape[-1] == 3 or np.all(picture[..., 3] == 1.0):
        return area_average(area_average(picture, height, 0), width, 1)
    weighted = np.concatenate([picture[..., :3] * picture[..., 3:], picture[..., 3:]], axis=-1)
    mean = area_average(area_average(weighted, height, 0), width, 1)
    alpha = mean[..., 3:]
    rgb = np.where(alpha > 0, mean[..., :3] / np.maximum(alpha, 1e-8), 0.0)
    return np.concatenate([np.clip(rgb, 0, 1), alpha], axis=-1).astype(np.float32)


def shrunk_bytes(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """`shrink` of a picture uint8 or float32 [H, W, 3 or 4], rounded to uint8, without floats of the whole picture."""
    if picture.shape[:2] == (height, width):
        return as_bytes(picture)
    parts = math.gcd(picture.shape[0], height)  # bands of so many rows begin where a row of the result does
    rows, rows_out = picture.shape[0] // parts, height // parts
    together = max(BAND_PIXELS // (rows * picture.shape[1]), 1)
    starts = [(first, min(first + together, parts)) for first in range(0, parts, together)]
    bands = ((as_floats(picture[first * rows : last * rows]), (last - first) * rows_out) for first, last in starts)
    return np.concatenate([as_bytes(shrink(band, width, height)) for band, height in bands])


def area_average(values: np.ndarray, size: int, axis: int) -> np.ndarray:
    """Means over `size` equal intervals of an axis, cells cut by an interval's end counted by their share."""
    values = np.moveaxis(values, axis, 0)
    cells = values.shape[0]
    if cells % size == 0:
        mean = values.reshape(size, cells // size, *values.shape[1:]).mean(axis=1)
    else:
        edges, cell = np.arange(size + 1)[:, None] * (cells / size), np.arange(cells)
        share = np.clip(np.minimum(edges[1:], cell + 1) - np.maximum(edges[:-1], cell), 0, 1)  # row by interval
        mean = np.tensordot((share * (size / cells)).astype(np.float32), values, axes=1)
    return np.moveaxis(mean, 0, axis)


@dataclass(frozen=True)
class PictureLoader:
    """A Photograph.load of a file: decodes `path`, which must still have source_size, applies a mask, shrinks to `size`."""

    path: Path
    source_size: tuple[int, int]
    size: tuple[int, int]
    mask: Path | None = None
    as_stored: bool = False

    def __call__(self) -> np.ndarray:
        return shrink(with_alpha(as_floats(self._decoded())), *self.size)

    def pixels(self) -> np.ndarray:
        """The same as uint8 [H, W, 3 or 4], without ever holding floats of a whole photograph."""
        return shrunk_bytes(self._decoded(), *self.size)

    def _decoded(self) -> np.ndarray:
        """The picture in full size, as `decoded` gives it, what the mask hides transparent."""
        picture = decoded(self.path, self.as_stored)
        if picture.shape[1::-1] != tuple(self.source_size):
            raise UserError("the picture is of another size", where=self.path, expected=times(self.source_size),
                            found=times(picture.shape[1::-1]), remedy="the file changed after the scene was read")  # fmt: skip
        if self.mask is None:
            return picture
        alpha = read_mask(self.mask, self.path, self.as_stored)[..., None]
        if picture.shape[-1] == 4:
            alpha = as_floats(picture[..., 3:]) * alpha
        if picture.dtype == np.uint8:
            alpha = as_bytes(alpha)
        return np.concatenate([picture[..., :3], alpha], axis=-1)

    def may_be_transparent(self) -> bool:
        """Whether there may be alpha below 1, from the picture's header."""
        return self.mask is not None or read_header(self.path).transparent

    def thumbnail(self, side: int) -> Image.Image:
        """The picture in RGBA, at most `side` pixels a side; a JPEG is decoded at no more than it takes. Errors as above."""
        small = small_picture(self.path, side, "RGBA", as_stored=self.as_stored)
        if self.mask is not None:
            shown = Image.fromarray(as_bytes(read_mask(self.mask, self.path, self.as_stored)))
            small.putalpha(shown.resize(small.size, Image.Resampling.BOX))
        return small


def read_mask(path: Path, photograph: Path, as_stored: bool = False) -> np.ndarray:
    """The values of a mask, float32 [H, W] of its photograph's size, to which it is resampled. A mask without an EXIF
    orientation whose shape is that of the photograph as stored is turned along with it. UserError where its shape is
    another."""
    header, own = read_header(photograph), read_header(path)
    width, height = header.stored if as_stored else header.size
    values = mask_values(decoded(path, as_stored), lossy=own.format in LOSSY)

    def unlike(rows: int, columns: int) -> float:
        return abs(math.log(columns * height / (rows * width)))

    if header.orientation in SIDEWAYS and own.orientation == 1 and unlike(*values.shape[::-1]) < unlike(*values.shape):
        values = turned(values, header.orientation, back=as_stored)
    if unlike(*values.shape) > MASK_SHAPE:
        raise UserError("the mask is of another size than its photograph", where=path, expected=times((width, height)),
                        found=times(values.shape[::-1]), remedy=f"make it as large as {photograph.name}")  # fmt: skip
    if values.shape != (height, width):
        values = np.asarray(Image.fromarray(values).resize((width, height), Image.Resampling.BOX))
    return values


def mask_values(picture: np.ndarray, *, lossy: bool = False) -> np.ndarray:
    """The values float32 [H, W], 0 where it hides and 1 where it shows, of a mask decoded to uint8 or float32 [H, W, 3 or 4].

    lossy: it was a JPEG, for instance. Nothing is inverted or guessed:

    1. Alpha that is somewhere transparent is the mask; black hides as well if all else that is visible is white. Alpha that is
       transparent everywhere tells nothing of a mask that has colours.
    2. Of two colours, the darker one hides; of one, black does.
    3. Black hides and any other value shows, in masks of colours and in those that are nearly black everywhere (0 and 1).
    4. Any other mask is a soft one: its values count as they are.
    """
    colour = picture[..., :3]
    full = 255 if picture.dtype == np.uint8 else 1.0
    if picture.shape[-1] == 4 and 2 * float(picture[..., 3].min()) < float(picture[..., 3].max()):
        alpha = picture[..., 3]
        black, white = (colour == 0).all(axis=-1), (colour == full).all(axis=-1)
        shown = _mask_levels(alpha[..., None], full)
        is_drawn = (black | white | (alpha == 0)).all() and (white & (alpha > 0)).any()
        return np.where(black, np.float32(0), shown) if is_drawn else shown
    if picture.shape[-1] == 4 and not picture[..., 3].any() and (colour == colour[:1, :1]).all():
        return np.zeros(colour.shape[:2], np.float32)
    if lossy and picture.dtype == np.uint8:
        colour = np.where(colour < NEARLY, 0, np.where(colour > 255 - NEARLY, 255, colour))
    return _mask_levels(colour, full)


def _mask_levels(colour: np.ndarray, full: float) -> np.ndarray:
    """Rules 2 to 4, of [H, W, 1 or 3]."""
    level = colour.max(axis=-1)
    first = colour[0, 0]
    other = (colour != first).any(axis=-1)
    if not other.any():
        return np.full(level.shape, float(first.max() > 0), np.float32)
    second = colour[np.unravel_index(other.argmax(), other.shape)]
    if ((colour == second).all(axis=-1) | ~other).all():
        luma = LUMA if len(first) == 3 else np.ones(1)
        return (other if second @ luma > first @ luma else ~other).astype(np.float32)
    spread = level - colour.min(axis=-1)
    if level.max() < LABELS * full or spread.max() > GREY * full:
        return (level > 0).astype(np.float32)
    return level.astype(np.float32) / np.float32(full)


def small_picture(path: Path, side: int, mode: str, *, as_stored: bool = False, at_least: int = 2) -> Image.Image:
    """A picture in a mode of Pillow's, at most `side` pixels a side. at_least: a JPEG is decoded at so many times that."""
    header = read_header(path)
    with _one_line(path):
        if header.deep:
            whole = decoded(path, as_stored)
            scale = min(side / max(whole.shape[:2]), 1)
            width, height = (max(round(cells * scale), 1) for cells in whole.shape[1::-1])
            return Image.fromarray(shrunk_bytes(whole, width, height)).convert(mode)
        with decodable(path) as image:
            image.draft("L" if mode == "L" else "RGB", (at_least * side, at_least * side))
            picture = image.convert(mode)
        picture.thumbnail((side, side), Image.Resampling.BOX, reducing_gap=2.0)
        return Image.fromarray(np.ascontiguousarray(_turned_as_asked(np.asarray(picture), header, as_stored)))


def preview_of(file: Path) -> np.ndarray:
    """The preview of a picture."""
    return np.asarray(small_picture(file, PREVIEW_SIDE, "L", at_least=1), np.float32) / 255.0


def is_panorama(preview: np.ndarray) -> bool:
    """Whether a picture is a panorama of 360° × 180° (equirectangular): twice as wide as tall, its left edge continues its right
    edge, and its first and last row show one point each."""
    height, width = preview.shape
    if abs(width - 2 * height) > 1:
        return False
    seam, within = np.abs(preview[:, 0] - preview[:, -1]).mean(), np.abs(np.diff(preview, axis=1)).mean(axis=1)
    poles, between = max(within[0], within[-1]), within.mean()
    return bool(seam <= SEAM * between and poles <= POLE * between and preview[:, 0].std() >= TELLING)


def over_background(picture: np.ndarray, background: Sequence[float]) -> np.ndarray:
    """A picture [..., 3 or 4] in [0, 1] composited over a colour: float32 [..., 3]."""
    if picture.shape[-1] == 3:
        return picture.astype(np.float32)
    alpha = picture[..., 3:]
    return (picture[..., :3] * alpha + np.asarray(background, np.float32) * (1 - alpha)).astype(np.float32)
