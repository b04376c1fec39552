"""Headers of pictures, and whether their pixels may be decoded.

A picture is *stored* as its bytes have it, and *upright* after it was turned as its EXIF says. Sizes are (width, height).
"""

import io
import os
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, UnidentifiedImageError, features
from PIL.JpegImagePlugin import JpegImageFile
from PIL.TiffImagePlugin import TiffImageFile

from console import UserError
from console.file_signature import HEAD_BYTES, sniff_type
from training.scenes.deep_pictures import DeepHeader, deep_header
from training.scenes.files import READ_PICTURES, UNREAD_FORMATS, times

warnings.filterwarnings("ignore", category=UserWarning, module=r"PIL\.")  # of tags that no picture needs
Image.MAX_IMAGE_PIXELS = None  # gigapixel photographs are big, not an attack
# Pillow goes by a file's content, and knows formats that start other programs (Ghostscript for PostScript).
FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
LOSSY = ("JPEG", "MPO", "WEBP", "HEIF", "AVIF", "jpegxl", "jpeg2000")
# What OpenImageIO reads where Pillow does not.
DEEP = ("a TIFF", "a JPEG XL", "a JPEG 2000", "an OpenEXR", "a Radiance HDR")
# Pixels for each byte of a file: DEFLATE stores so many of a white mask, photographs have a few. Small pictures are not weighed.
MOST_PIXELS_PER_BYTE, UNDOUBTED_PIXELS = 1100, 1 << 24
# A JPEG goes over all its pixels once for each scan, which may have 30 bytes: cameras write 1, other programs 10 to 64.
MOST_SCANS, SCAN = 100, b"\xff\xda"
# Tags of TIFF; ORIENTATION is one of EXIF as well.
SUBFILE, WIDTH, HEIGHT, BITS, ORIENTATION, DNG_VERSION = 254, 256, 257, 258, 274, 50706
SIDEWAYS = (5, 6, 7, 8)  # values of ORIENTATION that swap width and height
# What Pillow and OpenImageIO raise for damaged files; they were not written with one error in mind.
UNREADABLE = (
    OSError, SyntaxError, ValueError, AssertionError, LookupError, TypeError, ArithmeticError, AttributeError, EOFError,
    RuntimeError, struct.error, zlib.error,
)  # fmt: skip


@dataclass(frozen=True)
class Header:
    """What a picture's file says before its pixels are decoded."""

    format: str  # Pillow's name, or OpenImageIO's of what Pillow does not know
    stored: tuple[int, int]  # the size as stored
    orientation: int  # EXIF's, 1 to 8
    transparent: bool  # whether it has alpha at all
    mode: str  # Pillow's
    exif: Image.Exif
    deep: DeepHeader | None = None  # where OpenImageIO decodes it, since Pillow cannot or would cut it down

    @property
    def size(self) -> tuple[int, int]:
        """Upright."""
        width, height = self.stored
        return (height, width) if self.orientation in SIDEWAYS else (width, height)


def read_header(path: Path) -> Header:
    """UserError where it is missing, or no picture that is read."""
    if not os.path.isfile(path):  # also where the system would not even look for such a name
        raise UserError("picture not found", where=path, remedy="the scene lists it; restore it or remove its frame")
    if (remedy := UNREAD_FORMATS.get(path.suffix.lower())) is not None:
        what = f"{path.suffix[1:].upper()} pictures are not read"
        raise UserError(what, where=path, expected=READ_PICTURES, remedy=remedy)
    try:
        try:
            return _pillow_header(path)
        except UnidentifiedImageError:
            if sniff_type(_head(path)) not in DEEP:
                raise
            deep = _deep_header(path)
            return Header(deep.format, deep.size, deep.orientation, deep.has_alpha, "F", Image.Exif(), deep)
    except UNREADABLE as error:
        found = sniff_type(_head(path)) if isinstance(error, UnidentifiedImageError) else short_reason(error)
        raise UserError("not a readable picture", where=path, expected=READ_PICTURES, found=found) from error


def _pillow_header(path: Path) -> Header:
    with opened(path) as image:
        exif = Image.Image.getexif(image)  # a PNG's own would decode all pixels, to look what stands behind them
        orientation = exif.get(ORIENTATION, 1)
        stored, deep = image.size, False
        if isinstance(image, TiffImageFile):
            tags = image.tag_v2
            if DNG_VERSION in tags or tags.get(SUBFILE, 0) & 1:
                raise UserError("raw photographs are not read", where=path, found="a TIFF whose first picture is a preview",
                                remedy="export them as JPEG, PNG or 16 bit TIFF")  # fmt: skip
            stored, deep = (tags[WIDTH], tags[HEIGHT]), max(tags.get(BITS, (1,))) > 8
        elif image.format == "PNG":
            deep = _head(path)[24] == 16 and "transparency" not in image.info
        by_deep = _deep_header(path) if deep else None
        return Header(
            format=image.format or "", stored=stored, orientation=orientation if orientation in range(1, 9) else 1,
            transparent=by_deep.has_alpha if by_deep else image.has_transparency_data, mode=image.mode, exif=exif, deep=by_deep,
        )  # fmt: skip


def _deep_header(path: Path) -> DeepHeader:
    header = deep_header(path)
    for size in header.stored:
        weigh(path, size, header.words)
    return header


@contextmanager
def opened(path: Path) -> Iterator[Image.Image]:
    """The picture, its pixels not decoded yet. OSError where its header claims more of them than its bytes can hold."""
    with _Bounded(io.FileIO(path)) as file, Image.open(file, formats=formats_of(path)) as image:
        weigh(path, image.size, 1 / 8 if image.mode == "1" else 1)
        yield image


def weigh(path: Path, size: tuple[int, int], words: float) -> None:
    """OSError where a file is too small for so many pixels, each of so many four bytes."""
    width, height = size
    held = os.path.getsize(path)
    if width < 1 or height < 1 or width * height * words > max(MOST_PIXELS_PER_BYTE * held, UNDOUBTED_PIXELS):
        raise OSError(f"its header claims {times(size)} pixels, more than {held} bytes can hold")


def formats_of(path: Path) -> tuple[str, ...]:
    """Which of Pillow's formats may be in a file, by its first bytes. UserError where what reads them is not installed."""
    kind = sniff_type(_head(path))
    if kind == "an AVIF":
        if not features.check("avif"):
            raise UserError("this Pillow reads no AVIF", where=path, remedy="pip install --upgrade pillow")
        return ("AVIF",)
    if kind != "a HEIC":
        return FORMATS
    try:
        from pillow_heif import register_heif_opener  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UserError("HEIC pictures need pillow-heif, which is not installed", where=path,
                        remedy="pip install pillow-heif, or export the pictures as JPEG") from error  # fmt: skip
    register_heif_opener()
    return ("HEIF",)


@contextmanager
def decodable(path: Path) -> Iterator[Image.Image]:
    """`opened`, for decoding its pixels. OSError for a JPEG of so many scans that decoding would not end."""
    with opened(path) as image:
        # The marker stands nowhere else in compressed data; a thumbnail within has some more.
        if isinstance(image, JpegImageFile) and (scans := path.read_bytes().count(SCAN)) > MOST_SCANS:
            raise OSError(f"it has {scans} scans; at most {MOST_SCANS} are read")
        yield image


class _Bounded(io.BufferedReader):
    """A file that is never asked for more bytes than it has left, since memory for all of them would be taken at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(os.fstat(self.fileno()).st_size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD_BYTES)


def short_reason(error: Exception) -> str:
    """The first sentence of a decoder's complaint, without the path that we print already."""
    words = getattr(error, "strerror", None) or str(error)
    return words.split("\n")[0][:120] or type(error).__name__
