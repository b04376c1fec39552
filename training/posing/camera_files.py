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
from PIL import Image

from training.scenes.pictures import LOSSY, as_bytes, decoded, read_header, small_picture

PREVIEW_SIDE = 1000
QUALITY = 95
# Formats that are used as they are, under these suffixes.
LINKED = {
    "JPEG": (".jpg", ".jpeg"),
    "MPO": (".jpg", ".jpeg"),
    "PNG": (".png",),
}
MAKE, MODEL, EXIF_IFD, FOCAL_MM, FOCAL_35MM = 0x010F, 0x0110, 0x8769, 0x920A, 0xA405
DIAGONAL_35MM = 43.266615  # of 36 × 24 mm; what "35 mm equivalent" refers to


@dataclass(frozen=True)
class Look:
    """What a photograph's file says before it is used. size: upright, (width, height) in pixels. as_it_is: no conversion is
    needed. lossy: converted to JPEG, others to PNG. camera: the same for pictures of one camera with one focal length.
    focal: in pixels, as EXIF says; None where it does not. digest: of the bytes. preview: see above.
    """

    size: tuple[int, int]
    as_it_is: bool
    lossy: bool
    camera: str
    focal: float | None
    digest: str
    preview: np.ndarray


def look_at(file: Path) -> Look:
    """UserError where it is no readable picture, or nothing is installed that reads it."""
    header = read_header(file)
    plain = header.mode in ("RGB", "L") or (header.mode == "RGBA" and header.format == "PNG")
    named = file.suffix.lower() in LINKED.get(header.format, ())
    camera, focal = _lens(header.exif, header.size)
    grey = small_picture(file, PREVIEW_SIDE, "L", at_least=1)
    with file.open("rb") as data:
        digest = hashlib.file_digest(data, "sha256").hexdigest()
    return Look(
        size=header.size, as_it_is=plain and named and header.orientation == 1 and not header.deep,
        lossy=header.format in LOSSY, camera=camera, focal=focal, digest=digest,
        preview=np.asarray(grey, np.float32) / 255.0,
    )  # fmt: skip


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
    picture = Image.fromarray(as_bytes(decoded(file)))
    return write_picture(picture, folder, stem, lossy=look.lossy and picture.mode != "RGBA")


def write_picture(picture: Image.Image, folder: Path, stem: str, *, lossy: bool) -> str:
    """Writes a picture as JPEG or PNG without its EXIF; returns its name."""
    name = f"{stem}.jpg" if lossy else f"{stem}.png"
    if lossy:
        picture.save(folder / name, format="JPEG", quality=QUALITY, subsampling=0)
    else:
        picture.save(folder / name, format="PNG", compress_level=3)
    return name


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
