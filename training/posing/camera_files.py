"""One photograph as a camera or a phone wrote it: upright, with 8 bits a channel, and what its EXIF says of the lens.

Notation: a preview is a grey picture float32 [h, w] in [0, 1], its longer side PREVIEW_SIDE pixels or fewer.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from console import UserError
from training.scenes.pictures import FORMATS, UNREADABLE, decodable

HEIC = (".heic", ".heif")
PREVIEW_SIDE = 1000
QUALITY = 95
# Formats that are used as they are, under these suffixes.
LINKED = {
    "JPEG": (".jpg", ".jpeg"),
    "MPO": (".jpg", ".jpeg"),
    "PNG": (".png",),
}
LOSSY = ("JPEG", "MPO", "WEBP", "HEIF")
# Values of EXIF's orientation that swap width and height, and what brings such a picture upright.
SIDEWAYS = {
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
ORIENTATION, MAKE, MODEL, EXIF_IFD, FOCAL_MM, FOCAL_35MM = 0x0112, 0x010F, 0x0110, 0x8769, 0x920A, 0xA405
DIAGONAL_35MM = 43.266615  # of 36 × 24 mm; what "35 mm equivalent" refers to


@dataclass(frozen=True)
class Look:
    """What a photograph's file says before it is used. size: upright, (width, height) in pixels. as_it_is: no conversion is
    needed. lossy: converted to JPEG, others to PNG. camera: the same for pictures of one camera with one focal length.
    focal: in pixels, as EXIF says; None where it does not. digest: of the bytes. preview: see above. turned: what brings
    pixels upright that are stored sideways, None where they are not.
    """

    size: tuple[int, int]
    as_it_is: bool
    lossy: bool
    camera: str
    focal: float | None
    digest: str
    preview: np.ndarray
    turned: Image.Transpose | None = None


def look_at(file: Path) -> Look:
    """UserError where it is no readable picture, or HEIC and nothing is installed that reads it."""
    try:
        with decodable(file, formats_of(file)) as image:
            exif = image.getexif()
            width, height = image.size
            turned = SIDEWAYS.get(exif.get(ORIENTATION, 1))
            size = (width, height) if turned is None else (height, width)
            plain = image.mode in ("RGB", "L") or (image.mode == "RGBA" and image.format == "PNG")
            named = file.suffix.lower() in LINKED.get(image.format or "", ())
            as_it_is = plain and named and exif.get(ORIENTATION, 1) in (0, 1)
            camera, focal = _lens(exif, size)
            lossy = image.format in LOSSY
            preview = _preview(image)
        with file.open("rb") as data:
            digest = hashlib.file_digest(data, "sha256").hexdigest()
    except UNREADABLE as error:
        raise _unreadable(file, error) from error
    return Look(size, as_it_is, lossy, camera, focal, digest, preview, turned)


def put(file: Path, look: Look, folder: Path, stem: str) -> str:
    """Links or converts a photograph into `folder` and returns its name there, `stem` with a suffix. UserError as look_at."""
    if look.as_it_is:
        name = stem + file.suffix
        with contextlib.suppress(FileNotFoundError):
            (folder / name).unlink()
        try:
            os.symlink(file.resolve(), folder / name)
        except OSError:  # Windows grants links to administrators alone; some file systems know none
            shutil.copyfile(file, folder / name)
        return name
    try:
        with decodable(file, formats_of(file)) as image:
            picture = plain_picture(ImageOps.exif_transpose(image))
    except UNREADABLE as error:
        raise _unreadable(file, error) from error
    return write_picture(picture, folder, stem, lossy=look.lossy and picture.mode != "RGBA")


def write_picture(picture: Image.Image, folder: Path, stem: str, *, lossy: bool) -> str:
    """Writes a picture as JPEG or PNG without its EXIF; returns its name."""
    name = f"{stem}.jpg" if lossy else f"{stem}.png"
    if lossy:
        picture.save(folder / name, format="JPEG", quality=QUALITY, subsampling=0)
    else:
        picture.save(folder / name, format="PNG", compress_level=3)
    return name


def plain_picture(image: Image.Image) -> Image.Image:
    """L, RGB or RGBA with 8 bits a channel, without metadata."""
    if image.mode.startswith(("I", "F")):
        values = np.asarray(image, np.float32)
        most = 1.0 if image.mode.startswith("F") else 65535.0
        plain = Image.fromarray(np.rint(np.clip(values / most, 0, 1) * 255).astype(np.uint8))
    elif image.mode in ("L", "RGB"):
        plain = image.copy()
    else:
        plain = image.convert("RGBA" if image.has_transparency_data else "RGB")
    plain.info = {}
    return plain


def _preview(image: Image.Image) -> np.ndarray:
    """Not turned upright: nothing that is asked of it knows up from down."""
    image.draft("L", (PREVIEW_SIDE, PREVIEW_SIDE))
    grey = plain_picture(image).convert("L")
    grey.thumbnail((PREVIEW_SIDE, PREVIEW_SIDE), Image.Resampling.BOX, reducing_gap=None)
    return np.asarray(grey, np.float32) / 255.0


def formats_of(file: Path) -> tuple[str, ...]:
    """Which formats may be in a file, by its name."""
    if file.suffix.lower() not in HEIC:
        return FORMATS
    try:
        from pillow_heif import register_heif_opener  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UserError("HEIC pictures need pillow-heif, which is not installed", where=file,
                        remedy="pip install pillow-heif, or export the pictures as JPEG") from error  # fmt: skip
    register_heif_opener()
    return ("HEIF",)


def _lens(exif: Any, size: tuple[int, int]) -> tuple[str, float | None]:
    """What tells cameras apart, and the focal length in pixels, from EXIF."""
    inner = exif.get_ifd(EXIF_IFD)
    equivalent, millimetres = (_number(inner.get(key)) for key in (FOCAL_35MM, FOCAL_MM))
    words = [str(exif.get(key, "")).strip("\0 ") for key in (MAKE, MODEL)]
    camera = "/".join([f"{size[0]}x{size[1]}", *words, f"{millimetres or 0:g}mm", f"{equivalent or 0:g}mm"])
    focal = equivalent * float(np.hypot(*size)) / DIAGONAL_35MM if equivalent else None
    return camera, focal if focal is None or 0.2 < focal / max(size) < 20 else None


def _number(value: object) -> float | None:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ArithmeticError):
        return None
    return number if np.isfinite(number) and number > 0 else None


def _unreadable(file: Path, error: Exception) -> UserError:
    if isinstance(error, UnidentifiedImageError):
        return UserError("not a readable picture", where=file, expected="JPEG, PNG, WebP, TIFF, BMP or HEIC")
    return UserError("the picture cannot be decoded", where=file, found=str(error).split("\n")[0][:120])
