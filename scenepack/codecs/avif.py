"""AV1, as sequences of AVIF: planes of the grid as frames, with everything done that makes them easy to predict.

imagecodecs has encoder (libaom) and decoder (dav1d), so every install can open these packs, without PyAV.
"""

from typing import Any

import imagecodecs
import numpy as np

from scenepack.codecs.base import CodecError, Layout, Shape
from scenepack.codecs.streams import StreamCodec

PLANES = 128  # about as many to a piece: few key frames, yet pieces for each thread
SPEED = 6  # of 0 … 10; 8 is three times as fast and 4 dB worse
THREADS = 2
MATRIX = 1  # BT.709
# Alpha shows most, features least; the best of those tried on a lego at 512³. Features in few levels lose as much by 0 as others
# by -30, in as many bytes.
OFFSETS = {"alpha": 10, "rgb": 0, "feature": -30, "fine feature": 0}


class AvifCodec(StreamCodec):
    """alpha_NNN.avif, rgb_NNN.avif, …; see scenepack.codecs.streams."""

    name = "avif"
    layout = "grid"
    default_quality = 83
    header_bytes = 4096
    straight = True
    suffix = "avif"

    def planes(self, layout: Layout, block_size: int) -> int:
        return max(1, PLANES // block_size) * block_size

    def film(self, frames: np.ndarray, part: str, quality: int) -> bytes:
        options: dict[str, Any] = {"pixelformat": "yuv444"}
        if frames.ndim == 3:  # imagecodecs codes grey without loss only; this is grey, coded as colour
            frames = np.repeat(frames[..., None], 3, axis=-1)
            options = {"pixelformat": "yuv420"}
        level = min(max(quality + OFFSETS[part], 1), 99)
        options |= {"level": level, "speed": SPEED, "matrix": MATRIX, "numthreads": THREADS}
        return bytes(imagecodecs.avif_encode(np.ascontiguousarray(frames), **options))

    def frames(self, data: bytes, shape: Shape, *, colour: bool) -> np.ndarray:
        self.check_film(data[: self.header_bytes], shape)
        out = np.empty((*shape, 3), np.uint8)
        imagecodecs.avif_decode(data, numthreads=THREADS, out=out if shape[0] > 1 else out[0])
        return out if colour else out[..., 1]

    def check_film(self, head: bytes, shape: Shape) -> None:
        if head[4:8] != b"ftyp" or head[8:12] not in (b"avis", b"avif"):
            raise CodecError("it is not an AVIF")
        found = (numbers_in(head, b"stsz", 2)[1] if head[8:12] == b"avis" else 1, *numbers_in(head, b"ispe", 2)[::-1])
        if found != shape:
            expected = f"{shape[2]}×{shape[1]} × {shape[0]}"
            raise CodecError(f"it is {found[2]}×{found[1]} × {found[0]} frames, expected {expected}")


def numbers_in(head: bytes, box: bytes, count: int) -> tuple[int, ...]:
    """The first big-endian words in an ISO box, after its version and flags. CodecError where they are not there."""
    start = head.find(box) + 8
    end = start + 4 * count
    if start < 8 or end > len(head):
        raise CodecError("the AVIF header is cut off")
    return tuple(int(n) for n in np.frombuffer(head[start:end], ">u4"))
