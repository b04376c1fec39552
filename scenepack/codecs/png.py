"""The published format: four atlas planes stacked in one PNG.

Notation: group k of a part ("rgba" or "feature") is the atlas's z-planes 4k … 4k + 3, uint8 [4 · H, W, 4]: stacked vertically,
plane 4k on top, rows along y, columns along x (docs/format.md, "Atlas images"). So a group is a view of the atlas [D, H, W, 4].
"""

import io
import struct

import imagecodecs
import numpy as np
from PIL import Image

from console.file_signature import sniff_type
from scenepack.codecs.base import Codec, CodecError, Shape, cut_off

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_HEADER_BYTES = 33  # signature and the IHDR chunk
MOST_DEFLATED = 1032  # bytes that DEFLATE can make of one
# By IHDR's colour type: the channels, and values to a pixel.
_PNG_CHANNELS = {0: ("grey", 1), 2: ("RGB", 3), 3: ("palette", 1), 4: ("grey and alpha", 2), 6: ("RGBA", 4)}


class PngCodec(Codec):
    """rgba_NNN.png and feature_NNN.png. Such a pack needs no settings; the reader decodes its images straight into the atlas."""

    name = "png"
    layout = "atlas"
    header_bytes = PNG_HEADER_BYTES

    def names(self, number: int, shape: Shape, features: bool) -> tuple[str, ...]:
        return tuple(f"{part}_{number:03d}.png" for part in (("rgba", "feature") if features else ("rgba",)))

    def encode(self, rgba: np.ndarray, features: np.ndarray | None, quality: int) -> tuple[bytes, ...]:
        parts = [part.reshape(-1, *part.shape[2:]) for part in (rgba, features) if part is not None]
        return tuple(encode_png(part, quality) for part in parts)


def probe_png(head: bytes, size: int) -> tuple[int, int, str]:
    """Width, height and channels ("RGBA", "RGB", …) from the first 33 of a PNG's `size` bytes.

    CodecError if it is none of 8 bits or fewer, or claims more pixels than its bytes can hold.
    """
    if len(head) < len(PNG_SIGNATURE):
        raise cut_off(head)
    if not head.startswith(PNG_SIGNATURE):
        raise CodecError(f"it is not a PNG but {sniff_type(head)}")
    if len(head) < PNG_HEADER_BYTES or head[12:16] != b"IHDR":
        raise CodecError("the PNG header is cut off")
    width, height, bits, colour = struct.unpack(">IIBB", head[16:26])
    if bits > 8 or colour not in _PNG_CHANNELS:
        raise CodecError(f"it has {bits} bits a channel, expected 8")
    channels, values = _PNG_CHANNELS[colour]
    if height * -(-width * bits * values // 8) > MOST_DEFLATED * size:
        raise CodecError(f"its header claims {width}×{height} pixels, more than {size} bytes can hold")
    return width, height, channels


def _require_one_header(data: bytes) -> None:
    """CodecError where a second IHDR follows: libpng makes room for what it says."""
    at, headers = len(PNG_SIGNATURE), 0
    while at + 8 <= len(data) and headers < 2:
        length, kind = struct.unpack_from(">I4s", data, at)
        headers += kind == b"IHDR"
        at += 12 + length
        if kind == b"IEND":
            break
    if headers != 1:
        raise CodecError("it has more than one header")


def encode_png(pixels: np.ndarray, level: int) -> bytes:
    """uint8 [H, W, 4] as a PNG; `level` is zlib's, 0-9. Releases the GIL."""
    return bytes(imagecodecs.png_encode(np.ascontiguousarray(pixels), level))


def decode_png(data: bytes, out: np.ndarray) -> None:
    """Decodes a PNG of 8 bits or fewer into `out`, uint8 [H, W, 4], contiguous, of exactly its size.

    Layouts that optimisers leave behind are put back as the PNG standard has it: grey and palette become RGB,
    a missing alpha is 255. Releases the GIL while it decodes RGBA. CodecError where it cannot be decoded.
    """
    width, height, channels = probe_png(data[:PNG_HEADER_BYTES], len(data))
    if (height, width) != out.shape[:2]:
        raise CodecError(f"it is {width}×{height} pixels, expected {out.shape[1]}×{out.shape[0]}")
    _require_one_header(data)
    try:
        if channels == "RGBA":
            imagecodecs.png_decode(data, out=out)
            return
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            out[...] = np.asarray(image.convert("RGBA"))
    except Exception as error:  # imagecodecs and Pillow raise a dozen unrelated types
        raise CodecError(" ".join(str(error).split()) or type(error).__name__) from error
