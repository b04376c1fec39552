"""Stills and films as files: PNG (8 bit, straight alpha), OpenEXR (float32, premultiplied), H.264, WebP and GIF.

One view may be shown in several modes. As PNG each mode is a file of its own; one OpenEXR file holds all of them as channels.
Files are written aside and renamed when they are whole; what is cancelled or fails leaves nothing behind.
"""

import importlib.util
import json
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, count
from pathlib import Path
from typing import Any, cast

import numpy as np
import OpenImageIO as oiio
from PIL import Image

from console import UserError, not_written
from console.atomic import replacing
from scenepack.pack import Pack
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.dynamic_resolution import tiles
from viewer.rendering.layers import depth_along_axis, linear_rgb, straight_rgba, unit_normals
from viewer.rendering.renderer import COST_MODES, MODES_OVER_BACKGROUND
from viewer.rendering.settings import MODES, Mode, RenderSettings

PICTURE = "rgb"  # what the mode `normal` is called in lists and file names
EXR, PNG = ".exr", ".png"
VIEWS = (EXR, PNG)  # files of one view
DEPTH_MEANS = "z-depth: distance along the optical axis, in units of the grid frame; 0 where there is nothing"
DISTANCE_MEANS = "distance from the camera, in units of the grid frame; 0 where there is nothing"
NORMALS_MEAN = "unit vectors in the grid frame (y up), away from the surface; 0 where there is nothing"


@dataclass(frozen=True)
class Pass:
    """One drawing of a view. name: of the mode, rgb for the picture. floats: four float32 a pixel, else RGB of 8 bits."""

    name: str
    settings: RenderSettings
    floats: bool


def parse_modes(text: str) -> tuple[Mode, ...]:
    """Display modes named with commas between; rgb is the picture, and beside it `normal` is normals. UserError for others."""
    words = [word.strip() for word in text.split(",")]
    if PICTURE in words:
        words = ["normals" if word == "normal" else word for word in words]
    modes = ["normal" if word == PICTURE else word for word in words]
    for mode, word in zip(modes, words, strict=True):
        if mode not in MODES:
            expected = ", ".join((PICTURE, *MODES[1:]))
            raise UserError("is no display mode", where="--mode", expected=expected, found=repr(word))
    if len(set(modes)) < len(modes):
        raise UserError("names a mode twice", where="--mode", found=repr(text))
    return cast("tuple[Mode, ...]", tuple(modes))


def passes_for(
    modes: Sequence[Mode], settings: RenderSettings, *, transparent: bool = False, exr: bool = False
) -> list[Pass]:
    """What must be drawn. settings: all else that counts; exr: for an OpenEXR file.

    transparent: without the background, whose colour still goes into the view MLP. An OpenEXR file that holds opacity holds
    colours without background as well, as the format means it.
    """
    transparent = transparent or (exr and "alpha" in modes)
    passes = []
    for mode in modes:
        of_mode, name = replace(settings, mode=mode), PICTURE if mode == "normal" else mode
        over = mode in MODES_OVER_BACKGROUND
        if (transparent and over) or (exr and not over):
            samples = 1 if mode in COST_MODES else settings.samples  # whole numbers
            passes.append(Pass(name, replace(of_mode, raw=True, samples=samples), True))
        else:
            passes.append(Pass(name, of_mode, exr))
    return passes


def write_pngs(path: Path, passes: Sequence[Pass], pictures: Sequence[np.ndarray]) -> list[Path]:
    """Writes pictures, uint8 [h, w, 3] or raw (rendering.layers): one to `path`, several as NAME_MODE.png. Returns the files."""
    written = []
    for each, pixels in zip(passes, pictures, strict=True):
        file = path if len(passes) == 1 else path.with_name(f"{path.stem}_{each.name}{path.suffix or PNG}")
        with replacing(file) as new:
            picture = straight_rgba(pixels) if pixels.dtype == np.float32 else pixels
            Image.fromarray(picture).save(new, format="PNG")
        written.append(file)
    return written


def write_exr(
    file: Path, passes: Sequence[Pass], pictures: Sequence[np.ndarray], camera: ViewCamera, pack: Pack
) -> None:
    """Writes what was drawn into one OpenEXR file, float32, ZIP.

    Channels: R, G, B (linear light, times opacity), A, Z, N.X, N.Y, N.Z; other modes as MODE.R, MODE.G, MODE.B, and the costs as
    `samples` and `jumps`. The header's `snerg` says what they mean, with the camera, as JSON.
    """
    channels = {
        name: values
        for each, pixels in zip(passes, pictures, strict=True)
        for name, values in _exr_channels(each, pixels, camera, pack).items()
    }
    picture = np.stack(list(channels.values()), axis=-1, dtype=np.float32)
    header = oiio.ImageSpec(picture.shape[1], picture.shape[0], len(channels), oiio.FLOAT)
    header.channelnames = tuple(channels)
    header.attribute("compression", "zip")
    header.attribute("snerg", json.dumps(_description(passes, camera)))
    row_vectors = np.linalg.inv(camera.grid_T_camera).T  # OpenEXR's matrices act on these
    header.attribute("worldtocamera", oiio.TypeMatrix, tuple(map(float, row_vectors.ravel())))
    with replacing(file) as new:
        output = oiio.ImageOutput.create("openexr")
        if output is None or not (output.open(str(new), header) and output.write_image(picture) and output.close()):
            raise OSError(f"{new}: {output.geterror() if output else oiio.geterror()}")


def _exr_channels(each: Pass, pixels: np.ndarray, camera: ViewCamera, pack: Pack) -> Mapping[str, np.ndarray]:
    """Channels [h, w] by name of one pass; pixels: float32 [h, w, 4]."""
    if each.name in COST_MODES:
        return {each.name: pixels[..., COST_MODES.index(each.name)]}
    if each.name == "alpha":
        return {"A": pixels[..., 3]}
    if each.name == "depth":
        return {"Z": depth_along_axis(pixels, camera, pack)}
    if each.name == "normals":
        normals = unit_normals(pixels)
        return {f"N.{axis}": normals[..., i] for i, axis in enumerate("XYZ")}
    values = linear_rgb(pixels) if each.name in (PICTURE, "diffuse") else pixels[..., :3]
    prefix = "" if each.name == PICTURE else f"{each.name}."
    channels = {f"{prefix}{name}": values[..., i] for i, name in enumerate("RGB")}
    return channels | ({"A": pixels[..., 3]} if each.name == PICTURE and each.settings.raw else {})


def _description(passes: Sequence[Pass], camera: ViewCamera) -> dict[str, object]:
    described: dict[str, object] = {
        "grid_T_camera": camera.grid_T_camera.tolist(),
        **{name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")},
    }
    names = {each.name for each in passes}
    described |= {"Z": DISTANCE_MEANS if camera.is_panorama else DEPTH_MEANS} if "depth" in names else {}
    described |= {"N": NORMALS_MEAN} if "normals" in names else {}
    if PICTURE in names:
        background = next(each.settings for each in passes if each.name == PICTURE)
        over = "without background, times A" if background.raw else f"over the background {list(background.background)}"
        described["RGB"] = f"linear light, decoded from sRGB; {over}"
    return described


# --- Films ---

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
    graph.link_nodes(source, both, use, sink)
    both.link_to(colours, 1)
    colours.link_to(use, 0, 1)
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


# --- An export, a step at a time, so that the window still answers ---

CENTRES = 256  # to a pixel, that principal points are rounded to: GPUs then hold them exactly, whatever a tile's corner


@dataclass
class Export:
    """The main thread steps it, as it needs OpenGL: each step draws tiles for a few milliseconds."""

    cameras: list[ViewCamera]  # one a frame
    passes: list[Pass]  # what is drawn of each; of a film or a sequence, one of 8 bits
    target: Path  # a .png or .exr (one frame), a film, or a folder for numbered PNGs
    canvas: Canvas
    pack: Pack  # what is drawn
    fps: float = 30.0
    tile_side: int = 256  # pixels a side of what is rendered at once; it changes no pixel
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
        width, height = self.cameras[0].width, self.cameras[0].height
        kinds = [(4, np.float32) if each.floats else (3, np.uint8) for each in self.passes]
        pictures = [np.zeros((height, width, channels), kind) for channels, kind in kinds]
        boxes = tiles(width, height, self.tile_side)
        with self._writer() as add:
            for number, camera in enumerate(self.cameras):
                for tile, (x, y, w, h) in enumerate(boxes, 1):
                    for each, pixels in zip(self.passes, pictures, strict=True):
                        draw = self.canvas.raw if each.floats else self.canvas.snapshot
                        pixels[y : y + h, x : x + w] = draw(camera.part(x, y, w, h), each.settings)
                    self.share = (number + tile / len(boxes)) / len(self.cameras)
                    yield
                if self.finish is not None and not self.passes[0].floats:
                    pictures[0][...] = self.finish(pictures[0], camera)
                add(*pictures)

    def _writer(self) -> AbstractContextManager[Callable[..., object]]:
        """What takes the pictures of each camera: of a film, a sequence, or one view."""
        suffix, camera = self.target.suffix.lower(), self.cameras[0]
        if self.put is not None or suffix in VIEWS:
            return nullcontext(self.put or self._write_view)
        self.target.parent.mkdir(parents=True, exist_ok=True)
        if suffix in FILMS:
            return film_writer(self.target, (camera.width, camera.height), round(self.fps))
        return sequence_writer(self.target)

    def _write_view(self, *pictures: np.ndarray) -> None:
        self.target.parent.mkdir(parents=True, exist_ok=True)  # not before: cancelled, it leaves nothing
        if self.target.suffix.lower() == EXR:
            write_exr(self.target, self.passes, pictures, self.cameras[0], self.pack)
        else:
            write_pngs(self.target, self.passes, pictures)
