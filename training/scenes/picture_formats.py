"""Names of files that are photographs: of formats that are read, and of those that are not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

READ = "PNG, JPEG, WebP, TIFF, BMP, AVIF, HEIC or OpenEXR"


class UnreadFormat(NamedTuple):
    """A format of photographs that is not read: its name, and what to do with them."""

    name: str
    remedy: str


def _unread(names: Mapping[str, str], remedy: str) -> dict[str, UnreadFormat]:
    return {f".{suffix}": UnreadFormat(name, remedy) for suffix, name in names.items()}


PICTURE_SUFFIXES = (
    ".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".webp", ".tif", ".tiff", ".bmp", ".avif", ".heic", ".heif", ".hif", ".exr",
)  # fmt: skip
RAW = {
    "dng": "DNG", "cr2": "Canon CR2", "cr3": "Canon CR3", "crw": "Canon CRW", "nef": "Nikon NEF", "nrw": "Nikon NRW",
    "arw": "Sony ARW", "sr2": "Sony SR2", "srf": "Sony SRF", "raf": "Fujifilm RAF", "orf": "Olympus ORF",
    "rw2": "Panasonic RW2", "pef": "Pentax PEF", "srw": "Samsung SRW", "x3f": "Sigma X3F", "3fr": "Hasselblad 3FR",
    "iiq": "Phase One IIQ", "rwl": "Leica RWL", "gpr": "GoPro GPR", "fff": "Hasselblad FFF", "erf": "Epson ERF",
    "kdc": "Kodak KDC", "dcr": "Kodak DCR", "mos": "Leaf MOS", "mrw": "Minolta MRW", "raw": "camera raw",
}  # fmt: skip
UNREAD_FORMATS: Mapping[str, UnreadFormat] = {
    **_unread({suffix: f"{name} (raw)" for suffix, name in RAW.items()}, "export them as JPEG, PNG or 16 bit TIFF"),
    **_unread({
        "gif": "GIF", "jxl": "JPEG XL", "jp2": "JPEG 2000", "j2k": "JPEG 2000", "jpx": "JPEG 2000", "jpf": "JPEG 2000",
        "jxr": "JPEG XR",
        "psd": "Photoshop", "psb": "Photoshop", "xcf": "GIMP", "svg": "SVG", "ico": "ICO", "tga": "Targa", "dds": "DDS",
        "ppm": "Netpbm", "pgm": "Netpbm", "pnm": "Netpbm", "pbm": "Netpbm", "pfm": "PFM", "qoi": "QOI", "ktx2": "KTX",
        "insp": "Insta360 panorama",
    }, "convert them to JPEG or PNG"),
    **_unread({"hdr": "Radiance HDR"}, "convert them to OpenEXR"),
}  # fmt: skip
