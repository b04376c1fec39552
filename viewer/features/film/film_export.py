"""Films and stills that are written while the window goes on.

An Export is stepped by the main thread (it needs OpenGL): each step renders tiles for a few milliseconds. Files are
written aside and renamed when they are whole; what is cancelled or fails leaves nothing behind.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from console import UserError, not_written
from console.atomic import replacing
from scenepack.pack import Pack
from viewer.features.film.pictures import EXR, PICTURE, PNG, Pass, write_exr, write_pngs
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.dynamic_resolution import tiles
from viewer.rendering.settings import RenderSettings, of_picture

MOST_FPS = 1000
THREADS = 8  # of the encoder, on any computer: what it writes depends on their number
FILMS: dict[str, tuple[str, str, dict[str, str]]] = {  # encoder, its pixels, and its options, by suffix
    ".mp4": ("libx264", "yuv420p", {"crf": "17", "preset": "medium"}),
    ".webp": ("libwebp_anim", "bgra", {"quality": "90"}),
    ".gif": ("gif", "pal8", {}),
}


def require_video() -> None:
    """UserError, with the remedy, where PyAV is not installed."""
    if not films_possible():
        raise UserError("writing a film needs PyAV", remedy="pip install 'snerg[video]', or name a folder")


def films_possible() -> bool:
    return importlib.util.find_spec("av") is not None


Add = Callable[[np.ndarray], None]  # takes a picture, uint8 [height, width, 3]


@contextmanager
def film_writer(path: Path, size: tuple[int, int], fps: int) -> Iterator[Add]:
    """A film as H.264, or an animation that repeats as WebP or GIF, by the file's suffix. size: width, height in pixels.

    UserError where PyAV is not installed, or a side of H.264 is odd. Given the very same frames, the encoder of H.264 makes
    films that differ a little from one run to the next.
    """
    require_video()
    import av

    if min(size) < 2:
        raise UserError("a film needs at least 2 × 2 pixels", where=path)
    suffix = path.suffix.lower()
    codec, pixels, options = FILMS[suffix]
    if suffix == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise UserError("H.264 needs an even width and height", where=path, found=f"{size[0]}x{size[1]}")
    with replacing(path, alone=True) as aside:
        endless = {} if suffix == ".mp4" else {"loop": "0"}
        container = av.open(str(aside), "w", format=suffix[1:], options=endless)
        stream: Any = container.add_stream(codec, rate=fps, options=options)
        stream.width, stream.height = size
        stream.pix_fmt = pixels
        stream.codec_context.thread_count = THREADS
        palettes, numbers = _palette_graph(size, fps) if suffix == ".gif" else None, count()

        def add(picture: np.ndarray) -> None:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            if palettes is not None:
                frame.pts = next(numbers)
                palettes.vpush(frame)
                frame = palettes.vpull()
            container.mux(stream.encode(frame))

        try:
            yield add
            container.mux(stream.encode())
        except BaseException:
            with suppress(Exception):  # e.g. the disk is full: it cannot write its end either
                container.close()
            raise
        container.close()


def _palette_graph(size: tuple[int, int], fps: int):
    """What gives each frame the 256 colours that suit it best; a regular dither, which does not flicker."""
    from av.filter import Graph

    graph = Graph()
    frame_format: Any = "rgb24"  # a name, where the types of PyAV ask for its object
    source = graph.add_buffer(width=size[0], height=size[1], format=frame_format, time_base=Fraction(1, fps))
    both, use = graph.add("split"), graph.add("paletteuse", "new=1:dither=bayer:bayer_scale=3")
    colours, sink = graph.add("palettegen", "stats_mode=single"), graph.add("buffersink")
    source.link_to(both)
    both.link_to(use, 0, 0)
    both.link_to(colours, 1, 0)
    colours.link_to(use, 0, 1)
    use.link_to(sink)
    graph.configure()
    return graph


def write_film(path: Path, pictures: Iterable[np.ndarray], fps: int) -> None:
    """Encodes pictures (uint8 [h, w, 3], of one size), .mp4 without an odd last row or column; appears when it is whole."""
    step, pictures = 2 if path.suffix.lower() == ".mp4" else 1, iter(pictures)
    first = next(pictures)
    height, width = (side // step * step for side in first.shape[:2])
    with film_writer(path, (width, height), fps) as add:
        for picture in chain([first], pictures):
            add(picture[:height, :width])


@contextmanager
def sequence_writer(target: Path) -> Iterator[Add]:
    """Numbered PNGs in a new folder. UserError where there is something in it."""
    target = target.resolve()
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise UserError("is not empty", where=target, remedy="choose a new folder for the pictures")
    with replacing(target, folder=True, alone=True) as aside:
        numbers = count()
        yield lambda picture: Image.fromarray(picture).save(aside / f"frame_{next(numbers):05d}.png", compress_level=4)
        if target.exists():
            target.rmdir()  # refuses where something was put there since


# --- Pictures and films written to disk while the window stays alive ---

CENTRES = 256  # to a pixel, that principal points are rounded to: GPUs then hold them exactly, whatever a tile's corner


@dataclass
class Export:
    cameras: list[ViewCamera]  # one a frame
    settings: RenderSettings
    target: Path  # a .png or .exr (one frame), a film, or a folder for numbered PNGs
    canvas: Canvas
    pack: Pack  # what is drawn
    fps: float = 30.0
    tile_side: int = 256  # pixels a side of what is rendered at once; it changes no pixel
    passes: list[Pass] | None = None  # of a view that is no film, instead of the picture of `settings`
    finish: Callable[[np.ndarray, ViewCamera], np.ndarray] | None = None  # draws over each whole picture of 8 bits
    put: Add | None = None  # takes the one picture, instead of a file

    def __post_init__(self) -> None:
        self.share = 0.0  # 0 … 1 of the work is done
        self.started = time.monotonic()
        self.finished = False
        self.cameras = [
            replace(camera, cx=round(CENTRES * camera.cx) / CENTRES, cy=round(CENTRES * camera.cy) / CENTRES)
            for camera in self.cameras
        ]
        self._tiles = self._draw()

    @property
    def seconds_left(self) -> float | None:
        """An estimate; None while it is too early for one."""
        passed = time.monotonic() - self.started
        return passed * (1 / self.share - 1) if self.share > 0 and passed > 0.5 else None

    def step(self, seconds: float) -> None:
        """Works for about `seconds`. Raises UserError, after cleaning up, where the disk is full and the like."""
        end = time.monotonic() + seconds
        try:
            for _ in self._tiles:
                if time.monotonic() >= end:
                    return
            self.finished = True
        except OSError as error:
            words, remedy = not_written(error)
            remedy = f"the unfinished file was removed; {remedy}, then export again"
            raise UserError(words, where=self.target, remedy=remedy) from error

    def cancel(self) -> None:
        self._tiles.close()

    def _draw(self) -> Generator[None, None, None]:
        """Draws a tile at a time, and writes each picture that is whole."""
        passes = self.passes or [Pass(PICTURE, self.settings, False)]
        width, height = self.cameras[0].width, self.cameras[0].height
        kinds = [(4, np.float32) if each.floats else (3, np.uint8) for each in passes]
        pictures = [np.zeros((height, width, channels), kind) for channels, kind in kinds]
        boxes = tiles(width, height, self.tile_side)
        with self._writer(passes) as add:
            for number, camera in enumerate(self.cameras):
                for tile, (x, y, w, h) in enumerate(boxes, 1):
                    part = replace(camera, width=w, height=h, cx=camera.cx - x, cy=camera.cy - y)
                    for each, pixels in zip(passes, pictures, strict=True):
                        draw = self.canvas.raw if each.floats else self.canvas.snapshot
                        pixels[y : y + h, x : x + w] = draw(part, of_picture(each.settings, height, camera.fy))
                    self.share = (number + tile / len(boxes)) / len(self.cameras)
                    yield
                if self.finish is not None and not passes[0].floats:
                    pictures[0][...] = self.finish(pictures[0], camera)
                add(*pictures)

    def _writer(self, passes: list[Pass]) -> AbstractContextManager[Callable[..., object]]:
        """What takes the pictures of each camera: of a film, a sequence, or one view."""
        suffix, camera = self.target.suffix.lower(), self.cameras[0]

        def write_view(*pictures: np.ndarray) -> None:
            self.target.parent.mkdir(parents=True, exist_ok=True)  # not before: cancelled, it leaves nothing
            if self.passes is not None and suffix == EXR:
                write_exr(self.target, passes, pictures, camera, self.pack)
            else:
                write_pngs(self.target, passes, pictures)

        if self.put is not None or self.passes is not None or suffix == PNG:
            return nullcontext(self.put or write_view)
        self.target.parent.mkdir(parents=True, exist_ok=True)
        if suffix in FILMS:
            return film_writer(self.target, (camera.width, camera.height), round(self.fps))
        return sequence_writer(self.target)
