"""How long frames take along a camera path, as the paper measures them (SNeRG paper, appendix B).

Several ways to draw a pack, or several packs, are drawn frame by frame in turn, so that whatever else the machine does
slows all of them alike. The clock is a GPU timer query where those can be trusted, and wall time around a finish() on
software rasterisers, where they cannot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace

import moderngl
import numpy as np

from console import progress
from scenepack.pack import Pack
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.opengl import GpuClock
from viewer.rendering.settings import RenderSettings
from viewer.rendering.software_rasteriser import is_software

WARM_UP_FRAMES = 3


@dataclass
class Contender:
    """A way to draw, and the milliseconds that each frame took. pack: what it draws; None: the pack that is measured."""

    name: str
    settings: RenderSettings
    pack: Pack | None = None
    ms: list[float] = field(default_factory=list)

    def statistics(self) -> dict[str, float]:
        """Mean, standard deviation, percentiles (ms) and frames per second of the mean."""
        times = np.asarray(self.ms)
        percentiles = {f"ms_p{share}": float(np.percentile(times, share)) for share in (50, 95, 99)}
        mean = float(times.mean())
        return {"ms_mean": mean, "ms_std": float(times.std()), **percentiles, "fps": 1000.0 / mean}

    def ratio_to(self, first: Contender) -> dict[str, float]:
        """How many times `first`'s frame time ours is: of the medians, and between which most pairs of frames lie."""
        pairs = np.asarray(self.ms) / np.asarray(first.ms)
        low, high = (float(v) for v in np.percentile(pairs, (5, 95)))
        return {"ratio": float(np.median(self.ms) / np.median(first.ms)), "ratio_p5": low, "ratio_p95": high}


class Turns:
    """Contenders that draw in turn, in one OpenGL context. pack: whose grid frame cameras are in. drawn_by: by name."""

    def __init__(self, pack: Pack, contenders: Sequence[Contender], drawn_by: Mapping[str, OffscreenRenderer]) -> None:
        self.pack, self.contenders, self.drawn_by = pack, list(contenders), drawn_by
        self.offscreen = drawn_by[self.contenders[0].name]
        self.device = str(self.offscreen.ctx.info["GL_RENDERER"])
        self.clock = "wall time around finish()" if is_software(self.device) else "GPU timer queries"

    @property
    def gpu_bytes(self) -> dict[str, int]:
        return {c.name: self.drawn_by[c.name].renderer.gpu_bytes(c.settings.marcher) for c in self.contenders}

    def _draw(self, contender: Contender, framebuffer: moderngl.Framebuffer, camera: ViewCamera) -> None:
        self.drawn_by[contender.name].renderer.render(framebuffer, camera, contender.settings)

    def _view(self, contender: Contender, camera: ViewCamera) -> ViewCamera:
        """The camera in the grid frame of the pack that the contender draws."""
        return same_view(camera, self.pack, contender.pack or self.pack)

    def warm_up(self, camera: ViewCamera) -> None:
        """Draws `camera` a few times with each contender, so that shaders are compiled and clocks are up."""
        framebuffer = self.offscreen.framebuffer(camera.width, camera.height)
        for contender in self.contenders:
            view = self._view(contender, camera)
            for _ in range(WARM_UP_FRAMES):
                self._draw(contender, framebuffer, view)
                self.offscreen.ctx.finish()

    def time(self, cameras: Sequence[ViewCamera]) -> None:
        """Draws every camera, all of one size, with every contender in turn, and notes the times with each."""
        framebuffer = self.offscreen.framebuffer(cameras[0].width, cameras[0].height)
        clock = GpuClock(self.offscreen.ctx)
        with progress("measuring", len(cameras)) as bar:
            for camera in cameras:
                for contender in self.contenders:
                    view = self._view(contender, camera)
                    self.offscreen.ctx.finish()
                    gpu, wall = clock.time(lambda c=contender, v=view: self._draw(c, framebuffer, v))
                    contender.ms.append(wall if gpu is None else gpu)
                bar.advance()


def same_view(camera: ViewCamera, pack: Pack, other: Pack) -> ViewCamera:
    """A camera in the grid frame of `pack` as one in that of `other`; both packs were trained in one frame."""
    if np.array_equal(pack.worldspace_T_opengl, other.worldspace_T_opengl):
        return camera
    other_T_pack = np.linalg.inv(other.worldspace_T_opengl) @ pack.worldspace_T_opengl
    return replace(camera, grid_T_camera=other_T_pack @ camera.grid_T_camera)


@contextmanager
def taking_turns(pack: Pack, contenders: Sequence[Contender], *, allow_half: bool = False) -> Iterator[Turns]:
    """Opens `pack`, and the packs that contenders bring, in one context. Contenders of one pack share its textures.

    UserError where there is no OpenGL or a pack does not fit, unless half its resolution does and is allowed.
    """
    with ExitStack() as stack:
        opened: dict[int, OffscreenRenderer] = {}
        ctx = None
        for contender in contenders:
            own = contender.pack or pack
            if id(own) not in opened:
                offscreen = OffscreenRenderer(own, contender.settings.marcher, ctx, allow_half=allow_half)
                opened[id(own)] = stack.enter_context(offscreen)
                ctx = offscreen.ctx
        yield Turns(pack, contenders, {c.name: opened[id(c.pack or pack)] for c in contenders})
