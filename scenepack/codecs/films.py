"""Film codecs: planes of voxels as frames of AV1, in straight colours, or of H.264, premultiplied.

Notation: c premultiplied colour or feature, a alpha, both 0 … 255; c̄ = c / a straight; ⟨·⟩ the mean over the 3³ neighbours
weighted 1 2 1 along each axis. A renderer adds up a·c̄, so that an error in c̄ counts a / 255 times; a codec does not know that,
and spends most of its bits on the noise of nearly transparent voxels. Therefore, for straight colours,
- each voxel's c̄ is drawn towards its surroundings, the more the fainter it is:
  c̄ = (c + k·⟨c⟩/⟨a⟩) / (a + k), with k = `smoothing` in units of alpha: two thirds fewer bits at equal quality;
- empty voxels, whose colour is invisible, continue their neighbours by means over 2³, 4³, … voxels ("pull-push"), so that no edge
  is coded at the surface; voxels far from all content are grey.
All is done within cells of 16³ voxels, the unit of most codecs' own macroblocks: cells without content cost nothing.

A piece is [D, H, W]; its frames are its D planes, filled up to whole cells. Files of piece N: occupied_NNN.xz, which voxels have
any alpha, exactly; alpha, grey; rgb; feature, the first three channels; feature_w, the fourth, grey. What was empty decodes to
zero, what was not to an alpha of at least 1.
"""

import io
import lzma
from math import prod
from types import ModuleType
from typing import ClassVar

import imagecodecs
import numpy as np

from console import UserError
from console.file_signature import sniff_type
from scenepack.codecs.base import Codec, CodecError, Layout, Parts, Shape, cut_off, decoding, in_few_levels

CELL = 16  # voxels
GREY = 128
CELLS_AT_ONCE = 128
THREADS = 2  # of a decoder or encoder


def _padded(values: np.ndarray, axes: tuple[int, ...] = (1, 2)) -> np.ndarray:
    """[D, H, W, …], filled up to whole cells along `axes`, by zeros."""
    return np.pad(values, [(0, -side % CELL if axis in axes else 0) for axis, side in enumerate(values.shape)])


def _filled(values: np.ndarray, weights: np.ndarray, unit: int = 1, smoothing: float = 0.0) -> np.ndarray:
    """uint8 [D, H, W, C] in whole cells: `unit` · values / weights [D, H, W], continued where the weight is 0."""
    whole, weights = _padded(values, (0, 1, 2)), _padded(weights[..., None], (0, 1, 2))
    result = np.full_like(whole, GREY)
    colour_cells, weight_cells, result_cells = map(_cells, (whole, weights, result))
    used = np.argwhere(weight_cells.any(axis=(3, 4, 5, 6)))
    for start in range(0, len(used), CELLS_AT_ONCE):
        some = tuple(used[start : start + CELLS_AT_ONCE].T)
        colour, weight = colour_cells[some].astype(np.float32), weight_cells[some].astype(np.float32)
        if smoothing > 0:
            surroundings = _blurred(colour) / np.maximum(_blurred(weight), 1e-6)
            inside = smoothing * (weight > 0)
            colour, weight = colour + inside * surroundings, weight + inside
        result_cells[some] = np.clip(np.rint(unit * _pull_push(colour, weight)), 0, 255).astype(np.uint8)
    return result[: len(values)]


def _cells(values: np.ndarray) -> np.ndarray:
    """A view of values [D, H, W, C] of whole cells, by cell: [D / CELL, H / CELL, W / CELL, CELL, CELL, CELL, C]."""
    depth, height, width, channels = values.shape
    sides = (depth // CELL, CELL, height // CELL, CELL, width // CELL, CELL)
    return values.reshape(*sides, channels).transpose(0, 2, 4, 1, 3, 5, 6)


def _blurred(values: np.ndarray) -> np.ndarray:
    """Weights 1 2 1 along axes 1, 2, 3, zeros outside; not normalised."""
    from scipy import ndimage

    for axis in (1, 2, 3):
        values = ndimage.correlate1d(values, [1, 2, 1], axis, mode="constant")
    return values


def _pull_push(total: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """total / weight [n, s, s, s, c], and where the weight is zero, that of the smallest 2³, 4³, … around with any."""
    mean = total / np.maximum(weight, 1e-6)
    side = total.shape[1]
    if side == 1:
        return mean
    pairs = (len(total), side // 2, 2, side // 2, 2, side // 2, 2, -1)
    coarse = _pull_push(total.reshape(pairs).sum((2, 4, 6)), weight.reshape(pairs).sum((2, 4, 6)))
    for axis in (1, 2, 3):
        coarse = coarse.repeat(2, axis)
    return np.where(weight > 0, mean, coarse)


# --- Lossy codecs that show a piece's planes as the frames of short films ---

CUBE = 2  # voxels a side that share a byte of the occupancy
FIRST_SMOOTHING, SMOOTHED_FROM = 8.0, 75.0  # in units of alpha, at this quality and below; none at 100
_XZ = b"\xfd7zXZ\x00"


class FilmCodec(Codec):
    """What AVIF and H.264 share; see the module. straight: colours are stored straight, else premultiplied."""

    straight: ClassVar[bool]
    suffix: ClassVar[str]

    def names(self, number: int, shape: Shape, features: bool) -> tuple[str, ...]:
        end = f"{number:03d}.{self.suffix}"
        names = (f"occupied_{number:03d}.xz", f"alpha_{end}", f"rgb_{end}")
        return (*names, f"feature_{end}", f"feature_w_{end}") if features else names

    def check(self, name: str, head: bytes, shape: Shape) -> None:
        if len(head) < len(_XZ):
            raise cut_off(head)
        if not name.endswith(".xz"):
            self.check_film(head, _frames(shape))
        elif not head.startswith(_XZ):
            raise CodecError("it is not an .xz")

    def encode(self, parts: Parts, quality: int) -> tuple[bytes, ...]:
        rgba, *others = parts
        alpha = np.ascontiguousarray(rgba[..., 3])
        k = FIRST_SMOOTHING * min(1.0, (100 - quality) / (100 - SMOOTHED_FROM))

        def colours(values: np.ndarray) -> np.ndarray:
            return _filled(values, alpha, 255, k) if self.straight else _padded(values)

        grey = _filled(alpha[..., None], alpha > 0)[..., 0] if self.straight else _padded(alpha)
        files = [_pack_occupancy(alpha > 0), self.film(grey, "alpha", quality)]
        files.append(self.film(colours(rgba[..., :3]), "rgb", quality))
        for features in others:
            values, part = colours(features), "fine feature" if in_few_levels(features) else "feature"
            files.append(self.film(np.ascontiguousarray(values[..., :3]), part, quality))
            files.append(self.film(np.ascontiguousarray(values[..., 3]), part, quality))
        return tuple(files)

    def decode(self, files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool) -> Parts:
        _, height, width = shape
        frames = _frames(shape)
        with decoding(names[0]):
            occupied = _unpack_occupancy(files[names[0]], shape)
        with decoding(names[1]):
            alpha = self.frames(files[names[1]], frames, colour=False)[:, :height, :width]
        alpha = np.where(occupied, np.maximum(alpha, 1), 0).astype(np.uint8)

        def colours(name: str, colour: bool) -> np.ndarray:
            with decoding(name):
                values = self.frames(files[name], frames, colour=colour).reshape(*frames, -1)[:, :height, :width]
            if self.straight:
                return ((values.astype(np.uint16) * alpha[..., None] + 127) // 255).astype(np.uint8)
            return np.minimum(values, alpha[..., None])

        parts = [[colours(names[2], True), alpha[..., None]]]
        if features:
            parts.append([colours(names[3], True), colours(names[4], False)])
        return [np.concatenate(channels, axis=-1) for channels in parts]

    def film(self, frames: np.ndarray, part: str, quality: int) -> bytes:
        """uint8 frames [D, H, W] grey or [D, H, W, 3] coded; part: "alpha", "rgb", "feature", "fine feature" (in_few_levels)."""
        raise NotImplementedError

    def frames(self, data: bytes, shape: Shape, *, colour: bool) -> np.ndarray:
        """The frames back, uint8 [D, H, W] or [D, H, W, 3]. Raises anything."""
        raise NotImplementedError

    def check_film(self, head: bytes, shape: Shape) -> None:
        """CodecError where a film's first header_bytes tell that it is none of these frames."""
        raise NotImplementedError


def _pack_occupancy(occupied: np.ndarray) -> bytes:
    """bool [D, H, W] as xz of one byte for each cube of 2³ voxels, which compresses better than rows of bits."""
    even = np.pad(occupied, [(0, side % CUBE) for side in occupied.shape])
    d, h, w = (side // CUBE for side in even.shape)
    cubes = even.reshape(d, CUBE, h, CUBE, w, CUBE).transpose(0, 2, 4, 1, 3, 5)
    return lzma.compress(np.packbits(cubes).tobytes(), preset=6)


def _unpack_occupancy(data: bytes, shape: Shape) -> np.ndarray:
    """The inverse of _pack_occupancy. CodecError or LZMAError."""
    d, h, w = (-(-side // CUBE) for side in shape)
    cubes = np.unpackbits(np.frombuffer(cubes_in(data, shape), np.uint8)).reshape(d, h, w, CUBE, CUBE, CUBE)
    occupied = cubes.transpose(0, 3, 1, 4, 2, 5).reshape(d * CUBE, h * CUBE, w * CUBE)
    return occupied[: shape[0], : shape[1], : shape[2]].astype(bool)


def cubes_in(data: bytes, shape: Shape) -> bytes:
    """What is in the file occupied_NNN.xz: the bytes of cubes. CodecError or LZMAError."""
    count = prod(-(-side // CUBE) for side in shape)
    unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ)
    cubes = unpacker.decompress(data, max_length=count + 1)
    if len(cubes) != count or not unpacker.eof:
        raise CodecError(f"it holds {len(cubes)} bytes, expected {count}")
    return cubes


def _frames(shape: Shape) -> Shape:
    return shape[0], -(-shape[1] // CELL) * CELL, -(-shape[2] // CELL) * CELL


# --- AV1, as sequences of AVIF. imagecodecs has encoder (libaom) and decoder (dav1d): every install opens these packs. ---

PLANES = 128  # about as many to a piece: few key frames, yet pieces for each thread
SPEED = 6  # of 0 … 10; 8 is three times as fast and 4 dB worse
MATRIX = 1  # BT.709
# Alpha shows most, features least; the best of those tried on a lego at 512³. Features in few levels lose as much by 0 as others
# by -30, in as many bytes.
OFFSETS = {"alpha": 10, "rgb": 0, "feature": -30, "fine feature": 0}


class AvifCodec(FilmCodec):
    """alpha_NNN.avif, rgb_NNN.avif, …"""

    name = "avif"
    layout = "grid"
    default_quality = 83
    header_bytes = 4096
    straight = True
    suffix = "avif"

    def planes(self, layout: Layout, block_size: int) -> int:
        return max(1, PLANES // block_size) * block_size

    def film(self, frames: np.ndarray, part: str, quality: int) -> bytes:
        pixels = "yuv444"
        if frames.ndim == 3:  # imagecodecs codes grey without loss only; this is grey, coded as colour
            frames, pixels = np.repeat(frames[..., None], 3, axis=-1), "yuv420"
        level = min(max(quality + OFFSETS[part], 1), 99)
        options = {"level": level, "speed": SPEED, "matrix": MATRIX, "numthreads": THREADS, "pixelformat": pixels}
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


# --- H.264 in MP4, by PyAV (x264), an extra. Macroblocks of 32 voxels lie on H.264's own of 16, so no block mixes two. ---

PRESET = "medium"
# Quantisers by quality: 0 at 100, 26 at 50. They double a step every 6; so much finer are those of some parts.
FINER = {"alpha": 4, "fine feature": 12}
LARGEST_VECTOR = 64  # bytes
# Of FFmpeg's reader of MP4: no other file, no network, no other codec.
READING = {"ignore_editlist": "1", "enable_drefs": "0", "protocol_whitelist": "none", "codec_whitelist": "h264"}
# BT.709, full range; y is the first row.
YCC_FROM_RGB = np.array([[0.2126, 0.7152, 0.0722], [-0.1146, -0.3854, 0.5], [0.5, -0.4542, -0.0458]], np.float32)
RGB_FROM_YCC = np.linalg.inv(YCC_FROM_RGB.astype(np.float64)).astype(np.float32)
CENTRE = np.array([0, 128, 128], np.float32)


class H264Codec(FilmCodec):
    """alpha_NNN.mp4, rgb_NNN.mp4, …; FFmpeg reads them from memory, as MP4 alone, in a process of its own (decoder_sandbox)."""

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
            stream.pix_fmt = "yuv444p" if colour else "gray"
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
