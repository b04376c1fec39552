"""Image codecs: PNG as published, lossless WebP, JPEG.

Notation: group k of a part ("rgba" or "feature") is the atlas's z-planes 4k … 4k + 3, uint8 [4 · H, W, 4]: stacked vertically,
plane 4k on top, rows along y, columns along x (docs/format.md, "Atlas images"). So a group is a view of the atlas [D, H, W, 4].
"""

import io
import struct
from functools import partial

import imagecodecs
import numpy as np
from PIL import Image

from console.file_signature import sniff_type
from scenepack.codecs.base import Codec, CodecError, Parts, Shape, cut_off, decoding, in_few_levels

# --- PNG: the published format, a group in one picture ---

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
        return tuple(f"{part}_{number:03d}.png" for part in ("rgba", "feature")[: 1 + features])

    def encode(self, parts: Parts, quality: int) -> tuple[bytes, ...]:
        return tuple(encode_png(part.reshape(-1, *part.shape[2:])) for part in parts)


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
    """CodecError where a second IHDR follows: libpng allocates memory for its size, which nothing has checked."""
    at, headers = len(PNG_SIGNATURE), 0
    while at + 8 <= len(data) and headers < 2:
        length, kind = struct.unpack_from(">I4s", data, at)
        headers += kind == b"IHDR"
        at += 12 + length
        if kind == b"IEND":
            break
    if headers != 1:
        raise CodecError("it has more than one header")


def encode_png(pixels: np.ndarray) -> bytes:
    """uint8 [H, W, 4] as a PNG. Filtered voxels are noise, which DEFLATE without references makes smaller, and faster."""
    return bytes(imagecodecs.png_encode(np.ascontiguousarray(pixels), strategy=imagecodecs.PNG.STRATEGY.RLE))


@decoding()
def decode_png(data: bytes, out: np.ndarray) -> None:
    """Decodes a PNG of 8 bits or fewer into `out`, uint8 [H, W, 4], contiguous, of exactly its size.

    Layouts that optimisers leave behind are put back as the PNG standard has it: grey and palette become RGB,
    a missing alpha is 255. Releases the GIL while it decodes RGBA. CodecError where it cannot.
    """
    width, height, channels = probe_png(data[:PNG_HEADER_BYTES], len(data))
    if (height, width) != out.shape[:2]:
        raise CodecError(f"it is {width}×{height} pixels, expected {out.shape[1]}×{out.shape[0]}")
    _require_one_header(data)
    if channels == "RGBA":
        imagecodecs.png_decode(data, out=out)
        return
    with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
        out[...] = np.asarray(image.convert("RGBA"))


# --- WebP: each piece's planes one below another, RGBA, in as few pictures as WebP's size limit allows ---

MAX_SIDE = 16383  # pixels
METHOD = 4  # of 0 … 6; 6 takes four times as long for one per cent less
EFFORT = 50  # 100 takes twice as long for a thousandth fewer bytes


class WebpCodec(Codec):
    """rgba_NNN_I.webp and feature_NNN_I.webp: picture I of piece N."""

    name = "webp"
    layout = "grid"
    header_bytes = 64

    def names(self, number: int, shape: Shape, features: bool) -> tuple[str, ...]:
        parts = ("rgba", "feature")[: 1 + features]
        return tuple(f"{part}_{number:03d}_{i}.webp" for part in parts for i in range(len(_rows(shape))))

    def check(self, name: str, head: bytes, shape: Shape) -> None:
        first, end = _rows(shape)[_number(name)]
        expected, found = (shape[2], (end - first) * shape[1]), _webp_size(head)
        if found != expected:
            raise CodecError(f"it is {found[0]}×{found[1]} pixels, expected {expected[0]}×{expected[1]}")

    def encode(self, parts: Parts, quality: int) -> tuple[bytes, ...]:
        pictures = [part[first:end].reshape(-1, *part.shape[2:]) for part in parts for first, end in _rows(part.shape)]
        encode = partial(imagecodecs.webp_encode, level=EFFORT, lossless=True, method=METHOD)
        return tuple(bytes(encode(np.ascontiguousarray(picture))) for picture in pictures)

    def decode(self, files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool) -> Parts:
        parts = [np.empty((*shape, 4), np.uint8) for _ in range(1 + features)]
        for name in names:
            first, end = _rows(shape)[_number(name)]
            target = parts[name.startswith("feature")][first:end]
            with decoding(name):
                self.check(name, files[name], shape)
                target[...] = imagecodecs.webp_decode(files[name], hasalpha=True).reshape(target.shape)
        return parts


def _rows(shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """The planes (first, end) of each picture."""
    step = max(1, MAX_SIDE // shape[1])
    return [(z, min(z + step, shape[0])) for z in range(0, shape[0], step)]


def _number(name: str) -> int:
    return int(name.rsplit("_", 1)[1].partition(".")[0])


def _webp_size(head: bytes) -> tuple[int, int]:
    """Width and height from the header of a lossless WebP."""
    if len(head) < 30:
        raise cut_off(head)
    if head[:4] != b"RIFF" or head[8:16] != b"WEBPVP8L" or head[20] != 0x2F:
        raise CodecError("it is not a lossless WebP")
    bits = int.from_bytes(head[21:25], "little")
    return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1


# --- JPEG: groups as in the published format, in JPEG's terms ---

END_OF_IMAGE = b"\xff\xd9"


class JpegCodec(Codec):
    """rgb_NNN.jpg, alpha_NNN.png, feature_NNN.jpg (first three channels), feature_w_NNN.jpg (the fourth).

    JPEG has no alpha, to which the renderer is most sensitive, so alpha is a grey PNG of its own and stays exact. Colours stay
    premultiplied, without subsampled chroma; features are three channels as if they were colours, and a fourth as a grey picture.
    """

    name = "jpeg"
    layout = "atlas"
    default_quality = 95
    header_bytes = 2048

    def names(self, number: int, shape: Shape, features: bool) -> tuple[str, ...]:
        names = (f"rgb_{number:03d}.jpg", f"alpha_{number:03d}.png")
        return (*names, f"feature_{number:03d}.jpg", f"feature_w_{number:03d}.jpg") if features else names

    def check(self, name: str, head: bytes, shape: Shape) -> None:
        if not head:
            raise cut_off(head)
        try:
            with Image.open(io.BytesIO(head), formats=["PNG" if name.endswith("png") else "JPEG"]) as image:
                found, mode = image.size, image.mode  # from the header; no pixel is decoded
        except Exception as error:
            raise CodecError("its header is damaged") from error
        expected, is_colour = (shape[2], shape[0] * shape[1]), not name.startswith(("alpha_", "feature_w_"))
        if found != expected or mode != ("RGB" if is_colour else "L"):
            raise CodecError(f"it is {found[0]}×{found[1]} pixels {mode}, expected {expected[0]}×{expected[1]}")

    def encode(self, parts: Parts, quality: int) -> tuple[bytes, ...]:
        rgba, *others = (part.reshape(-1, *part.shape[2:]) for part in parts)
        files = [_jpeg(rgba[..., :3], quality), encode_png(rgba[..., 3])]
        for features in others:
            quality = 100 - (100 - quality) // 4 if in_few_levels(features) else quality
            files += [_jpeg(features[..., :3], quality), _jpeg(features[..., 3], quality)]
        return tuple(files)

    def decode(self, files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool) -> Parts:
        images = []
        for name in names:
            with decoding(name):
                self.check(name, files[name], shape)
                if name.endswith("jpg") and not files[name].endswith(END_OF_IMAGE):
                    raise cut_off(files[name])  # the library fills what is missing with grey and says nothing
                decode = imagecodecs.png_decode if name.endswith("png") else imagecodecs.jpeg8_decode
                images.append(decode(files[name]).reshape(*shape, -1))
        colours, alpha = images[:2]
        rgba = np.concatenate([np.minimum(colours, alpha), alpha], axis=-1)  # no colour outshines its alpha
        return [rgba, np.concatenate(images[2:], axis=-1) * (alpha > 0)] if features else [rgba]


def _jpeg(pixels: np.ndarray, quality: int) -> bytes:
    subsampling = "444" if pixels.ndim == 3 else None
    return bytes(imagecodecs.jpeg8_encode(np.ascontiguousarray(pixels), level=quality, subsampling=subsampling))


# --- Pictures of any of these formats, such as small photographs (scenepack.cameras) ---

FORMATS = ("AVIF", "WEBP", "JPEG", "PNG")


def decode_picture(files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool) -> Parts:
    """As of a codec, in a process of its own (scenepack.codecs.decoder_sandbox): AVIF and JPEG can ask for endless work."""
    with decoding(names[0]), Image.open(io.BytesIO(files[names[0]]), formats=FORMATS) as opened:
        return [np.asarray(opened.convert("RGBA")).reshape(*shape, 4)]
