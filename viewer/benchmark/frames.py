"""How long frames take along a camera path, as the paper measures them (SNeRG paper, appendix B), or drawn without a pause; the
GPU's power; how far pictures differ.

Several ways to draw a pack, or several packs, are drawn frame by frame in turn, so that whatever else the machine does
slows all of them alike. The clock is a GPU timer query where those can be trusted, and wall time around a finish() on
software rasterisers, where they cannot.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError, progress
from scenepack.pack import Pack
from training.scenes import Scene, load_scene
from training.scenes.pictures import over_background
from training.scenes.scene_options import recorded_options
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.opengl import GpuClock
from viewer.rendering.settings import RenderSettings
from viewer.rendering.software_rasteriser import is_software

WARM_UP_FRAMES = 3


@dataclass
class Contender:
    """A way to draw, and what was measured of it."""

    name: str
    settings: RenderSettings
    pack: Pack  # what it draws
    ms: list[float] = field(default_factory=list)  # that each frame took
    gpu_bytes: int = 0  # of its textures
    psnr: float = nan  # against the first contender, where that draws the same pack, dB; infinite where equal
    photographs_psnr: float | None = None  # dB, the mean over views; None where there are no photographs

    def statistics(self) -> dict[str, float]:
        """Mean, standard deviation, percentiles (ms), frames per second of the mean, and bytes of textures."""
        times = np.asarray(self.ms)
        percentiles = {f"ms_p{share}": float(np.percentile(times, share)) for share in (50, 95, 99)}
        mean = float(times.mean())
        spread = {"ms_mean": mean, "ms_std": float(times.std()), **percentiles}
        return {**spread, "fps": 1000.0 / mean, "gpu_bytes": self.gpu_bytes}

    def ratio_to(self, first: Contender) -> dict[str, float]:
        """How many times `first`'s frame time ours is: of the medians, and between which most pairs of frames lie."""
        pairs = np.asarray(self.ms) / np.asarray(first.ms)
        low, high = np.percentile(pairs, (5, 95)).tolist()
        return {"ratio": float(np.median(self.ms) / np.median(first.ms)), "ratio_p5": low, "ratio_p95": high}


class Turns:
    """Contenders that draw in turn, in one context. Cameras are in the grid frame of the first one's pack. drawn_by: by name."""

    def __init__(self, contenders: Sequence[Contender], drawn_by: Mapping[str, OffscreenRenderer]) -> None:
        self.contenders, self.drawn_by = contenders, drawn_by
        self.offscreen = drawn_by[contenders[0].name]
        self.device = str(self.offscreen.ctx.info["GL_RENDERER"])
        self.clock = "wall time around finish()" if is_software(self.device) else "GPU timer queries"

    def _drawing(self, contender: Contender, camera: ViewCamera) -> Callable[[], None]:
        """Draws a camera with a contender, in the grid frame of the pack that it draws."""
        framebuffer = self.offscreen.framebuffer(camera.width, camera.height)
        view = same_view(camera, self.contenders[0].pack, contender.pack)
        return lambda: self.drawn_by[contender.name].renderer.render(framebuffer, view, contender.settings)

    def warm_up(self, camera: ViewCamera) -> None:
        """Draws `camera` a few times with each contender, so that shaders are compiled and clocks are up."""
        for contender in self.contenders:
            draw = self._drawing(contender, camera)
            for _ in range(WARM_UP_FRAMES):
                draw()
                self.offscreen.ctx.finish()

    def time(self, cameras: Sequence[ViewCamera]) -> None:
        """Draws every camera, all of one size, with every contender in turn, and notes times and memory with each."""
        clock = GpuClock(self.offscreen.ctx)
        with progress("measuring", len(cameras)) as bar:
            for camera in cameras:
                for contender in self.contenders:
                    draw = self._drawing(contender, camera)
                    self.offscreen.ctx.finish()
                    gpu, wall = clock.time(draw)
                    contender.ms.append(wall if gpu is None else gpu)
                bar.advance()
        for contender in self.contenders:
            contender.gpu_bytes = self.drawn_by[contender.name].renderer.gpu_bytes(contender.settings.marcher)


def same_view(camera: ViewCamera, pack: Pack, other: Pack) -> ViewCamera:
    """A camera in the grid frame of `pack` as one in that of `other`; both packs were trained in one frame."""
    if np.array_equal(pack.worldspace_T_opengl, other.worldspace_T_opengl):
        return camera
    other_T_pack = np.linalg.inv(other.worldspace_T_opengl) @ pack.worldspace_T_opengl
    return replace(camera, grid_T_camera=other_T_pack @ camera.grid_T_camera)


@contextmanager
def taking_turns(contenders: Sequence[Contender], *, allow_half: bool = False) -> Iterator[Turns]:
    """Opens the packs of contenders in one context. Contenders of one pack share its textures.

    UserError where there is no OpenGL or a pack does not fit, unless half its resolution does and is allowed.
    """
    with ExitStack() as stack:
        opened: dict[int, OffscreenRenderer] = {}
        ctx = None
        for contender in contenders:
            if id(contender.pack) not in opened:
                offscreen = OffscreenRenderer(contender.pack, contender.settings.marcher, ctx, allow_half=allow_half)
                opened[id(contender.pack)] = stack.enter_context(offscreen)
                ctx = offscreen.ctx
        yield Turns(contenders, {c.name: opened[id(c.pack)] for c in contenders})


# --- The GPU's power ---

EVERY_S = 0.05


@contextmanager
def power_readings(renderer: str) -> Iterator[list[float]]:
    """Yields a list, to which the GPU's power (W) is added again and again while the block runs; empty where it is unknown.

    renderer: GL_RENDERER; on a software rasteriser no card is asked.
    """
    readings: list[float] = []
    ended = threading.Event()

    def watch(read: Callable[[], float]) -> None:
        while not ended.wait(EVERY_S):
            with suppress(Exception):  # one reading less
                readings.append(read() / 1000.0)

    if "nvidia" in renderer.lower():
        with suppress(Exception):  # no package, no driver, or a GPU that does not tell: each has errors of its own
            import pynvml  # pyright: ignore[reportMissingImports]

            pynvml.nvmlInit()
            read = partial(pynvml.nvmlDeviceGetPowerUsage, pynvml.nvmlDeviceGetHandleByIndex(0))  # milliwatts
            read()
            threading.Thread(target=watch, args=(read,), daemon=True).start()
    try:
        yield readings
    finally:
        ended.set()


def mean_watts(readings: list[float]) -> float | None:
    """Of power_readings; None where there are none."""
    return float(np.mean(readings)) if readings else None


# --- What snerg-bench measures ---

PSNR_FRAMES = 8  # compared between two marchers, spread over the path


def photographed_scene(pack: Pack, scene: Path, split: str, downscale: int) -> Scene:
    """Reads `scene` as the maker of `pack` read it. UserError where the split has no photographs."""
    read = load_scene(scene, downscale=downscale, **recorded_options(pack.metadata.get("provenance")))
    if not read.splits.get(split):
        names = ", ".join(name for name, some in read.splits.items() if some)
        raise UserError("has no such photographs", where=scene, expected=f"--split {names}", found=split)
    return read


@dataclass(frozen=True)
class Measurement:
    renderer: str
    clock: str  # what measured the times
    contenders: list[Contender]  # in the order given
    watts: float | None  # None where unknown
    grid_size: tuple[int, int, int]  # voxels (x, y, z) of the pack as it was drawn


def measure(
    cameras: Sequence[ViewCamera],
    contenders: list[Contender],
    *,
    scene: Scene | None = None,
    split: str = "test",
    allow_half: bool = False,
) -> Measurement:
    """Draws every camera, in the grid frame of the first contender's pack, with every contender in turn.

    UserError where there is no OpenGL or a pack does not fit.
    scene, split: photographs to compare with. allow_half: a pack that does not fit is measured at half its resolution.
    """
    with taking_turns(contenders, allow_half=allow_half) as turns:
        turns.warm_up(cameras[0])
        with power_readings(turns.device) as power:
            turns.time(cameras)
        compared, first = cameras[:: max(1, len(cameras) // PSNR_FRAMES)], contenders[0]
        for contender in contenders[1:]:
            if contender.pack is first.pack:
                contender.psnr = _psnr(turns.offscreen, compared, contender.settings, first.settings)
        if scene is not None:
            _compare_with_photographs(turns, scene, split)
        return Measurement(turns.device, turns.clock, contenders, mean_watts(power), turns.offscreen.pack.grid_size)


def _compare_with_photographs(turns: Turns, scene: Scene, split: str) -> None:
    """Notes the PSNR of each contender's pictures, as snerg-eval has it: of 8-bit pictures, the mean over views."""
    views = scene.splits[split]
    scores: dict[str, list[float]] = {c.name: [] for c in turns.contenders}
    with progress("comparing with photographs", len(views)) as bar:
        for view in views:
            truth = over_background(view.load(), scene.background)
            for contender in turns.contenders:
                camera = ViewCamera.from_scene_camera(contender.pack, view.camera)
                settings = replace(contender.settings, background=scene.background)
                picture = turns.drawn_by[contender.name].render(camera, settings) / np.float32(255)
                error = max(float(np.mean(np.square(picture - truth, dtype=np.float64))), 1e-12)
                scores[contender.name].append(-10.0 * float(np.log10(error)))
            bar.advance()
    for contender in turns.contenders:
        contender.photographs_psnr = float(np.mean(scores[contender.name]))


def _psnr(offscreen: OffscreenRenderer, cameras: Sequence[ViewCamera], a: RenderSettings, b: RenderSettings) -> float:
    differences = (offscreen.render_float(camera, a) - offscreen.render_float(camera, b) for camera in cameras)
    error = float(np.mean([np.mean(np.square(difference, dtype=np.float64)) for difference in differences]))
    return inf if error == 0 else -10.0 * float(np.log10(error))


def sustained(
    renderer: OffscreenRenderer, cameras: Sequence[ViewCamera], settings: RenderSettings, seconds: float
) -> dict[str, Any]:
    """frames, fps, watts (None where unknown) and fps_per_watt of drawing `cameras` over and over for so many seconds."""
    framebuffer = renderer.framebuffer(cameras[0].width, cameras[0].height)

    def draw(camera: ViewCamera) -> None:
        renderer.renderer.render(framebuffer, camera, settings)
        renderer.ctx.finish()

    for _ in range(WARM_UP_FRAMES):
        draw(cameras[0])
    frames, began = 0, time.perf_counter()
    with power_readings(str(renderer.ctx.info["GL_RENDERER"])) as power:
        for camera in itertools.cycle(cameras):
            draw(camera)
            frames += 1
            if time.perf_counter() - began >= seconds:
                break
    fps = frames / (time.perf_counter() - began)
    watts = mean_watts(power)
    return {"frames": frames, "fps": fps, "watts": watts, "fps_per_watt": fps / watts if watts else None}
