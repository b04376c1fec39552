"""Frame times of contenders along a camera path, or drawn without a pause; the GPU's power; how far pictures differ."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError, progress
from scenepack.pack import Pack
from training.scenes import Scene, load_scene
from training.scenes.scene_options import recorded_options
from viewer.rendering.camera import ViewCamera
from viewer.rendering.frame_times import WARM_UP_FRAMES, Contender, Turns, taking_turns
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

EVERY_S = 0.05


class PowerMeter:
    """Averages the GPU's power while the `with` block runs. watts: None where it is unknown."""

    def __init__(self, renderer: str) -> None:
        """renderer: GL_RENDERER; on a software rasteriser no card is asked."""
        self.watts: float | None = None
        self._readings: list[float] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        if "nvidia" not in renderer.lower():
            return
        try:
            import pynvml  # pyright: ignore[reportMissingImports]

            pynvml.nvmlInit()
            self._handle = pynvml.nvmlDeviceGetHandleByIndex(0)
            self._nvml = pynvml
            self._read()
        except Exception:  # no package, no driver, or a GPU that does not tell: each has errors of its own
            return
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def _read(self) -> None:
        self._readings.append(self._nvml.nvmlDeviceGetPowerUsage(self._handle) / 1000.0)

    def _watch(self) -> None:
        while not self._stop.wait(EVERY_S):
            with suppress(Exception):  # one reading less
                self._read()

    def __enter__(self) -> PowerMeter:
        if self._thread is not None:
            self._readings.clear()
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            if self._readings:
                self.watts = sum(self._readings) / len(self._readings)


# --- What snerg-bench measures ---

PSNR_FRAMES = 8  # compared between two marchers, spread over the path


@dataclass(frozen=True)
class Photographs:
    scene: Scene
    split: str

    @classmethod
    def of(cls, pack: Pack, scene: Path, split: str = "test", downscale: int = 1) -> Photographs:
        """Reads `scene` as the maker of `pack` read it. UserError where the split has no photographs."""
        read = load_scene(scene, downscale=downscale, **recorded_options(pack.metadata.get("provenance")))
        if not read.splits.get(split):
            names = ", ".join(name for name, some in read.splits.items() if some)
            raise UserError("has no such photographs", where=scene, expected=f"--split {names}", found=split)
        return cls(read, split)


@dataclass(frozen=True)
class Measurement:
    """What was measured."""

    renderer: str
    clock: str  # what measured the times
    contenders: list[Contender]  # with their times, in the order given
    gpu_bytes: dict[str, int]
    watts: float | None  # None where unknown
    psnr: dict[str, float]  # by name, of others of the same pack against the first, dB; infinite where equal
    grid_size: tuple[int, int, int]  # voxels (x, y, z) of the pack as it was drawn
    photographs: dict[str, float]  # by name, PSNR in dB against photographs, the mean over views


def measure(
    pack: Pack,
    cameras: list[ViewCamera],
    contenders: list[Contender],
    *,
    photographs: Photographs | None = None,
    allow_half: bool = False,
) -> Measurement:
    """Draws every camera with every contender in turn. UserError where there is no OpenGL or a pack does not fit.

    allow_half: a pack that does not fit is measured at half its resolution.
    """
    with taking_turns(pack, contenders, allow_half=allow_half) as turns:
        turns.warm_up(cameras[0])
        with PowerMeter(turns.device) as meter:
            turns.time(cameras)
        compared, first = cameras[:: max(1, len(cameras) // PSNR_FRAMES)], contenders[0].settings
        same = [c for c in contenders[1:] if c.pack is None]
        psnr = {c.name: _psnr(turns.offscreen, compared, c.settings, first) for c in same}
        shown = _against(turns, photographs) if photographs is not None else {}
        drawn = turns.offscreen.pack.grid_size
        return Measurement(
            turns.device, turns.clock, turns.contenders, turns.gpu_bytes, meter.watts, psnr, drawn, shown
        )


def _against(turns: Turns, photographs: Photographs) -> dict[str, float]:
    """PSNR (dB) of each contender's pictures, as snerg-eval has it: of 8-bit pictures, the mean over views."""
    scene = photographs.scene
    views = scene.splits[photographs.split]
    scores: dict[str, list[float]] = {c.name: [] for c in turns.contenders}
    with progress("comparing with photographs", len(views)) as bar:
        for view in views:
            rgba = view.load()
            truth = rgba[..., :3] * rgba[..., 3:] + np.asarray(scene.background, np.float32) * (1 - rgba[..., 3:])
            for contender in turns.contenders:
                camera = ViewCamera.from_scene_camera(contender.pack or turns.pack, view.camera)
                settings = replace(contender.settings, background=scene.background)
                picture = turns.drawn_by[contender.name].render(camera, settings) / np.float32(255)
                error = max(float(np.mean(np.square(picture - truth, dtype=np.float64))), 1e-12)
                scores[contender.name].append(-10.0 * float(np.log10(error)))
            bar.advance()
    return {name: float(np.mean(values)) for name, values in scores.items()}


def _psnr(
    offscreen: OffscreenRenderer, cameras: list[ViewCamera], settings: RenderSettings, against: RenderSettings
) -> float:
    errors = []
    for camera in cameras:
        difference = offscreen.render_float(camera, settings) - offscreen.render_float(camera, against)
        errors.append(np.mean(np.square(difference, dtype=np.float64)))
    error = float(np.mean(errors))
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))


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
    with PowerMeter(str(renderer.ctx.info["GL_RENDERER"])) as meter:
        for camera in itertools.cycle(cameras):
            draw(camera)
            frames += 1
            if time.perf_counter() - began >= seconds:
                break
    fps = frames / (time.perf_counter() - began)
    per_watt = fps / meter.watts if meter.watts else None
    return {"frames": frames, "fps": fps, "watts": meter.watts, "fps_per_watt": per_watt}
