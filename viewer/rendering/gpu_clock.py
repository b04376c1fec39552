"""How long drawing takes: GPU timer queries where they can be trusted, and wall time around finish() everywhere.

A software rasteriser draws on the processor after the query has ended, or not at all until it is asked for pixels, so
that its timer queries tell little of what a picture costs; there they are not used.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import moderngl

from viewer.rendering.gl_without_gil import finish

SOFTWARE = ("llvmpipe", "softpipe", "swiftshader", "software")


def is_software(renderer: str) -> bool:
    """Whether GL_RENDERER names a software rasteriser."""
    return any(word in renderer.lower() for word in SOFTWARE)


class GpuClock:
    """Times drawing in `ctx`. reason: why GPU times are not measured; "" where they are."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        renderer = str(ctx.info.get("GL_RENDERER", ""))
        self.reason = f"{renderer.split(' (')[0]} draws in software" if is_software(renderer) else ""
        self._query = None if self.reason else ctx.query(time=True)

    def time(self, draw: Callable[[], None]) -> tuple[float | None, float]:
        """Runs `draw` to its end: milliseconds on the GPU, None where they are not measured, and by the wall clock."""
        start = time.perf_counter()
        if self._query is None:
            draw()
        else:
            with self._query:
                draw()
        finish(self.ctx)
        wall = 1000.0 * (time.perf_counter() - start)
        return (self._query.elapsed / 1e6 if self._query is not None else None), wall
