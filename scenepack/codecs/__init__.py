"""How the atlas becomes files and back; the one folder that knows image and video formats.

png: the published layout, image by image (`png`). The others are read by this program alone, so they cut the
atlas as compresses best (`pieces`), and keep what they need to know under "snerg" in the JSON:
- jpeg: colours and features as JPEG, alpha as PNG, images as in the published layout (`jpeg`).
- h264: the paper's video: the atlas's planes as frames (`h264`; needs PyAV).
- webp: lossless, planes of the grid (`webp`).
- avif: planes of the grid as frames of AV1, alpha and straight colours apart (`avif`).
To add one, implement PieceCodec and list it in CODECS; docs/results.md has the figures.
"""

from console import UserError
from console.arguments import require_in_range
from scenepack.codecs.avif import AvifCodec
from scenepack.codecs.base import CodecError, PieceCodec
from scenepack.codecs.h264 import H264Codec
from scenepack.codecs.jpeg import JpegCodec
from scenepack.codecs.png import PngCodec
from scenepack.codecs.webp import WebpCodec

__all__ = ["CODECS", "Codec", "CodecError", "PieceCodec", "PngCodec", "chosen_quality", "codec_named"]

Codec = PngCodec | PieceCodec

_ALL: tuple[Codec, ...] = (PngCodec(), WebpCodec(), JpegCodec(), H264Codec(), AvifCodec())
CODECS: dict[str, Codec] = {codec.name: codec for codec in _ALL}


def codec_named(name: str, where: str) -> Codec:
    """The codec of that name. UserError, naming `where`, for one that is not known, or cannot be used here."""
    if name not in CODECS:
        raise UserError(
            "the image format is not known", where=where, expected=" or ".join(CODECS), found=repr(name)[:40]
        )
    codec = CODECS[name]
    if not isinstance(codec, PngCodec):
        codec.require()
    return codec


def chosen_quality(codec: Codec, quality: int | None) -> int | None:
    """The quality to encode with, None where the codec loses nothing. UserError where it makes no sense."""
    usual = None if isinstance(codec, PngCodec) else codec.default_quality
    if quality is None:
        return usual
    if usual is None:
        raise UserError("is lossless and has no quality", where=f"--codec {codec.name}", remedy="leave out --quality")
    require_in_range("--quality", quality, 1, 100)
    return quality
