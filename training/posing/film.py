"""Frames of a film as photographs: the sharpest of each interval of time, upright. Runs in the child process.

A film is read by the one demuxer of its container and by one of CODECS, so that FFmpeg neither guesses at formats that lead to
other files or to the network, nor follows references out of the film.
"""

from __future__ import annotations

import errno
import itertools
import time
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from av.stream import Disposition
from PIL import Image

from console import UserError
from console.contents import HEAD_BYTES, told
from training.posing.film_colour import srgb_of, with_matrix
from training.posing.photograph import PREVIEW_SIDE, same_view, sharpness, thumbnail, write_picture
from training.scenes.sources import DEMUXERS, FILM_NAMES, container_of

CODECS = (
    "h264", "hevc", "vp8", "vp9", "av1", "mpeg4", "mjpeg", "prores", "dnxhd", "mpeg1video", "mpeg2video", "h263", "msmpeg4v2",
    "msmpeg4v3", "msmpeg4", "wmv1", "wmv2", "wmv3", "vc1", "flv", "flv1", "vp6", "vp6f", "theora", "dvvideo", "ffv1", "rawvideo",
)  # fmt: skip
OPTIONS = {"enable_drefs": "0", "protocol_whitelist": "none", "format_whitelist": DEMUXERS}
MOST_PIXELS = 1 << 26  # of a frame; 8K has half as many
GLIMPSED = 30  # frames whose decoding is timed
SOUGHT = 60  # frames that are decoded after a key frame, at most, to come to a place
PER_SECOND = 6.0  # frames at most: more show the same


@dataclass(frozen=True)
class Frame:
    """A frame that was kept."""

    name: str  # of its file
    size: tuple[int, int]  # (width, height) in pixels
    seconds: float  # into the film
    sharpness: float


@dataclass
class _Best:
    """The sharpest frame of an interval so far, as it was decoded."""

    interval: int
    seconds: float
    sharpness: float
    frame: Any
    aspect: float  # width by height of its pixels
    preview: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.frame.width, self.frame.height, self.frame.rotation or 0


def take_frames(film: Path, folder: Path, most: int, on_progress: Callable[[str, float, float], None]) -> list[Frame]:
    """Writes at most `most` frames into `folder`: of each interval the sharpest, none that shows the same as the one before.

    UserError where the file is no film that can be read.
    """
    with _readable_errors(film):
        times = _times(film)
        start, end = min(times), max(times)
        kept: list[Frame] = []

        def on_frame(seconds: float) -> None:
            on_progress("frames", seconds - start, max(end - start, 1e-3))

        for best in _differing(_sharpest(film, times, most, on_frame)):
            picture = _upright(best.frame, best.aspect)
            name = write_picture(Image.fromarray(picture), folder, f"frame_{len(kept) + 1:04d}", lossy=True)
            height, width = picture.shape[:2]
            kept.append(Frame(name, (width, height), round(best.seconds - start, 3), best.sharpness))
    return kept


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
    """When each frame is shown, in seconds, without decoding any."""
    with _opened(film) as (container, stream):
        base = float(stream.time_base)
        stamps = (packet.dts if packet.pts is None else packet.pts for packet in container.demux(stream))
        times = sorted({stamp * base for stamp in stamps if stamp is not None})
    if not times:
        raise UserError("the film has no frames", where=film)
    return times


def _sharpest(film: Path, times: Sequence[float], most: int, on_frame: Callable[[float], None]) -> Iterator[_Best]:
    """The sharpest frame of each interval, in their order."""
    best: _Best | None = None
    intervals = intervals_of(times, most)
    with _opened(film) as (container, stream):
        base, aspect = float(stream.time_base), float(stream.sample_aspect_ratio or 1)
        seconds = times[0]
        for frame in _decoded(film, container, stream):
            # Frames come in their order, but AVI does not say when those that were reordered are shown.
            seconds = seconds if frame.pts is None else max(frame.pts * base, seconds)
            interval = intervals[min(bisect_left(times, seconds), len(times) - 1)]
            on_frame(seconds)
            preview = _grey(frame)
            found = _Best(interval, seconds, sharpness(preview), frame, aspect, preview)
            if best is not None and best.interval != interval:
                yield best
                best = None
            if best is None or found.sharpness > best.sharpness:
                best = found
    if best is not None:
        yield best


def _differing(frames: Iterator[_Best]) -> Iterator[_Best]:
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
    with _demuxed(film) as container:
        index = _moving(container, film)
    with _demuxed(film) as container:  # anew: which one moves may have been asked of all its packets
        stream = container.streams[index]
        codec = stream.codec_context
        if codec is None or not {codec.name, codec.codec.canonical_name} & set(CODECS):
            raise UserError("the film's codec is not supported", where=film, expected=", ".join(CODECS),
                            found="one that FFmpeg does not know" if codec is None else codec.name)  # fmt: skip
        stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}
        stream.thread_type = "AUTO"
        yield container, stream


@contextmanager
def _demuxed(film: Path) -> Iterator[Any]:
    found = container_of(film)
    if found is None:
        with film.open("rb") as file:
            head = told(file.read(HEAD_BYTES))
        raise UserError("not a film that can be read", where=film, expected=FILM_NAMES, found=head)
    with (
        film.open("rb") as file,
        av.open(file, "r", format=found.demuxer, options=OPTIONS, metadata_errors="replace") as container,
    ):
        yield container


def _moving(container: Any, film: Path) -> int:
    """Index of the video stream that is the film: of those that are no still picture, a default one, and the largest.

    UserError where there is none.
    """
    streams = [stream for stream in container.streams.video if not stream.disposition & Disposition.attached_pic]
    if len(streams) > 1:  # headers rarely count frames
        packets = Counter(packet.stream_index for packet in container.demux(streams) if packet.size)
        streams = [stream for stream in streams if packets[stream.index] > 1]
    if not streams:
        raise UserError("there is no moving picture in this film", where=film)
    readable = [stream for stream in streams if stream.codec_context is not None] or streams[:1]
    if len(readable) > 1:
        readable.sort(key=lambda s: (bool(s.disposition & Disposition.default), s.width * s.height), reverse=True)
    return readable[0].index


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
