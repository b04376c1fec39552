"""Frame times as the paper measures them (SNeRG paper, appendix B), of one or several ways to draw a pack.

Several are drawn frame by frame in turn, so that whatever else the machine does slows all of them alike. The clock is a
GPU timer query where those can be trusted, and wall time around a finish() on software rasterisers, where they cannot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field

import moderngl
import numpy as np

from console import progress
from scenepack.pack import Pack
from viewer.benchmark.power import PowerMeter
from viewer.rendering.camera import ViewCamera, forward_facing_path, orbit_path
from viewer.rendering.gpu_clock import GpuClock, is_software
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

WARM_UP_FRAMES = 3
PSNR_FRAMES = 8  # compared between two marchers, spread over the path


@dataclass(frozen=True)
class Protocol:
    """fov: vertical, degrees. size: width, height in pixels. path: cameras from (pack, frames, fov, size)."""

    fov: float
    size: tuple[int, int]
    path: Callable[..., list[ViewCamera]]


PROTOCOLS = {
    "synthetic": Protocol(39.0, (800, 800), orbit_path),
    "forward-facing": Protocol(53.0, (1006, 756), forward_facing_path),
    "real360": Protocol(53.0, (990, 773), orbit_path),
}


@dataclass
class Contender:
    """A way to draw, and the milliseconds that each frame took."""

    name: str
    settings: RenderSettings
    ms: list[float] = field(default_factory=list)

    def statistics(self) -> dict[str, float]:
        """Mean, standard deviation, percentiles (ms) and frames per second of the mean."""
        times = np.asarray(self.ms)
        p50, p95, p99 = (float(v) for v in np.percentile(times, (50, 95, 99)))
        mean = float(times.mean())
        return {
            "ms_mean": mean,
            "ms_std": float(times.std()),
            "ms_p50": p50,
            "ms_p95": p95,
            "ms_p99": p99,
            "fps": 1000.0 / mean,
        }


@dataclass(frozen=True)
class Measurement:
    """contenders: with their times, in the order given. clock: what measured them. watts: None where unknown.

    psnr: by name, of a contender against the first one, dB over the frames compared; infinite where they are equal.
    """

    renderer: str
    clock: str
    contenders: list[Contender]
    gpu_bytes: dict[str, int]
    watts: float | None
    psnr: dict[str, float]


def measure(
    pack: Pack, cameras: list[ViewCamera], contenders: list[Contender], other_packs: Mapping[str, Pack] | None = None
) -> Measurement:
    """Draws every camera with every contender in turn. UserError where there is no OpenGL or the pack does not fit.

    other_packs: by name, packs to be measured beside it, each drawn like the first contender.
    """
    others = dict(other_packs or {})
    with OffscreenRenderer(pack, contenders[0].settings.marcher) as offscreen, ExitStack() as stack:
        ctx = offscreen.ctx
        renderers = {contender.name: offscreen.renderer for contender in contenders}
        for label, other in others.items():
            drawn = stack.enter_context(OffscreenRenderer(other, contenders[0].settings.marcher, ctx))
            renderers[label] = drawn.renderer
        own = list(contenders)
        contenders = own + [Contender(label, own[0].settings) for label in others]
        name = ctx.info["GL_RENDERER"]
        timed = _timer(ctx)
        framebuffer = offscreen.framebuffer(cameras[0].width, cameras[0].height)
        for contender in contenders:
            for camera in cameras[:1] * WARM_UP_FRAMES:
                renderers[contender.name].render(framebuffer, camera, contender.settings)
                ctx.finish()
        with progress("measuring", len(cameras)) as bar, PowerMeter(name) as meter:
            for camera in cameras:
                for contender in contenders:
                    contender.ms.append(
                        timed(
                            lambda c=camera, s=contender.settings, r=renderers[contender.name]: r.render(
                                framebuffer, c, s
                            )
                        )
                    )
                bar.advance()
        compared = cameras[:: max(1, len(cameras) // PSNR_FRAMES)]
        return Measurement(
            name,
            "wall time around finish()" if is_software(name) else "GPU timer queries",
            contenders,
            {c.name: renderers[c.name].gpu_bytes(c.settings.marcher) for c in contenders},
            meter.watts,
            {c.name: _psnr(offscreen, compared, c.settings, own[0].settings) for c in own[1:]},
        )


def _timer(ctx: moderngl.Context) -> Callable[[Callable[[], None]], float]:
    """A function that runs a drawing function and gives the milliseconds it took."""
    clock = GpuClock(ctx)

    def timed(draw: Callable[[], None]) -> float:
        ctx.finish()
        gpu, wall = clock.time(draw)
        return wall if gpu is None else gpu

    return timed


def _psnr(
    offscreen: OffscreenRenderer, cameras: list[ViewCamera], settings: RenderSettings, against: RenderSettings
) -> float:
    errors = []
    for camera in cameras:
        difference = offscreen.render_float(camera, settings) - offscreen.render_float(camera, against)
        errors.append(np.mean(np.square(difference, dtype=np.float64)))
    error = float(np.mean(errors))
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))
