"""Anti-aliasing: the mean of n × n rays a pixel, for pictures and films.

A pixel's rays go through the middles of n × n equal parts of it. What they show is what a picture of n times the width and
height shows; its float values, before any rounding, are averaged over each pixel (a box filter). Colours are
display-referred and premultiplied by opacity over the background (docs/rendering.md), so that the mean of rays is the
mean of light as these pictures have it. The larger picture is drawn in tiles, so that memory does not grow with n.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import moderngl

from viewer.rendering.camera import ViewCamera
from viewer.rendering.opengl import Drawing, free_framebuffer, new_framebuffer
from viewer.rendering.settings import RenderSettings, of_picture
from viewer.rendering.shader_source import assemble

Box = tuple[int, int, int, int]  # x, y, width, height in pixels, from the lower left corner
Draw = Callable[[moderngl.Framebuffer, ViewCamera, RenderSettings, Box], None]
TILE = 1024  # rays a side that are drawn at once


class Supersampling:
    """Draws pictures with settings.samples > 1 by way of larger ones, in the OpenGL context `ctx`."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self._rays: moderngl.Framebuffer | None = None
        self._filters: dict[int, Drawing] = {}

    def draw(
        self, draw: Draw, framebuffer: moderngl.Framebuffer, camera: ViewCamera, settings: RenderSettings, viewport: Box
    ) -> None:
        """Fills `viewport` of `framebuffer` with the view of `camera`, which has the viewport's size.

        draw: draws a view with one ray a pixel. UserError where the driver refuses the texture that it needs.
        """
        n, (left, bottom, width, height) = settings.samples, viewport
        settings = of_picture(settings, camera.height, camera.fy)
        one, side = replace(settings, samples=1), max(1, TILE // n)
        larger = camera.resized(n * width, n * height)
        for y in range(0, height, side):
            for x in range(0, width, side):
                w, h = min(side, width - x), min(side, height - y)
                below = height - y - h  # rows between the tile and the picture's lower edge
                part = replace(larger, width=n * w, height=n * h, cx=larger.cx - n * x, cy=larger.cy - n * y)
                rays = self._target(n * min(side, width), n * min(side, height))
                draw(rays, part, one, (0, 0, n * w, n * h))
                self._average(rays, n, framebuffer, (left + x, bottom + below, w, h))

    def _average(self, rays: moderngl.Framebuffer, n: int, framebuffer: moderngl.Framebuffer, box: Box) -> None:
        if n not in self._filters:
            fragment = assemble("box_filter.frag", {"SAMPLES": n})
            self._filters[n] = Drawing(self.ctx, assemble("fullscreen.vert"), fragment)
        framebuffer.use()
        framebuffer.scissor = None  # pyright: ignore[reportAttributeAccessIssue]
        framebuffer.viewport = box
        framebuffer.color_mask = (True, True, True, True)
        framebuffer.depth_mask = False
        self.ctx.enable_only(moderngl.NOTHING)
        self.ctx.clear_samplers(0, 1)
        rays.color_attachments[0].use(0)  # type: ignore[union-attr]
        self._filters[n].write({"corner": box[:2]})
        self._filters[n].draw(3)

    def _target(self, width: int, height: int) -> moderngl.Framebuffer:
        """A float framebuffer of at least this size."""
        there = self._rays
        if there is None or there.width < width or there.height < height:
            self._free()
            self._rays = there = new_framebuffer(self.ctx, width, height, "f4")
        return there

    def _free(self) -> None:
        if self._rays is not None:
            free_framebuffer(self._rays)
        self._rays = None

    def release(self) -> None:
        self._free()
        for drawing in self._filters.values():
            drawing.release()
        self._filters = {}
