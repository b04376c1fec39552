"""Frames of a film as photographs: the sharpest of each interval of time, upright. Runs in the child process.

A film is read from its bytes by the one reader of its container (MP4 and MOV, or WebM and Matroska) and by one of CODECS. So
FFmpeg neither guesses at formats that lead to other files or to the network, nor follows references out of the film.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from PIL import Image

from console import UserError
from console.contents import HEAD_BYTES, told
from training.posing.camera_files import PREVIEW_SIDE, write_picture
from training.posing.choice import same_view, sharpness, thumbnail
from training.scenes.sources import container_of

CODECS = ("h264", "hevc", "vp8", "vp9", "av1", "mpeg4", "mjpeg", "prores")
OPTIONS = {"enable_drefs": "0", "protocol_whitelist": "none", "format_whitelist": "mov,mp4,matroska,webm"}
MOST_PIXELS = 1 << 26  # of a frame; 8K has half as many
GLIMPSED = 30  # frames whose decoding is timed
SOUGHT = 60  # frames that are decoded after a key frame, at most, to come to a place
PER_SECOND = 6.0  # frames at most: more show the same


@dataclass(frozen=True)
class Frame:
    """A frame that was kept. name: of its file. size: (width, height) in pixels. seconds: into the film.

    sharpness: see training.posing.choice.
    """

    name: str
    size: tuple[int, int]
    seconds: float
    sharpness: float


@dataclass
class _Best:
    """The sharpest frame of an interval so far."""

    interval: int
    seconds: float
    sharpness: float
    picture: np.ndarray
    preview: np.ndarray


def take_frames(film: Path, folder: Path, most: int, tell: Callable[[str, float, float], None]) -> list[Frame]:
    """Writes at most `most` frames into `folder`: of each interval the sharpest, none that shows the same as the one before.

    UserError where the file is no film that can be read.
    """
    with _told_plainly(film):
        times = _times(film)
        intervals = intervals_of(times, most)
        start, end = min(times), max(times)
        kept: list[Frame] = []
        for best in _differing(
            _sharpest(
                film,
                dict(zip(times, intervals, strict=True)),
                lambda seconds: tell("frames", seconds - start, max(end - start, 1e-3)),
            )
        ):
            name = write_picture(Image.fromarray(best.picture), folder, f"frame_{len(kept) + 1:04d}", lossy=True)
            height, width = best.picture.shape[:2]
            kept.append(Frame(name, (width, height), round(best.seconds - start, 3), best.sharpness))
    return kept


def glimpse(
    film: Path, most: int, some: int, count: Callable[[int], None], show: Callable[[int, float, Image.Image], None]
) -> tuple[int, float]:
    """A look at a film without decoding all of it: how many frames take_frames would keep at most, and an estimate of its
    seconds, from GLIMPSED frames. count: told the first, at once. show: gets `some` frames, evenly spaced: number, seconds
    into the film, picture. UserError as take_frames.
    """
    with _told_plainly(film):
        times = _times(film)
        frames = max(intervals_of(times, most)) + 1
        count(frames)
        started, decoded = time.monotonic(), 0
        with _opened(film) as (container, stream):
            for frame in itertools.islice(container.decode(stream), GLIMPSED):
                sharpness(_grey(frame))
                decoded += 1
        seconds = (time.monotonic() - started) / max(decoded, 1) * len(times)
        with _opened(film) as (container, stream):
            base, aspect, shown = float(stream.time_base), float(stream.sample_aspect_ratio or 1), -1
            for number, at in enumerate(np.linspace(times[0], times[-1], some + 1)[:-1]):
                container.seek(int(at / base), stream=stream)  # to the key frame before
                frame = None
                for frame in itertools.islice(container.decode(stream), SOUGHT):
                    if frame.pts is not None and frame.pts * base >= at:
                        break
                if frame is not None and frame.pts is not None and frame.pts > shown:
                    shown = frame.pts
                    show(number, shown * base - times[0], Image.fromarray(_upright(frame, aspect)))
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
        return sorted(
            {packet.pts * base for packet in container.demux(stream) if packet.pts is not None}
        ) or _no_frames(film)


def _sharpest(film: Path, interval_at: dict[float, int], tell: Callable[[float], None]) -> Iterator[_Best]:
    """The sharpest frame of each interval, in their order."""
    best: _Best | None = None
    with _opened(film) as (container, stream):
        base, aspect = float(stream.time_base), float(stream.sample_aspect_ratio or 1)
        for frame in container.decode(stream):
            seconds = None if frame.pts is None else frame.pts * base
            if seconds is None or seconds not in interval_at:
                continue
            interval = interval_at[seconds]
            if best is not None and interval != best.interval:
                yield best
                best = None
            tell(seconds)
            preview = _grey(frame)
            value = sharpness(preview)
            if best is None or value > best.sharpness:
                best = _Best(interval, seconds, value, _upright(frame, aspect), preview)
    if best is not None:
        yield best


def _differing(frames: Iterator[_Best]) -> Iterator[_Best]:
    """Of frames in a row that show the same, since the camera rests, the sharpest; none of another size than the first."""
    before: _Best | None = None
    for frame in frames:
        if before is None:
            before = frame
        elif frame.picture.shape != before.picture.shape:
            continue
        elif not same_view(thumbnail(frame.preview), thumbnail(before.preview)):
            yield before
            before = frame
        elif frame.sharpness > before.sharpness:
            before = frame
    if before is not None:
        yield before


def _grey(frame: Any) -> np.ndarray:
    scale = min(PREVIEW_SIDE / max(frame.width, frame.height), 1.0)
    width, height = (max(round(side * scale), 1) for side in (frame.width, frame.height))
    return frame.to_ndarray(width=width, height=height, format="gray").astype(np.float32) / 255.0


def _upright(frame: Any, aspect: float) -> np.ndarray:
    """uint8 [H, W, 3], with square pixels, turned as the film says."""
    width = round(frame.width * aspect) if 0.2 < aspect < 5 else frame.width
    picture = frame.to_ndarray(width=width, height=frame.height, format="rgb24")
    return np.ascontiguousarray(np.rot90(picture, round((frame.rotation or 0) / 90)))  # both count counter-clockwise


@contextmanager
def _opened(film: Path) -> Iterator[tuple[Any, Any]]:
    container_format = container_of(film)
    if container_format is None:
        with film.open("rb") as file:
            found = told(file.read(HEAD_BYTES))
        raise UserError("not a film that can be read", where=film, expected="MP4, MOV, WebM or Matroska", found=found)
    with (
        film.open("rb") as file,
        av.open(file, "r", format=container_format, options=OPTIONS, metadata_errors="replace") as container,
    ):
        streams = container.streams.video
        if not streams:
            raise UserError("there is no picture in this film", where=film)
        stream = streams[0]
        if stream.codec_context.name not in CODECS and stream.codec_context.codec.canonical_name not in CODECS:
            raise UserError("the film's codec is not supported", where=film, expected=", ".join(CODECS),
                            found=stream.codec_context.name)  # fmt: skip
        stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}
        stream.thread_type = "AUTO"
        yield container, stream


@contextmanager
def _told_plainly(film: Path) -> Iterator[None]:
    """FFmpeg's errors without their numbers."""
    try:
        yield
    except FFmpegError as error:
        raise UserError("the film cannot be read", where=film, found=error.strerror,
                        remedy="it may be damaged: copy it again") from error  # fmt: skip


def _no_frames(film: Path) -> list[float]:
    raise UserError("the film has no frames", where=film)
