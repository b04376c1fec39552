"""Decoding, with OpenImageIO, of what Pillow cuts to 8 bits or does not know: TIFF and PNG of more bits or floats, JPEG XL, JPEG
2000, OpenEXR, Radiance HDR.

Results are float32 [H, W, 3 or 4] in [0, 1], display-referred sRGB, RGB not premultiplied. Integers are divided by the largest of
their type. A TIFF of floats must be display-referred; OpenEXR and Radiance HDR are linear light.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from console import UserError

OVERSHOOT = 1.1  # what sharpening and resampling make of white; more is other than display-referred
MAIN_LAYERS = ("", "combined", "rgba", "beauty")  # an OpenEXR's that are the picture, where it has others
PHOTOMETRIC, WHITE_IS_ZERO, MOSAIC = "tiff:PhotometricInterpretation", 0, 32803  # values from MOSAIC on are a sensor's
LINEAR = ("openexr", "hdr")
PREMULTIPLIED = ("openexr", "tiff")  # by alpha, where the file does not say otherwise
STRAIGHT = "oiio:UnassociatedAlpha"  # OpenImageIO's name for colours that are not premultiplied by alpha


@dataclass(frozen=True)
class DeepHeader:
    """What such a picture says of itself."""

    format: str  # OpenImageIO's name: "tiff", "png", "jpegxl", "jpeg2000", "openexr" or "hdr"
    size: tuple[int, int]  # (width, height) as stored; of an OpenEXR the display window's
    stored: tuple[tuple[int, int], ...]  # sizes that decoding takes memory for
    words: float  # four bytes that each of their pixels takes
    part: int  # of the file, which has the picture
    # names of red, green, blue (the same for grey) and alpha, or 1 for its opaque pixels
    channels: tuple[str | float, ...]
    orientation: int  # EXIF's, 1 to 8

    @property
    def has_alpha(self) -> bool:
        return len(self.channels) == 4


def deep_header(path: Path) -> DeepHeader:
    """UserError where no channels are a picture's; OSError where the file is damaged."""
    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise OSError(oiio.geterror())
    specs: list[oiio.ImageSpec] = []
    while file.seek_subimage(len(specs), 0):
        specs.append(file.spec())
    parts = ((part, _colours(spec.channelnames)) for part, spec in enumerate(specs) if not spec.deep)
    part, channels = next((each for each in parts if each[1]), (0, ()))
    if not channels:
        found = ", ".join(name for spec in specs for name in spec.channelnames)[:120]
        raise UserError("no channels that are a picture", where=path, expected="one layer with channels R, G, B or Y",
                        found=found or "none", remedy="export the picture alone")  # fmt: skip
    spec = specs[part]
    if spec.get_int_attribute(PHOTOMETRIC) >= MOSAIC:
        raise UserError("raw photographs are not read", where=path, remedy="export them as JPEG, PNG or 16 bit TIFF")
    size = own = (spec.width, spec.height)
    if file.format_name() == "openexr":
        size = (spec.full_width, spec.full_height)
        if len(channels) == 3 and spec.roi != spec.roi_full:
            channels = (*channels, 1.0)
    tile = (max(spec.tile_width, 1), max(spec.tile_height, 1))
    words = sum(each.image_bytes(True) / max(each.image_pixels(), 1) for each in specs) / 4
    turn = int(spec.get_int_attribute("Orientation", 1))
    return DeepHeader(file.format_name(), size, (size, own, tile), words, part, channels, turn)


def decoded_deep(path: Path, header: DeepHeader) -> np.ndarray:
    """The pixels as stored, without the rotation of EXIF. An OpenEXR is black and transparent outside its data window."""
    straight, exr, linear = oiio.ImageSpec(), header.format == "openexr", header.format in LINEAR
    straight.attribute(STRAIGHT, 1)  # or OpenImageIO multiplies colours that are not
    file = oiio.ImageBuf(str(path), header.part, 0, straight)
    if not file.read(header.part, 0, True, oiio.FLOAT):
        raise OSError(file.geterror())
    picture = oiio.ImageBufAlgo.channels(file, header.channels)
    if exr:
        picture = oiio.ImageBufAlgo.cut(picture, picture.roi_full)
    values = np.asarray(picture.get_pixels(oiio.FLOAT))
    if values.shape[1::-1] != header.size:
        raise OSError("its pixels are not as many as its header says")
    values = np.nan_to_num(values, nan=0, posinf=np.inf, neginf=0)
    rgb, alpha = values[..., :3], np.clip(values[..., 3:], 0, 1)
    if not linear and (most := float(rgb.max(initial=0))) > OVERSHOOT:
        raise UserError("a TIFF of floats that are no display-referred colours", where=path, expected="0 to 1", found=f"up to "
                        f"{most:g}", remedy="scale them to 0 to 1, or store linear light as OpenEXR")  # fmt: skip
    if file.spec().get_int_attribute(PHOTOMETRIC, -1) == WHITE_IS_ZERO:
        rgb = 1 - rgb
    if header.has_alpha and header.format in PREMULTIPLIED and not file.spec().get_int_attribute(STRAIGHT):
        with np.errstate(over="ignore"):
            rgb = np.where(alpha > 0, rgb / np.maximum(alpha, 1e-8), 0)
    return np.concatenate([linear_to_srgb(rgb) if linear else np.clip(rgb, 0, 1), alpha], axis=-1)


def linear_to_srgb(light: np.ndarray) -> np.ndarray:
    """The transfer function of IEC 61966-2-1, of light clipped to [0, 1]."""
    light = np.clip(light, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** np.float32(1 / 2.4) - 0.055).astype(np.float32)


def _colours(channels: Sequence[str]) -> tuple[str, ...]:
    """Names of the channels that are a picture's; of several layers, those of the main one."""
    layers = [name[:-1] for name in channels if name.endswith("R") and {name[:-1] + c for c in "GB"} <= set(channels)]
    main = [layer for layer in layers if layer.lower().rstrip(".").rpartition(".")[2] in MAIN_LAYERS]
    if len(layers) == 1 or main:
        layer = min(main or layers, key=len)
        return tuple(layer + c for c in "RGBA" if layer + c in channels)
    if "Y" in channels and not layers and not {"RY", "BY"} & set(channels):
        return ("Y",) * 3 + (("A",) if "A" in channels else ())
    return ()
