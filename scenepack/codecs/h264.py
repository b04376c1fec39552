"""H.264 in MP4, by PyAV (x264), which is an extra.

FFmpeg reads a film from memory, as MP4 alone, in a process of its own (scenepack.codecs.decoder_sandbox).

Macroblocks of 32 voxels lie on H.264's own of 16, so no coded block mixes two of them. Colours and features stay
premultiplied and 4:4:4.
"""

import io
from types import ModuleType

import numpy as np

from console import UserError
from console.file_signature import sniff_type
from scenepack.codecs.base import CodecError, Layout, Shape
from scenepack.codecs.streams import StreamCodec

PRESET = "medium"
GREY, COLOUR = "gray", "yuv444p"
# Quantisers by quality: 0 at 100, 26 at 50. They double a step every 6; so much finer are those of some parts.
FINER = {"alpha": 4, "fine feature": 12}
LARGEST_VECTOR = 64  # bytes
THREADS = 2
# Of FFmpeg's reader of MP4: no other file, no network, no other codec.
READING = {"ignore_editlist": "1", "enable_drefs": "0", "protocol_whitelist": "none", "codec_whitelist": "h264"}
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
        av, out, done = _av(), np.empty((*shape, 3) if colour else shape, np.uint8), 0
        try:
            with av.open(io.BytesIO(data), format="mp4", options=READING) as film:
                found = [str(each.codec_context and each.codec_context.codec_tag) for each in film.streams]
                if found != ["avc1"]:
                    raise CodecError(f"it holds {', '.join(found) or 'no film'}, expected one film of H.264 (avc1)")
                stream = film.streams.video[0]
                if (stream.height, stream.width) != shape[1:]:
                    raise CodecError(f"it is {stream.width}×{stream.height}, expected {shape[2]}×{shape[1]}")
                stream.thread_count = THREADS
                # Whatever size the frames claim; FFmpeg counts rows filled up to whole vectors.
                stream.codec_context.options = {"max_pixels": str(shape[1] * (shape[2] + LARGEST_VECTOR))}
                for frame in film.decode(stream):
                    if done == shape[0]:
                        raise CodecError(f"it holds more than the {shape[0]} frames expected")
                    pixels = frame.to_ndarray()
                    # FFmpeg decodes grey to 4:2:0, whose luma rows come first.
                    out[done] = _rgb(pixels) if colour else pixels[: shape[1]]
                    done += 1
        except av.FFmpegError as error:  # without its number
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


def _ycc(rgb: np.ndarray) -> np.ndarray:
    """uint8 [H, W, 3] as uint8 [3, H, W] of luma and chroma."""
    values = np.rint(rgb @ YCC_FROM_RGB.T + CENTRE)
    return np.ascontiguousarray(np.clip(values, 0, 255).astype(np.uint8).transpose(2, 0, 1))


def _rgb(ycc: np.ndarray) -> np.ndarray:
    """The inverse of _ycc."""
    values = (ycc.transpose(1, 2, 0) - CENTRE) @ RGB_FROM_YCC.T
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
