"""Small copies of the photographs that a pack was made from, inside its own metadata.

An entry of "cameras" may have a "picture": a data URI (RFC 2397) of an AVIF, WebP, JPEG or PNG file, the photograph over its
scene's background, in the shape of the camera's width and height but as small as its maker likes.
"""

import base64
import io
from collections.abc import Mapping
from contextlib import closing
from typing import Any

import numpy as np
from PIL import Image

from scenepack.codecs.base import Decoded, Shape, decoding
from scenepack.codecs.decoder_sandbox import Decoders

PICTURE = "picture"
FORMATS = ("AVIF", "WEBP", "JPEG", "PNG")
# Of the demo's photographs, 200 × 200: 38.7 dB at 7.3 kB each. WebP, which halves the resolution of colours, ends at
# 34.5 dB; JPEG takes twice as much for 37.8 dB.
QUALITY: dict[str, Any] = {"quality": 80, "subsampling": "4:4:4"}
LARGEST_SIDE, LARGEST_TEXT = 4096, 16 << 20  # what is read: pixels, characters


def picture_uri(pixels: np.ndarray, side: int) -> str:
    """A data URI of `pixels` (uint8 [h, w, 3]) at no more than `side` pixels a side."""
    picture = Image.fromarray(pixels)
    picture.thumbnail((side, side), Image.Resampling.BOX)
    file = io.BytesIO()
    picture.save(file, "AVIF", **QUALITY)
    return "data:image/avif;base64," + base64.b64encode(file.getvalue()).decode()


def has_picture(camera: Any) -> bool:
    """Whether an entry of "cameras" brings its photograph along, as far as is known without decoding it."""
    text = camera.get(PICTURE) if isinstance(camera, Mapping) else None
    return isinstance(text, str) and text.startswith("data:image/") and len(text) <= LARGEST_TEXT


def picture_of(camera: Mapping[str, Any]) -> np.ndarray | None:
    """The picture of an entry of "cameras", uint8 [h, w, 3]; None where it has none, or none that can be decoded."""
    if not has_picture(camera):
        return None
    head, _, data = str(camera[PICTURE]).partition(",")
    if not head.endswith(";base64"):
        return None
    try:
        content = base64.b64decode(data, validate=True)
        with Image.open(io.BytesIO(content), formats=FORMATS) as opened:
            width, height = opened.size  # from the header
        if max(width, height) > LARGEST_SIDE:
            return None
        with closing(Decoders()) as decoders:
            rgba, _ = decoders.decode(PICTURE, {PICTURE: content}, (PICTURE,), (1, height, width), False)
        return rgba[0, ..., :3]
    except MemoryError:
        raise
    except Exception:  # Pillow raises a dozen unrelated types
        return None


def decode_picture(files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool) -> Decoded:
    """As of a codec, in a process of its own (scenepack.codecs.decoder_sandbox): AVIF and JPEG can ask for endless work."""
    with decoding(names[0]), Image.open(io.BytesIO(files[names[0]]), formats=FORMATS) as opened:
        return np.asarray(opened.convert("RGBA")).reshape(*shape, 4), None
