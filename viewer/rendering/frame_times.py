"""How long frames take along a camera path, as the paper measures them (SNeRG paper, appendix B).

Several ways to draw a pack, or several packs, are drawn frame by frame in turn, so that whatever else the machine does
slows all of them alike. The clock is a GPU timer query where those can be trusted, and wall time around a finish() on
software rasterisers, where they cannot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

import numpy as np

from console import progress
from scenepack.pack import Pack
from viewer.rendering.camera import ViewCamera, forward_facing_path, orbit_path
from viewer.rendering.gpu_clock import GpuClock, is_software
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.renderer import Renderer
from viewer.rendering.settings import RenderSettings

WARM_UP_FRAMES = 3


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


class Turns:
    """Contenders that draw in turn, in one OpenGL context. offscreen: of the first pack; renderers: by contender's name."""

    def __init__(
        self, offscreen: OffscreenRenderer, contenders: Sequence[Contender], renderers: Mapping[str, Renderer]
    ) -> None:
        self.offscreen, self.contenders, self.renderers = offscreen, list(contenders), renderers
        self.device = str(offscreen.ctx.info["GL_RENDERER"])
        self.clock = "wall time around finish()" if is_software(self.device) else "GPU timer queries"

    @property
    def gpu_bytes(self) -> dict[str, int]:
        """Bytes of textures, by contender."""
        return {c.name: self.renderers[c.name].gpu_bytes(c.settings.marcher) for c in self.contenders}

    def warm_up(self, camera: ViewCamera) -> None:
        """Draws `camera` a few times with each contender, so that shaders are compiled and clocks are up."""
        framebuffer = self.offscreen.framebuffer(camera.width, camera.height)
        for contender in self.contenders:
            for _ in range(WARM_UP_FRAMES):
                self.renderers[contender.name].render(framebuffer, camera, contender.settings)
                self.offscreen.ctx.finish()

    def time(self, cameras: Sequence[ViewCamera]) -> None:
        """Draws every camera, all of one size, with every contender in turn, and notes the times with each."""
        framebuffer = self.offscreen.framebuffer(cameras[0].width, cameras[0].height)
        clock = GpuClock(self.offscreen.ctx)
        with progress("measuring", len(cameras)) as bar:
            for camera in cameras:
                for contender in self.contenders:
                    draw = self.renderers[contender.name].render
                    self.offscreen.ctx.finish()
                    gpu, wall = clock.time(lambda c=camera, s=contender.settings, d=draw: d(framebuffer, c, s))
                    contender.ms.append(wall if gpu is None else gpu)
                bar.advance()


@contextmanager
def taking_turns(
    pack: Pack,
    contenders: Sequence[Contender],
    other_packs: Mapping[str, Pack] | None = None,
    *,
    allow_half: bool = False,
) -> Iterator[Turns]:
    """Opens `pack` for `contenders`, and other packs, by name, each drawn like the first of them.

    UserError where there is no OpenGL or a pack does not fit, unless half its resolution does and is allowed.
    """
    first = contenders[0].settings
    with OffscreenRenderer(pack, first.marcher, allow_half=allow_half) as offscreen, ExitStack() as stack:
        renderers = {contender.name: offscreen.renderer for contender in contenders}
        for label, other in (other_packs or {}).items():
            beside = OffscreenRenderer(other, first.marcher, offscreen.ctx, allow_half=allow_half)
            renderers[label] = stack.enter_context(beside).renderer
        others = [Contender(label, first) for label in other_packs or {}]
        yield Turns(offscreen, [*contenders, *others], renderers)
