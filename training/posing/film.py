"""Frames of films: which are used, and their colours.

Notation: a signal is R'G'B' as it is coded, in [0, 1]; light is linear R, G, B, and 1 is diffuse white.

HLG: the inverse OETF gives light of the scene (ITU-R BT.2100, table 5); diffuse white is at 75 % of the signal. PQ: the EOTF
gives light of the display (table 4); diffuse white has 203 cd/m² (BT.2408, 2.2). Light up to KNEE stays as it is. Above,
Reinhard's extended curve goes on with the same slope and brings the brightest light to 1: diffuse white becomes 244 of 255.

A film is read by the one demuxer of its container and by one of CODECS, so that FFmpeg neither guesses at formats that lead to
other files or to the network, nor follows references out of the film.
"""

import errno
import itertools
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from av.stream import Disposition
from PIL import Image

from console import UserError
from training.posing.photograph import same_view, sharpness, shift, thumbnail, write_picture
from training.scenes.deep_pictures import linear_to_srgb
from training.scenes.files import notice
from training.scenes.pictures import PREVIEW_SIDE
from training.scenes.sources import DEMUXERS, container_of, require_source

# Values of ITU-T H.273, which FFmpeg has as AVCOL_…: transfer characteristics, primaries, matrix coefficients.
PQ, HLG = 16, 18
BT709, BT601, BT2020, P3 = 1, 5, 9, 12
UNSPECIFIED = (2, 3)  # 3: reserved
# Matrices that swscale does not know, and would take for another.
REFUSED = {8: "YCgCo", 11: "YDzDx", 14: "ICtCp", 15: "IPT (Dolby Vision, profile 5)", 16: "YCgCo-R", 17: "YCgCo-R"}
SD_SIZE = (1279, 576)  # width and height up to which players take an untagged film as BT.601, and above as BT.709
KNEE = 0.8
DIFFUSE_WHITE_HLG = 0.75  # of the signal
DIFFUSE_WHITE_PQ, BRIGHTEST_PQ = 203.0, 1000.0  # cd/m²; what is brighter is clipped
LEVELS = 1 << 16
BAND_PIXELS = 1 << 20  # that are converted at once
# To the primaries of sRGB (BT.709), both with white D65. Rows sum to 1.
SRGB_T_BT2020 = np.array(
    [[1.660491, -0.587641, -0.072850], [-0.124550, 1.132900, -0.008349], [-0.018151, -0.100579, 1.118730]]
)
SRGB_T_P3 = np.array([[1.224940, -0.224940, 0.0], [-0.042057, 1.042057, 0.0], [-0.019638, -0.078636, 1.098274]])


def with_matrix(frame: Any, film: Path) -> Any:
    """A decoded frame of a film, with the matrix that players take where none is said. UserError where it is not supported."""
    if frame.format.is_rgb:
        return frame
    if frame.colorspace in REFUSED:
        raise UserError("the film's colours are coded in a way that is not read", where=film, found=REFUSED[frame.colorspace],
                        expected="BT.601, BT.709 or BT.2020", remedy="export it as H.264")  # fmt: skip
    if frame.colorspace in UNSPECIFIED:
        is_hd = frame.width > SD_SIZE[0] or frame.height > SD_SIZE[1]
        is_uhd = frame.color_trc in (PQ, HLG) or frame.color_primaries == BT2020
        frame.colorspace = BT2020 if is_uhd else BT709 if is_hd else BT601
    return frame


def srgb_of(frame: Any, width: int) -> np.ndarray:
    """A frame with its matrix as uint8 [H, width, 3]."""
    hdr, primaries = frame.color_trc if frame.color_trc in (PQ, HLG) else None, frame.color_primaries
    matrix = SRGB_T_P3.astype(np.float32) if primaries == P3 else None  # None: sRGB's own primaries, and what is close
    if primaries == BT2020 or (hdr is not None and primaries in UNSPECIFIED):
        matrix = SRGB_T_BT2020.astype(np.float32)
    if hdr is None and matrix is None:
        return frame.to_ndarray(format="rgb24", width=width, height=frame.height)
    return _converted(frame.to_ndarray(format="rgb48le", width=width, height=frame.height), hdr, matrix)


def _converted(signal: np.ndarray, hdr: int | None, matrix: np.ndarray | None) -> np.ndarray:
    """uint16 [H, W, 3] in the film's transfer function and primaries as uint8 sRGB."""
    light_of, brightest, code_of = _tables(hdr)
    out = np.empty(signal.shape, np.uint8)
    rows = max(BAND_PIXELS // signal.shape[1], 1)
    for first in range(0, len(signal), rows):
        light = light_of[signal[first : first + rows]]
        if matrix is not None:
            light = light @ matrix.T
        steps = np.sqrt(np.clip(light / brightest, 0, 1)) * (LEVELS - 1)
        out[first : first + rows] = code_of[np.rint(steps).astype(np.uint16)]
    return out


@cache
def _tables(hdr: int | None) -> tuple[np.ndarray, float, np.ndarray]:
    """Light float32 of each of LEVELS signals; the brightest that is kept; uint8 sRGB by LEVELS square roots of its shares."""
    signal = np.linspace(0, 1, LEVELS)
    if hdr == HLG:
        light = hlg_to_scene(signal) / float(hlg_to_scene(np.array(DIFFUSE_WHITE_HLG)))
        brightest = float(light[-1])
    elif hdr == PQ:
        light, brightest = pq_to_nits(signal) / DIFFUSE_WHITE_PQ, BRIGHTEST_PQ / DIFFUSE_WHITE_PQ
    else:
        light, brightest = srgb_to_linear(signal), 1.0
    kept = np.linspace(0, 1, LEVELS) ** 2 * brightest
    shown = kept if hdr is None else tone_mapped(kept, brightest)
    return light.astype(np.float32), brightest, np.rint(linear_to_srgb(shown) * 255).astype(np.uint8)


def tone_mapped(light: np.ndarray, brightest: float) -> np.ndarray:
    """Light as a display shows it that has nothing brighter than 1. brightest: what becomes 1."""
    above, most = (np.maximum((value - KNEE) / (1 - KNEE), 0) for value in (light, np.float64(brightest)))
    return np.where(light <= KNEE, light, KNEE + (1 - KNEE) * above * (1 + above / most**2) / (1 + above))


def hlg_to_scene(signal: np.ndarray) -> np.ndarray:
    """The inverse OETF of HLG: light of the scene in [0, 1]."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(signal <= 0.5, signal**2 / 3, (np.exp((signal - c) / a) + b) / 12)


def pq_to_nits(signal: np.ndarray) -> np.ndarray:
    """The EOTF of PQ: light of the display in cd/m²."""
    m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 4096 * 128, 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
    power = signal ** (1 / m2)
    return 10000 * (np.maximum(power - c1, 0) / (c2 - c3 * power)) ** (1 / m1)


def srgb_to_linear(signal: np.ndarray) -> np.ndarray:
    return np.where(signal <= 0.04045, signal / 12.92, ((signal + 0.055) / 1.055) ** 2.4)


# --- frames as photographs: the sharpest of each interval of time, upright; runs in the child process -----------------

CODECS = (
    "h264", "hevc", "vp8", "vp9", "av1", "mpeg4", "mjpeg", "prores", "dnxhd", "mpeg1video", "mpeg2video", "h263", "msmpeg4v2",
    "msmpeg4v3", "msmpeg4", "wmv1", "wmv2", "wmv3", "vc1", "flv", "flv1", "vp6", "vp6f", "theora", "dvvideo", "ffv1", "rawvideo",
)  # fmt: skip
OPTIONS = {"enable_drefs": "0", "protocol_whitelist": "none", "format_whitelist": DEMUXERS}
MOST_PIXELS = 1 << 26  # of a frame; 8K has half as many
STATE_LENGTH = ("mp4", "matroska")  # demuxers of films whose headers say how long they are
MISSING_S = 1.0  # seconds that a film may be shorter than its header says
GLIMPSED = 30  # frames whose decoding is timed
SOUGHT = 60  # frames that are decoded after a key frame, at most, to come to a place
CANDIDATES = 2  # times as many frames as are used are looked at: a camera that slows down shows the same
LEAST_CHANGE = 0.1  # thumbnail pixels: a camera that comes closer shifts nothing
UNEVEN = 0.15  # of the film: how far change may run before or behind time
PER_SECOND = 6.0  # frames at most: more show the same
OnProgress = Callable[[str, float, float], object]  # what goes on, units done, units in all


@dataclass(frozen=True)
class Frame:
    """A frame that was kept."""

    name: str  # of its file
    size: tuple[int, int]  # (width, height) in pixels
    seconds: float  # into the film
    sharpness: float


@dataclass
class _Graded:
    """A frame as it was decoded."""

    interval: int
    seconds: float
    sharpness: float
    frame: Any
    aspect: float  # width by height of its pixels
    preview: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.frame.width, self.frame.height, self.frame.rotation or 0


def take_frames(film: Path, folder: Path, most: int, on_progress: OnProgress) -> list[Frame]:
    """Writes at most `most` frames into `folder`: of each interval of time the sharpest, none that shows the same as the one
    before. Where the camera slows down, intervals are not of equal time, but such in which the picture changes as much.

    UserError where the file is no film that can be read.
    """
    with _readable_errors(film):
        times = _times(film)
        length = times[-1] - times[0]
        kept: list[Frame] = []
        small: list[np.ndarray] = []
        candidates = CANDIDATES * most if length * PER_SECOND >= CANDIDATES * most else most
        intervals = itertools.groupby(_graded(film, times, candidates, on_progress), key=lambda frame: frame.interval)
        sharpest = (max(frames, key=lambda frame: frame.sharpness) for _, frames in intervals)
        for best in _differing(sharpest):
            small.append(thumbnail(best.preview))
            picture = _upright(best.frame, best.aspect)
            name = write_picture(Image.fromarray(picture), folder, f"frame_{len(kept) + 1:04d}", lossy=True)
            height, width = picture.shape[:2]
            kept.append(Frame(name, (width, height), round(best.seconds - times[0], 3), best.sharpness))
    return kept if len(kept) <= most else _spaced(kept, small, length, most, folder)


def _spaced(frames: list[Frame], small: Sequence[np.ndarray], length: float, most: int, folder: Path) -> list[Frame]:
    """The sharpest frame of each of `most` intervals, equal in time or in how much the picture changes; the files of the others
    are removed. small: thumbnails of the frames. length: of the film, in seconds."""
    shares = np.array([frame.seconds for frame in frames]) / length
    reached = np.cumsum([0.0, *(LEAST_CHANGE + shift(*pair) for pair in itertools.pairwise(small))])
    reached /= reached[-1]
    shares = reached if np.abs(reached - shares).max() > UNEVEN else shares
    best: dict[int, Frame] = {}
    for frame, share in zip(frames, shares, strict=True):
        interval = min(int(share * most), most - 1)
        if interval not in best or frame.sharpness > best[interval].sharpness:
            best[interval] = frame
    for frame in set(frames) - set(best.values()):
        (folder / frame.name).unlink()
    return list(best.values())


def glimpse(
    film: Path, most: int, some: int, count: Callable[[int], None], show: Callable[[int, float, Image.Image], None]
) -> tuple[int, float]:
    """Previews a film without decoding all of it: how many frames take_frames would keep at most, and an estimate of its
    seconds from GLIMPSED frames. count: called with that number at once. show: called with `some` evenly spaced frames: number,
    seconds into the film, picture. UserError as take_frames.
    """
    with _readable_errors(film):
        times = _times(film)
        frames = max(intervals_of(times, most)) + 1
        count(frames)
        started, decoded, first = time.monotonic(), 0, None
        with _opened(film) as (container, stream):
            for frame in itertools.islice(_decoded(film, container, stream), GLIMPSED):
                first = first or frame
                sharpness(_grey(frame))
                decoded += 1
        seconds = (time.monotonic() - started) / max(decoded, 1) * len(times)
        with _opened(film) as (container, stream):
            base, aspect, shown = float(stream.time_base), float(stream.sample_aspect_ratio or 1), -1
            for number, at in enumerate(np.linspace(times[0], times[-1], some + 1)[:-1]):
                container.seek(int(at / base), stream=stream)  # to the key frame before
                frame = None
                for frame in itertools.islice(_decoded(film, container, stream), SOUGHT):
                    if frame.pts is not None and frame.pts * base >= at:
                        break
                if frame is not None and frame.pts is not None and frame.pts > shown:
                    shown = frame.pts
                    show(number, shown * base - times[0], Image.fromarray(_upright(frame, aspect)))
            if shown < 0 and first is not None:  # a short transport stream: there is no key frame to come to
                show(0, 0.0, Image.fromarray(_upright(first, aspect)))
    return frames, seconds


def intervals_of(times: Sequence[float], most: int) -> list[int]:
    """In which of at most `most` equal intervals each frame is, by its time in seconds; frames may be spaced unevenly."""
    start, length = min(times), max(times) - min(times)
    count = min(most, max(int(length * PER_SECOND), 1))
    return [min(int((time - start) / length * count), count - 1) if length > 0 else 0 for time in times]


def _times(film: Path) -> list[float]:
    """When each frame is shown, in seconds, without decoding any. A notice where the film ends before its header says."""
    times, end = set(), 0.0
    with _opened(film) as (container, stream):
        for packet in container.demux():  # sound may go on after the last frame
            stamp = packet.dts if packet.pts is None else packet.pts
            if stamp is None:
                continue
            end = max(end, float((stamp + (packet.duration or 0)) * packet.time_base))
            if packet.stream is stream:
                times.add(stamp * float(stream.time_base))
        stated = (container.duration or 0) / av.time_base if container.format.name in STATE_LENGTH else 0.0
    if not times:
        raise UserError("the film has no frames", where=film)
    if end < stated - MISSING_S:
        sides = f"expected {stated:.1f} s, found {end:.1f} s"
        notice(film, f"the film ends early ({sides}); copy it again if it was longer")
    return sorted(times)


def _graded(film: Path, times: Sequence[float], most: int, on_progress: OnProgress) -> Iterator[_Graded]:
    """All frames, with their sharpness and the interval that they are in, in their order."""
    intervals = intervals_of(times, most)
    with _opened(film) as (container, stream):
        base, aspect = float(stream.time_base), float(stream.sample_aspect_ratio or 1)
        seconds = times[0]
        for frame in _decoded(film, container, stream):
            # Frames come in their order, but AVI does not say when those that were reordered are shown.
            seconds = seconds if frame.pts is None else max(frame.pts * base, seconds)
            interval = intervals[min(bisect_left(times, seconds), len(times) - 1)]
            on_progress("frames", seconds - times[0], max(times[-1] - times[0], 1e-3))
            preview = _grey(frame)
            yield _Graded(interval, seconds, sharpness(preview), frame, aspect, preview)


def _differing(frames: Iterator[_Graded]) -> Iterator[_Graded]:
    """Of frames in a row that show the same, since the camera rests, the sharpest; none of another size than the first."""
    before = next(frames, None)
    for frame in frames:
        if before is None or frame.shape != before.shape:
            continue
        differs = not same_view(thumbnail(frame.preview), thumbnail(before.preview))
        if differs:
            yield before
        if differs or frame.sharpness > before.sharpness:
            before = frame
    if before is not None:
        yield before


def _decoded(film: Path, container: Any, stream: Any) -> Iterator[Any]:
    return (with_matrix(frame, film) for frame in container.decode(stream))


def _grey(frame: Any) -> np.ndarray:
    scale = min(PREVIEW_SIDE / max(frame.width, frame.height), 1.0)
    width, height = (max(round(side * scale), 1) for side in (frame.width, frame.height))
    return frame.to_ndarray(width=width, height=height, format="gray").astype(np.float32) / 255.0


def _upright(frame: Any, aspect: float) -> np.ndarray:
    """uint8 sRGB [H, W, 3], with square pixels, turned as the film says."""
    picture = srgb_of(frame, round(frame.width * aspect) if 0.2 < aspect < 5 else frame.width)
    return np.ascontiguousarray(np.rot90(picture, round((frame.rotation or 0) / 90)))  # both count counter-clockwise


@contextmanager
def _opened(film: Path) -> Iterator[tuple[Any, Any]]:
    """The container, and the video stream that FFmpeg prefers of those that are not still pictures. UserError if there is none,
    or its codec is not supported."""
    require_source(film)
    found = container_of(film)
    assert found is not None
    with (
        film.open("rb") as file,
        av.open(file, "r", format=found.demuxer, options=OPTIONS, metadata_errors="replace") as container,
    ):
        cover = Disposition.attached_pic
        moving = [one for one in container.streams.video if one.frames != 1 and not one.disposition & cover]
        if not moving:
            raise UserError("there is no moving picture in this film", where=film)
        best = container.streams.best("video")
        stream: Any = best if best in moving else moving[0]
        codec = stream.codec_context
        if codec is None or not {codec.name, codec.codec.canonical_name} & set(CODECS):
            raise UserError("the film's codec is not supported", where=film, expected=", ".join(CODECS),
                            found="one that FFmpeg does not know" if codec is None else codec.name)  # fmt: skip
        codec.options = {"max_pixels": str(MOST_PIXELS)}
        stream.thread_type = "AUTO"
        yield container, stream


@contextmanager
def _readable_errors(film: Path) -> Iterator[None]:
    """FFmpeg's errors without their numbers."""
    try:
        yield
    except (FFmpegError, OSError) as error:
        # FFmpeg may ask for places before the begin of the file.
        if not isinstance(error, FFmpegError) and error.errno != errno.EINVAL:
            raise
        raise UserError("the film cannot be read", where=film, found=error.strerror,
                        remedy="it may be damaged: copy it again") from error  # fmt: skip
