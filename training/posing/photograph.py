"""One photograph as a camera or a phone wrote it: upright, 8 bits a channel, its lens by EXIF, how sharp it is.

Notation: a preview is that of training.scenes.pictures.
"""

import contextlib
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from training.scenes.pictures import LOSSY, as_bytes, decoded, is_panorama, preview_of, read_header

QUALITY = 95
# Suffixes of the formats that are used as they are.
LINKED = {"JPEG": (".jpg", ".jpeg"), "MPO": (".jpg", ".jpeg"), "PNG": (".png",)}
MAKE, MODEL, EXIF_IFD, FOCAL_MM, FOCAL_35MM = 0x010F, 0x0110, 0x8769, 0x920A, 0xA405
DIAGONAL_35MM = 43.266615  # of 36 × 24 mm; what "35 mm equivalent" refers to
SAME = 1.5 / 255  # root mean square difference of thumbnails below which two pictures show the same from the same place
THUMBNAIL = 32


@dataclass(frozen=True)
class PhotographFile:
    file: Path
    needs_conversion: bool
    is_lossy: bool  # converted to JPEG, others to PNG
    camera: str  # the same for pictures of one camera with one focal length
    focal: float | None  # in pixels, as EXIF says; None where it does not
    sharpness: float
    thumbnail: np.ndarray
    is_panorama: bool


def read_photograph(file: Path) -> PhotographFile:
    """UserError where it is no readable picture, or nothing is installed that reads it."""
    header = read_header(file)
    plain = header.mode in ("RGB", "L") or (header.mode == "RGBA" and header.format == "PNG")
    named = file.suffix.lower() in LINKED.get(header.format, ())
    camera, focal = _lens(header.exif, header.size)
    preview = preview_of(file)
    return PhotographFile(
        file, not (plain and named and header.orientation == 1 and not header.deep), header.format in LOSSY,
        camera, focal, sharpness(preview), thumbnail(preview), is_panorama(preview),
    )  # fmt: skip


def link_or_convert(photograph: PhotographFile, folder: Path, stem: str) -> str:
    """Puts a photograph into `folder` and returns its name there, `stem` with a suffix. UserError as read_photograph."""
    file = photograph.file
    if photograph.needs_conversion:
        picture = Image.fromarray(as_bytes(decoded(file)))
        return write_picture(picture, folder, stem, lossy=photograph.is_lossy and picture.mode != "RGBA")
    name = stem + file.suffix
    (folder / name).unlink(missing_ok=True)
    try:
        os.symlink(file.resolve(), folder / name)
    except OSError:  # Windows grants links to administrators alone; some file systems know none
        shutil.copyfile(file, folder / name)
    return name


def write_picture(picture: Image.Image, folder: Path, stem: str, *, lossy: bool) -> str:
    """Writes a picture as JPEG or PNG without its EXIF; returns its name."""
    name = f"{stem}.jpg" if lossy else f"{stem}.png"
    picture.save(folder / name, quality=QUALITY, subsampling=0, compress_level=3)  # each format takes what it knows
    return name


def _lens(exif: Any, size: tuple[int, int]) -> tuple[str, float | None]:
    """A text that is the same for one camera at one focal length, and the focal length in pixels, from EXIF."""
    inner = exif.get_ifd(EXIF_IFD)
    equivalent, millimetres = (_positive(inner.get(key)) for key in (FOCAL_35MM, FOCAL_MM))
    words = [str(exif.get(key, "")).strip("\0 ") for key in (MAKE, MODEL)]
    camera = "/".join([f"{size[0]}x{size[1]}", *words, f"{millimetres or 0:g}mm", f"{equivalent or 0:g}mm"])
    focal = equivalent * float(np.hypot(*size)) / DIAGONAL_35MM if equivalent else None
    return camera, focal if focal is None or 0.2 < focal / max(size) < 20 else None


def _positive(value: Any) -> float | None:
    with contextlib.suppress(TypeError, ValueError, ArithmeticError):
        return float(value) if 0 < float(value) < np.inf else None
    return None


def sharpness(preview: np.ndarray) -> float:
    """Variance of second differences at half the preview's scale over that at a quarter: detail that a blur removes over detail
    that it leaves. The lesser of both directions, since a camera may have moved. Comparable only between pictures of the same
    things.
    """
    half = Image.fromarray(preview).reduce(2)
    fine, coarse = _curvature(half), _curvature(half.reduce(2))
    return min(a / (b + 1e-7) for a, b in zip(fine, coarse, strict=True))


def _curvature(picture: Image.Image) -> list[float]:
    """Variance of second differences along rows, and along columns; 0 for pictures of a few pixels."""
    differences = (np.diff(np.asarray(picture), 2, axis=axis) for axis in (1, 0))
    return [float(values.var()) if values.size else 0.0 for values in differences]


def thumbnail(preview: np.ndarray) -> np.ndarray:
    """The preview as float32 [THUMBNAIL, THUMBNAIL]."""
    return np.asarray(Image.fromarray(preview).resize((THUMBNAIL, THUMBNAIL), Image.Resampling.BOX))


def same_view(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two thumbnails show the same from the same place."""
    return bool(np.sqrt(np.mean((a - b) ** 2)) < SAME)


def shift(a: np.ndarray, b: np.ndarray) -> float:
    """By how many of its pixels a thumbnail is moved in another, by phase correlation."""
    window = np.hanning(THUMBNAIL)[:, None] * np.hanning(THUMBNAIL)
    first, second = (np.fft.rfft2(window * (picture - picture.mean())) for picture in (a, b))
    product = np.conj(first) * second
    peak = np.fft.irfft2(product / np.maximum(np.abs(product), 1e-9), a.shape).argmax()
    y, x = (min(place, THUMBNAIL - place) for place in divmod(int(peak), THUMBNAIL))
    return float(np.hypot(y, x))
