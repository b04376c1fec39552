"""JPEG: images as in the published layout, in JPEG's terms.

JPEG has no alpha, to which the renderer is most sensitive, so alpha is a grey PNG of its own and stays exact. Colours stay
premultiplied, without subsampled chroma; features are three channels as if they were colours, and the fourth as a grey picture.
"""

import io

import imagecodecs
import numpy as np
from PIL import Image

from scenepack.codecs.base import Codec, CodecError, Decoded, Shape, cut_off, decoding, in_few_levels
from scenepack.codecs.png import encode_png

ALPHA_LEVEL = 6  # zlib's
END_OF_IMAGE = b"\xff\xd9"


class JpegCodec(Codec):
    """rgb_NNN.jpg, alpha_NNN.png, feature_NNN.jpg (first three channels), feature_w_NNN.jpg (the fourth)."""

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

    def encode(self, rgba: np.ndarray, features: np.ndarray | None, quality: int) -> tuple[bytes, ...]:
        stacked = rgba.reshape(-1, *rgba.shape[2:])
        files = [_jpeg(stacked[..., :3], quality), encode_png(stacked[..., 3], ALPHA_LEVEL)]
        if features is not None:
            stacked = features.reshape(stacked.shape)
            quality = 100 - (100 - quality) // 4 if in_few_levels(features) else quality
            files += [_jpeg(stacked[..., :3], quality), _jpeg(stacked[..., 3], quality)]
        return tuple(files)

    def decode(self, files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool) -> Decoded:
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
        if not features:
            return rgba, None
        return rgba, np.concatenate(images[2:], axis=-1) * (alpha > 0)


def _jpeg(pixels: np.ndarray, quality: int) -> bytes:
    subsampling = "444" if pixels.ndim == 3 else None
    return bytes(imagecodecs.jpeg8_encode(np.ascontiguousarray(pixels), level=quality, subsampling=subsampling))
