"""H.264 in MP4, by PyAV (x264), which is an extra.

MP4: ISO/IEC 14496-12 and -15. We find the frames' bytes, for FFmpeg's own reader of MP4 believes what the tables claim,
allocates for it, follows edit lists, and knows boxes that lead to other files.

Notation: a box is its size (u32), its type (4 bytes) and its contents; some contain boxes. The samples, frames in the order of
decoding, lie in chunks: stco (or co64) has the chunks' places, stsc how many samples are in each, stsz the samples' sizes.

Macroblocks of 32 voxels lie on H.264's own of 16, so no coded block mixes two of them. Colours and features stay
premultiplied and 4:4:4.
"""

import io
import struct
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np

from console import UserError
from console.file_signature import sniff_type
from scenepack.codecs.base import CodecError, Layout, Shape
from scenepack.codecs.streams import StreamCodec

WAY = (b"mdia", b"minf", b"stbl")  # of boxes, from a track to its tables
ENTRY = struct.Struct(">24xHH50x")  # of stsd: width and height; boxes follow


def _film(data: memoryview, most: int) -> tuple[tuple[int, int], bytes, list[memoryview]]:
    """The one H.264 film of an MP4: (width, height), the decoder's setup (avcC) and the bytes of each frame. CodecError, or what
    struct and dictionaries raise, where it is none, has more than `most` frames, or some that do not lie in it.
    """
    tracks = [track for kind, track in _boxes(_only(data, b"moov")) if kind == b"trak"]
    tables = []
    for track in tracks:
        for kind in WAY:
            track = _only(track, kind)
        tables.append({kind: contents[4:] for kind, contents in _boxes(track)})  # after version and flags
    entries = [_only_entry(table[b"stsd"]) for table in tables]
    found = ", ".join(kind.decode("latin-1") for kind, _ in entries)
    if [kind for kind, _ in entries] != [b"avc1"]:
        raise CodecError(f"it holds {found or 'no film'}, expected one film of H.264 (avc1)")
    [(_, entry)], [table] = entries, tables
    width, height = ENTRY.unpack_from(entry)
    setup = bytes(_only(entry[ENTRY.size :], b"avcC"))
    return (width, height), setup, list(_samples(data, table, most))


def _only_entry(descriptions: memoryview) -> tuple[bytes, memoryview]:
    """The coding of a track and its description."""
    (count,) = struct.unpack_from(">I", descriptions)
    if count != 1:
        raise CodecError(f"its frames are coded in {count} ways")
    return next(_boxes(descriptions[4:]))


def _samples(data: memoryview, table: dict[bytes, memoryview], most: int) -> Iterator[memoryview]:
    size, count = struct.unpack_from(">II", table[b"stsz"])
    if count > most:
        raise CodecError(f"it holds more than the {most} frames expected")
    sizes = [size] * count if size else struct.unpack_from(f">{count}I", table[b"stsz"], 8)
    places = table[b"co64"] if b"co64" in table else table[b"stco"]
    width = 8 if b"co64" in table else 4
    runs = struct.unpack_from(">I", table[b"stsc"])[0]
    done = chunk = run = 0
    left = sum(sizes)
    if left > len(data):
        raise CodecError("its frames share bytes")
    while done < count:
        if run + 1 < runs and struct.unpack_from(">I", table[b"stsc"], 4 + 12 * (run + 1))[0] == chunk + 1:
            run += 1
        per_chunk = struct.unpack_from(">I", table[b"stsc"], 8 + 12 * run)[0]
        if not per_chunk:
            raise CodecError("the film is damaged")
        at = int.from_bytes(places[4 + width * chunk : 4 + width * (chunk + 1)], "big")
        for size in sizes[done : done + per_chunk]:
            if at + size > len(data):
                raise CodecError("it is cut off")
            yield data[at : at + size]
            at += size
        done += per_chunk
        chunk += 1


def _boxes(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    """Type and contents of one box after the other."""
    at = 0
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        head = 8
        if size == 1:
            (size,) = struct.unpack_from(">Q", data, at + 8)
            head = 16
        size = size or len(data) - at
        if size < head or at + size > len(data):
            raise CodecError("it is cut off")
        yield kind, data[at + head : at + size]
        at += size


def _only(data: memoryview, kind: bytes) -> memoryview:
    """The contents of the one box of that type."""
    found = [contents for name, contents in _boxes(data) if name == kind]
    if len(found) != 1:
        raise CodecError(f"the film is damaged: {len(found)} boxes {kind.decode()}")
    return found[0]


# --- H.264 ---

PRESET = "medium"
GREY, COLOUR = "gray", "yuv444p"
# Quantisers by quality: 0 at 100, 26 at 50. They double a step every 6; so much finer are those of some parts.
FINER = {"alpha": 4, "fine feature": 12}
LARGEST_VECTOR = 64  # bytes
THREADS = 2
# BT.709, full range; y is the first row.
YCC_FROM_RGB = np.array([[0.2126, 0.7152, 0.0722], [-0.1146, -0.3854, 0.5], [0.5, -0.4542, -0.0458]], np.float32)
RGB_FROM_YCC = np.linalg.inv(YCC_FROM_RGB.astype(np.float64)).astype(np.float32)
CENTRE = np.array([0, 128, 128], np.float32)


class H264Codec(StreamCodec):
    """alpha_NNN.mp4, rgb_NNN.mp4, …; see scenepack.codecs.streams."""

    name = "h264"
    layout = "atlas"
    default_quality = 85
    header_bytes = 16
    straight = False
    suffix = "mp4"

    def require(self) -> None:
        _av()

    def planes(self, layout: Layout, block_size: int) -> int:
        return block_size + 2

    def film(self, frames: np.ndarray, part: str, quality: int) -> bytes:
        av = _av()
        colour = frames.ndim == 4
        quantiser = max(round((100 - quality) * 0.52) - FINER.get(part, 0), 0)
        options = {"qp": str(quantiser), "preset": PRESET, "tune": "psnr"}
        buffer = io.BytesIO()
        with av.open(buffer, "w", format="mp4") as film:
            stream = film.add_stream("libx264", rate=25, options=options)
            stream.height, stream.width = frames.shape[1:3]
            stream.pix_fmt = COLOUR if colour else GREY
            stream.codec_context.color_range = 2  # all of 0 … 255
            for plane in frames:
                frame = av.VideoFrame.from_ndarray(_ycc(plane) if colour else plane, format=stream.pix_fmt)
                film.mux(stream.encode(frame))
            film.mux(stream.encode())
        return buffer.getvalue()

    def frames(self, data: bytes, shape: Shape, *, colour: bool) -> np.ndarray:
        self.check_film(data[: self.header_bytes], shape)
        try:
            size, setup, samples = _film(memoryview(data), shape[0])
        except (struct.error, KeyError, IndexError) as error:
            raise CodecError("the film is damaged") from error
        if size[::-1] != shape[1:]:
            raise CodecError(f"it is {size[0]}×{size[1]}, expected {shape[2]}×{shape[1]}")
        out = np.empty((*shape, 3) if colour else shape, np.uint8)
        done = 0
        try:
            for frame in _decoded(setup, samples, shape):
                if done == shape[0]:
                    raise CodecError(f"it holds more than the {shape[0]} frames expected")
                pixels = frame.to_ndarray()
                # FFmpeg decodes grey to 4:2:0, whose luma rows come first.
                out[done] = _rgb(pixels) if colour else pixels[: shape[1]]
                done += 1
        except _av().FFmpegError as error:  # without its number
            raise CodecError(f"the film is damaged: {error.strerror}") from error
        if done != shape[0]:
            raise CodecError(f"it holds {done} frames, expected {shape[0]}")
        return out

    def check_film(self, head: bytes, shape: Shape) -> None:
        if head[4:8] != b"ftyp":
            raise CodecError(f"it is not an MP4 but {sniff_type(head)}")


def _av() -> ModuleType:
    try:
        import av
    except ImportError as error:
        raise UserError(
            "H.264 needs PyAV, which is not installed", remedy='pip install "snerg[video]", or use --codec avif'
        ) from error
    return av


def _decoded(setup: bytes, samples: list[memoryview], shape: Shape) -> Iterator[Any]:
    """The frames, by a decoder alone: no container is opened, and so no file, no list and no socket."""
    av = _av()
    context = av.CodecContext.create("h264", "r")
    context.extradata = setup
    context.thread_count = THREADS
    # Whatever size the frames claim; FFmpeg counts rows filled up to whole vectors.
    context.options = {"max_pixels": str(shape[1] * (shape[2] + LARGEST_VECTOR))}
    for sample in samples:
        yield from context.decode(av.Packet(bytes(sample)))
    yield from context.decode(None)


def _ycc(rgb: np.ndarray) -> np.ndarray:
    """uint8 [H, W, 3] as uint8 [3, H, W] of luma and chroma."""
    values = np.rint(rgb @ YCC_FROM_RGB.T + CENTRE)
    return np.ascontiguousarray(np.clip(values, 0, 255).astype(np.uint8).transpose(2, 0, 1))


def _rgb(ycc: np.ndarray) -> np.ndarray:
    """The inverse of _ycc."""
    values = (ycc.transpose(1, 2, 0) - CENTRE) @ RGB_FROM_YCC.T
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
