"""Films and stills that are written while the window goes on.

An Export is stepped by the main thread (it needs OpenGL): each step renders tiles for a few milliseconds. Files are
written aside and renamed when they are whole; what is cancelled or fails leaves nothing behind.
"""

from __future__ import annotations

import contextlib
import importlib.util
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from console import UserError, not_written
from console.atomic import Replacement
from scenepack.pack import Pack
from viewer.features.film.pictures import EXR, Pass, write_exr, write_pngs
from viewer.rendering.camera import ViewCamera
from viewer.rendering.dynamic_resolution import tiles
from viewer.rendering.settings import RenderSettings, of_picture

MOST_FPS = 1000
THREADS = 8  # of the encoder, on any computer: what it writes depends on their number
FILMS: dict[str, tuple[str, str, dict[str, str]]] = {  # encoder, its pixels, and its options, by suffix
    ".mp4": ("libx264", "yuv420p", {"crf": "17", "preset": "medium"}),
    ".webp": ("libwebp_anim", "bgra", {"quality": "90"}),
    ".gif": ("gif", "pal8", {}),
}
ENDLESS = {"loop": "0"}  # of .webp and .gif


def require_video() -> None:
    """UserError, with the remedy, where PyAV is not installed."""
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise UserError("writing a film needs PyAV", remedy="pip install 'snerg[video]', or name a folder") from error


def films_possible() -> bool:
    return importlib.util.find_spec("av") is not None


class FilmWriter:
    """A film as H.264, or an animation that repeats as WebP or GIF, by the file's suffix; written aside until finish().

    UserError where PyAV is not installed, or a side of H.264 is odd. The same pictures give a film that shows the same, to the
    last bit; but of pictures of 48 x 32 pixels, the encoder of H.264 makes either of two films, given the very same frames.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: int) -> None:
        """size: width, height in pixels."""
        require_video()
        import av

        if min(size) < 2:
            raise UserError("a film needs at least 2 × 2 pixels", where=path)
        suffix = path.suffix.lower()
        codec, pixels, options = FILMS[suffix]
        if suffix == ".mp4" and (size[0] % 2 or size[1] % 2):
            raise UserError("H.264 needs an even width and height", where=path, found=f"{size[0]}x{size[1]}")
        self._av, self.aside = av, Replacement(path, alone=True)
        try:
            repeats = {} if suffix == ".mp4" else ENDLESS
            self._container = av.open(str(self.aside.path), "w", format=suffix[1:], options=repeats)
            self._stream: Any = self._container.add_stream(codec, rate=fps, options=options)
            self._palettes = self._palette_graph(size, fps) if suffix == ".gif" else None
        except BaseException:
            self.aside.discard()
            raise
        self._frames = 0
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = pixels
        self._stream.codec_context.thread_count = THREADS

    def _palette_graph(self, size: tuple[int, int], fps: int):
        """What gives each frame the 256 colours that suit it best; a regular dither, which does not flicker."""
        graph = self._av.filter.Graph()
        source = graph.add_buffer(width=size[0], height=size[1], format="rgb24", time_base=Fraction(1, fps))
        both, use = graph.add("split"), graph.add("paletteuse", "new=1:dither=bayer:bayer_scale=3")
        colours, sink = graph.add("palettegen", "stats_mode=single"), graph.add("buffersink")
        source.link_to(both)
        both.link_to(use, 0, 0)
        both.link_to(colours, 1, 0)
        colours.link_to(use, 0, 1)
        use.link_to(sink)
        graph.configure()
        return graph

    def add(self, picture: np.ndarray) -> None:
        """Appends a picture, uint8 [height, width, 3]."""
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        if self._palettes is not None:
            frame.pts, self._frames = self._frames, self._frames + 1
            self._palettes.vpush(frame)
            frame = self._palettes.vpull()
        self._container.mux(self._stream.encode(frame))

    def finish(self) -> None:
        """Completes the file and puts it in its place."""
        self._container.mux(self._stream.encode())
        self._container.close()
        self.aside.finish()
        self.aside.discard()

    def discard(self) -> None:
        with contextlib.suppress(Exception):  # e.g. the disk is full: it cannot write its end either
            self._container.close()
        self.aside.discard()


def write_film(path: Path, pictures: Iterable[np.ndarray], fps: int) -> None:
    """Encodes pictures (uint8 [h, w, 3], of one size), .mp4 without an odd last row or column; appears when it is whole."""
    step = 2 if path.suffix.lower() == ".mp4" else 1
    writer: FilmWriter | None = None
    try:
        for picture in pictures:
            height, width = (side // step * step for side in picture.shape[:2])
            if writer is None:
                writer = FilmWriter(path, (width, height), fps)
            writer.add(picture[:height, :width])
        if writer is not None:
            writer.finish()
    except BaseException:
        if writer is not None:
            writer.discard()
        raise


# --- Pictures and films written to disk while the window stays alive ---

Snapshot = Callable[[ViewCamera, RenderSettings], np.ndarray]
STILL_SUFFIX = ".png"
CENTRES = 256  # to a pixel, that principal points are rounded to: GPUs then hold them exactly, whatever a tile's corner


@dataclass(frozen=True)
class Layers:
    passes: list[Pass]  # of one view
    raw: Snapshot  # draws those with floats; see Canvas.raw
    pack: Pack  # what is drawn


@dataclass
class Export:
    """Pictures and films that are drawn and written bit by bit."""

    cameras: list[ViewCamera]  # one a frame
    settings: RenderSettings
    target: Path  # a .png or .exr (one frame), a film, or a folder for numbered PNGs
    snapshot: Snapshot
    fps: float = 30.0
    tile_side: int = 256  # pixels a side of what is rendered at once; it changes no pixel
    layers: Layers | None = None  # drawn of a view that is no film, instead of the picture of `settings`
    finish: Callable[[np.ndarray, ViewCamera], np.ndarray] | None = None  # draws over each whole picture of 8 bits
    put: Callable[[np.ndarray], None] | None = None  # takes the one picture, uint8 [h, w, 3], instead of a file

    def __post_init__(self) -> None:
        if not self.cameras:
            raise UserError("there is nothing to export", where=self.target)
        self.done_tiles = 0
        self.started = time.monotonic()
        self.finished = False
        self.cameras = [
            replace(camera, cx=round(CENTRES * camera.cx) / CENTRES, cy=round(CENTRES * camera.cy) / CENTRES)
            for camera in self.cameras
        ]
        width, height = self.cameras[0].width, self.cameras[0].height
        self._boxes = tiles(width, height, self.tile_side)
        self._passes = self.layers.passes if self.layers else [Pass("rgb", self.settings, False)]
        kinds = [(4, np.float32) if each.floats else (3, np.uint8) for each in self._passes]
        self._frames = [np.zeros((height, width, channels), kind) for channels, kind in kinds]
        self._sink: FilmWriter | _Sequence | None = None  # None: the pictures of one view, written once all are drawn

    @property
    def share(self) -> float:
        """0 … 1 of the work is done."""
        return self.done_tiles / (len(self._boxes) * len(self.cameras))

    @property
    def seconds_left(self) -> float | None:
        """An estimate; None while it is too early for one."""
        passed = time.monotonic() - self.started
        return passed * (1 / self.share - 1) if self.share > 0 and passed > 0.5 else None

    def step(self, seconds: float) -> None:
        """Works for about `seconds`. Raises UserError, after cleaning up, where the disk is full and the like."""
        end = time.monotonic() + seconds
        try:
            self._sink = self._sink or self._new_sink()
            while not self.finished:
                self._next_tile()
                if time.monotonic() >= end:
                    break
        except OSError as error:
            self.cancel()
            words, remedy = not_written(error)
            remedy = f"the unfinished file was removed; {remedy}, then export again"
            raise UserError(words, where=self.target, remedy=remedy) from error
        except BaseException:
            self.cancel()
            raise

    def _next_tile(self) -> None:
        frame, tile = divmod(self.done_tiles, len(self._boxes))
        camera = self.cameras[frame]
        x, y, w, h = self._boxes[tile]
        part = replace(camera, width=w, height=h, cx=camera.cx - x, cy=camera.cy - y)
        for each, pixels in zip(self._passes, self._frames, strict=True):
            draw = self.layers.raw if each.floats and self.layers else self.snapshot
            pixels[y : y + h, x : x + w] = draw(part, of_picture(each.settings, camera.height, camera.fy))
        self.done_tiles += 1
        if tile < len(self._boxes) - 1:
            return
        if self.finish is not None and not self._passes[0].floats:
            self._frames[0][...] = self.finish(self._frames[0], camera)
        if self._sink is not None:
            self._sink.add(self._frames[0])
        if self.done_tiles == len(self._boxes) * len(self.cameras):
            self._write_view() if self._sink is None else self._sink.finish()
            self.finished = True

    def cancel(self) -> None:
        if self._sink is not None and not self.finished:
            self._sink.discard()
        self.finished = True

    def _new_sink(self) -> FilmWriter | _Sequence | None:
        suffix, camera = self.target.suffix.lower(), self.cameras[0]
        if self.put is not None or self.layers is not None or suffix == STILL_SUFFIX:
            return None
        self.target.parent.mkdir(parents=True, exist_ok=True)
        if suffix in FILMS:
            return FilmWriter(self.target, (camera.width, camera.height), round(self.fps))
        return _Sequence(self.target)

    def _write_view(self) -> None:
        """The pictures of one view: to whoever takes them, a file for each, or one .exr."""
        if self.put is not None:
            self.put(self._frames[0].copy())
            return
        self.target.parent.mkdir(parents=True, exist_ok=True)
        if self.layers is not None and self.target.suffix.lower() == EXR:
            write_exr(self.target, self._passes, self._frames, self.cameras[0], self.layers.pack)
        else:
            write_pngs(self.target, self._passes, self._frames)


class _Sequence:
    def __init__(self, target: Path) -> None:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise UserError("is not empty", where=target, remedy="choose a new folder for the pictures")
        self.aside, self.count = Replacement(target, folder=True, alone=True), 0

    def add(self, picture: np.ndarray) -> None:
        Image.fromarray(picture).save(self.aside.path / f"frame_{self.count:05d}.png", compress_level=4)
        self.count += 1

    def finish(self) -> None:
        if self.aside.target.exists():
            self.aside.target.rmdir()  # refuses where something was put there since
        self.aside.finish()
        self.aside.discard()

    def discard(self) -> None:
        self.aside.discard()
