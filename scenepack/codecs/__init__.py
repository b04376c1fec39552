"""How the atlas becomes files and back; the one folder that knows image and video formats.

png: the published layout, image by image. The others are read by this program alone, so they cut the atlas as
compresses best (scenepack.piece_files), and keep what they need to know under "snerg" in the JSON:
- jpeg: colours and features as JPEG, alpha as PNG, images as in the published layout.
- h264: the paper's video: the atlas's planes as frames (needs PyAV).
- webp: lossless, planes of the grid.
- avif: planes of the grid as frames of AV1, alpha and straight colours apart.
To add one, implement Codec and list it in CODECS; docs/results.md has the figures.
"""

from console import UserError
from console.command_line import require_in_range
from scenepack.codecs.base import Codec, CodecError
from scenepack.codecs.films import AvifCodec, H264Codec
from scenepack.codecs.images import JpegCodec, PngCodec, WebpCodec

_ALL: tuple[Codec, ...] = (PngCodec(), WebpCodec(), JpegCodec(), H264Codec(), AvifCodec())
CODECS: dict[str, Codec] = {codec.name: codec for codec in _ALL}


def codec_named(name: str, where: str) -> Codec:
    """The codec of that name. UserError, naming `where`, for one that is not known, or cannot be used here."""
    if name not in CODECS:
        expected = " or ".join(CODECS)
        raise UserError("the image format is not known", where=where, expected=expected, found=repr(name)[:40])
    CODECS[name].require()
    return CODECS[name]


def chosen_quality(codec: Codec, quality: int | None) -> int | None:
    """The quality to encode with, None where the codec loses nothing. UserError where it makes no sense."""
    if quality is None:
        return codec.default_quality
    if codec.default_quality is None:
        raise UserError("is lossless and has no quality", where=f"--codec {codec.name}", remedy="leave out --quality")
    require_in_range("--quality", quality, 1, 100)
    return quality
