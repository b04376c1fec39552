"""MP4 films, where PyAV is installed (the extra `video`)."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from console import UserError
from console.atomic import Replacement

MOST_FPS = 1000
THREADS = 8  # of the encoder, on any computer: what it writes depends on their number


def require_video() -> None:
    """UserError, with the remedy, where PyAV is not installed."""
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise UserError("writing an .mp4 needs PyAV", remedy="pip install 'snerg[video]', or name a folder") from error


def films_possible() -> bool:
    """Whether PyAV is installed."""
    return importlib.util.find_spec("av") is not None


class FilmWriter:
    """An H.264 film, written aside until finish(). UserError where PyAV is not installed or a side is odd.

    The same pictures give a film that shows the same, to the last bit; but of pictures of 48 x 32 pixels, the encoder makes
    either of two films, given the very same frames.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: int) -> None:
        """size: width, height in pixels."""
        require_video()
        import av

        if min(size) < 2:
            raise UserError("a film needs at least 2 × 2 pixels", where=path)
        if size[0] % 2 or size[1] % 2:
            raise UserError("H.264 needs an even width and height", where=path, found=f"{size[0]}x{size[1]}")
        self._av, self.aside = av, Replacement(path, alone=True)
        try:
            self._container = av.open(str(self.aside.path), "w", format="mp4")
            self._stream = self._container.add_stream("libx264", rate=fps, options={"crf": "17", "preset": "medium"})
        except BaseException:
            self.aside.discard()
            raise
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.thread_count = THREADS

    def add(self, picture: np.ndarray) -> None:
        """Appends a picture, uint8 [height, width, 3]."""
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def finish(self) -> None:
        """Completes the file and puts it in its place."""
        self._container.mux(self._stream.encode())
        self._container.close()
        self.aside.finish()
        self.aside.discard()

    def discard(self) -> None:
        """Leaves nothing behind."""
        with contextlib.suppress(Exception):  # e.g. the disk is full: it cannot write its end either
            self._container.close()
        self.aside.discard()


def write_film(path: Path, pictures: Iterable[np.ndarray], fps: int) -> None:
    """Encodes pictures (uint8 [h, w, 3], all of one size); an odd last row or column is cut off.

    The file appears when it is complete; without pictures there is none.
    """
    writer: FilmWriter | None = None
    try:
        for picture in pictures:
            height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
            if writer is None:
                writer = FilmWriter(path, (width, height), fps)
            writer.add(picture[:height, :width])
        if writer is not None:
            writer.finish()
    except BaseException:
        if writer is not None:
            writer.discard()
        raise
