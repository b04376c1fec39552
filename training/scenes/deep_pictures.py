"""Decoding of what Pillow cuts down to 8 bits or does not know: TIFF and PNG of more bits or floats, and OpenEXR.

Results are float32 [H, W, 3 or 4] in [0, 1], display-referred sRGB, RGB not premultiplied. Integers are divided by the largest of
their type. A TIFF of floats must be display-referred; OpenEXR is linear light.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from console import UserError

SUBFILE, WIDTH, HEIGHT, BITS, PHOTOMETRIC, ORIENTATION, SAMPLES = 254, 256, 257, 258, 262, 274, 277
TILE_WIDTH, TILE_HEIGHT, EXTRA_SAMPLES, SAMPLE_FORMAT, DNG_VERSION = 322, 323, 338, 339, 50706
WHITE_IS_ZERO, BLACK_IS_ZERO, RGB = 0, 1, 2  # values of PHOTOMETRIC
UNSIGNED, FLOATS = 1, 3  # values of SAMPLE_FORMAT
PREMULTIPLIED, STRAIGHT = 1, 2  # values of EXTRA_SAMPLES
OVERSHOOT = 1.1  # what sharpening and resampling make of white; more is other than display-referred
MAIN_LAYERS = ("", "combined", "rgba", "beauty")  # an OpenEXR's that are the picture, where it has others


# --- TIFF and PNG -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TiffTags:
    """What the first picture of a TIFF says of itself."""

    size: tuple[int, int]  # as stored, (width, height)
    tile: tuple[int, int]
    bits: int
    sample_format: int
    photometric: int
    samples: int
    extra: int | None  # what the last sample is, where there are more than colours
    orientation: int

    @property
    def deep(self) -> bool:  # Pillow would cut it down, or not read it
        return self.bits > 8 or self.sample_format != UNSIGNED

    @property
    def has_alpha(self) -> bool:
        return self.extra in (PREMULTIPLIED, STRAIGHT)


def tiff_tags(path: Path, file: io.BufferedReader) -> TiffTags:
    """Those of an open file. UserError for raw photographs, which are TIFFs whose first picture is a small copy."""
    header = file.read(8)
    header += file.read(8) if 43 in header[2:4] else b""  # BigTIFF
    tags = ImageFileDirectory_v2(header)
    file.seek(tags.next)
    tags.load(file)
    if DNG_VERSION in tags or _first(tags, SUBFILE, 0) & 1:
        raise UserError("raw photographs are not read", where=path, found="a TIFF whose first picture is a preview",
                        remedy="export them as JPEG, PNG or 16 bit TIFF")  # fmt: skip
    photometric, samples = _first(tags, PHOTOMETRIC, RGB), _first(tags, SAMPLES, 1)
    colours = 3 if photometric == RGB else 1
    return TiffTags(
        size=(_first(tags, WIDTH, 0), _first(tags, HEIGHT, 0)), tile=(_first(tags, TILE_WIDTH, 1), _first(tags, TILE_HEIGHT, 1)),
        bits=_first(tags, BITS, 1), sample_format=_first(tags, SAMPLE_FORMAT, UNSIGNED), photometric=photometric,
        samples=samples, extra=None if samples == colours else _first(tags, EXTRA_SAMPLES, 0) if tags.get(EXTRA_SAMPLES) else 0,
        orientation=_first(tags, ORIENTATION, 1),
    )  # fmt: skip


def _first(tags: Mapping[int, Any], tag: int, default: int) -> int:
    value = tags.get(tag, default)
    return int(value[0] if isinstance(value, tuple) else value)


def decoded_tiff(path: Path, tags: TiffTags) -> np.ndarray:
    """As it is stored, not turned. UserError where its values have a meaning that is not known here."""
    colours = 3 if tags.photometric == RGB else 1
    if tags.photometric not in (WHITE_IS_ZERO, BLACK_IS_ZERO, RGB) or not colours <= tags.samples <= colours + 1:
        raise UserError("a TIFF of other colours", where=path, expected="grey, RGB or RGBA", found=f"{tags.samples} samples "
                        f"of photometric interpretation {tags.photometric}", remedy="convert it to PNG")  # fmt: skip
    if tags.bits not in (8, 16, 32, 64) or tags.sample_format not in (UNSIGNED, FLOATS):
        raise UserError("a TIFF of other numbers", where=path, expected="unsigned integers of 8, 16 or 32 bits, or floats",
                        found=f"{tags.bits} bits of sample format {tags.sample_format}", remedy="convert it to PNG")  # fmt: skip
    stored = imagecodecs.tiff_decode(path.read_bytes())
    if stored.size != tags.size[0] * tags.size[1] * tags.samples:
        raise ValueError("its pixels are not as many as its header says")
    values = _unit(stored.reshape(*tags.size[::-1], tags.samples))
    if (most := float(values[..., :colours].max(initial=0))) > OVERSHOOT:
        raise UserError("a TIFF of floats that are no display-referred colours", where=path, expected="0 to 1", found=f"up to "
                        f"{most:g}", remedy="scale them to 0 to 1, or store linear light as OpenEXR")  # fmt: skip
    rgb, alpha = values[..., :colours], np.clip(values[..., colours:], 0, 1)
    if tags.photometric == WHITE_IS_ZERO:
        rgb = 1 - rgb
    if tags.extra == PREMULTIPLIED:
        rgb = _straight(rgb, alpha)
    rgb = np.broadcast_to(np.clip(rgb, 0, 1), (*values.shape[:2], 3))
    return np.concatenate([rgb, alpha] if tags.has_alpha else [rgb], axis=-1)


def decoded_png(path: Path) -> np.ndarray:
    """A PNG of 16 bits; transparency only as a channel."""
    values = _unit(imagecodecs.png_decode(path.read_bytes()))
    values = values.reshape(*values.shape[:2], -1)
    return values if values.shape[-1] > 2 else np.concatenate([values[..., :1]] * 3 + [values[..., 1:]], axis=-1)


def _unit(values: np.ndarray) -> np.ndarray:
    """Integers as float32 in [0, 1]; of floats, what is no number is 0."""
    if values.dtype.kind == "f":
        with np.errstate(over="ignore"):
            return np.nan_to_num(values.astype(np.float32), nan=0, posinf=np.inf, neginf=0)
    return values.astype(np.float32) / np.float32(np.iinfo(values.dtype).max)


def _straight(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.where(alpha > 0, rgb / np.maximum(alpha, 1e-8), 0)


# --- OpenEXR ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ExrHeader:
    """What an OpenEXR says of its picture, which is its display window."""

    size: tuple[int, int]  # of the display window
    data_size: tuple[int, int]  # of the data window
    corner: tuple[int, int]  # of the data window within the display window
    names: tuple[str, ...]  # of the red, green, blue (the same for grey) and alpha channels
    part: int  # which has them
    channels: int  # how many all parts have

    @property
    def is_whole(self) -> bool:  # the data window is the display window
        return self.data_size == self.size and self.corner == (0, 0)

    @property
    def has_alpha(self) -> bool:  # of its own, or outside of the data window
        return len(self.names) > 3 or not self.is_whole


def exr_header(path: Path) -> ExrHeader:
    """UserError where OpenEXR is not installed, or no channels are a picture's."""
    with _exr(path, header_only=True) as file:
        headers = [dict(part.header) for part in file.parts]  # they are emptied with the file
    channels = [{channel.name: channel for channel in header["channels"]} for header in headers]
    part, names = next(((i, names) for i, each in enumerate(channels) if (names := _colours(each))), (0, ()))
    subsampled = any(channels[part][name].xSampling * channels[part][name].ySampling != 1 for name in names)
    if not names or subsampled or "deep" in str(headers[part]["type"]):
        found = "subsampled colours" if subsampled else ", ".join(name for each in channels for name in each)[:120]
        raise UserError("an OpenEXR without a picture", where=path, expected="one layer with channels R, G, B or Y",
                        found=found or "none", remedy="export the picture alone")  # fmt: skip
    (left, top), (width, height) = _window(headers[part]["displayWindow"])
    (left_data, top_data), data_size = _window(headers[part]["dataWindow"])
    corner = (left_data - left, top_data - top)
    return ExrHeader((width, height), data_size, corner, names, part, sum(map(len, channels)))


def _window(corners: Any) -> tuple[tuple[int, int], tuple[int, int]]:
    """The first corner and the size of a window, whose last corner lies within it."""
    (left, top), (right, bottom) = (map(int, corner) for corner in corners)
    return (left, top), (right - left + 1, bottom - top + 1)


def decoded_exr(path: Path, header: ExrHeader) -> np.ndarray:
    """Linear light of Rec. 709 primaries to sRGB, clipped; black and transparent outside of the data window."""
    with _exr(path, header_only=False) as file:
        if len(file.parts) <= header.part:
            raise OSError("its pixels are truncated or damaged")
        channels = file.parts[header.part].channels
        data = np.stack([_unit(channels[name].pixels) for name in header.names], axis=-1)
    if data.shape[1::-1] != header.data_size:
        raise ValueError("its pixels are not as many as its header says")
    if header.has_alpha:
        alpha = np.clip(data[..., 3:], 0, 1) if len(header.names) == 4 else np.ones_like(data[..., :1])
        data = np.concatenate([linear_to_srgb(_straight(data[..., :3], alpha)), alpha], axis=-1)
    else:
        data = linear_to_srgb(data)
    if header.is_whole:
        return data
    (width, height), (x, y) = header.size, header.corner
    picture = np.zeros((height, width, 4), np.float32)
    left, top = max(x, 0), max(y, 0)
    inside = data[top - y : max(height - y, 0), left - x : max(width - x, 0)]
    picture[top : top + inside.shape[0], left : left + inside.shape[1]] = inside
    return picture


def linear_to_srgb(light: np.ndarray) -> np.ndarray:
    """The transfer function of IEC 61966-2-1, of light clipped to [0, 1]."""
    light = np.clip(light, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** np.float32(1 / 2.4) - 0.055).astype(np.float32)


def _colours(channels: Mapping[str, object]) -> tuple[str, ...]:
    """Names of the channels that are a picture's; of several layers, those of the main one."""
    layers = [name[:-1] for name in channels if name.endswith("R") and {name[:-1] + c for c in "GB"} <= channels.keys()]
    main = [layer for layer in layers if layer.lower().rstrip(".").rpartition(".")[2] in MAIN_LAYERS]
    if len(layers) == 1 or main:
        layer = min(main or layers, key=len)
        return tuple(layer + c for c in "RGBA" if layer + c in channels)
    if "Y" in channels and not layers and not {"RY", "BY"} & channels.keys():
        return ("Y",) * 3 + (("A",) if "A" in channels else ())
    return ()


def _exr(path: Path, *, header_only: bool) -> Any:
    try:
        import OpenEXR
    except ImportError as error:
        raise UserError("reading OpenEXR pictures needs OpenEXR, which is not installed", where=path,
                        remedy="pip install 'snerg[export]', or convert them to PNG") from error  # fmt: skip
    return OpenEXR.File(str(path), separate_channels=True, header_only=header_only)
