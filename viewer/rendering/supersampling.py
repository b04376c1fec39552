"""Anti-aliasing and depth of field: the mean of many rays a pixel, for pictures and films.

A pixel's rays go through the middles of n × n equal parts of it. What they show is what a picture of n times the width and
height shows; its float values, before any rounding, are averaged over each pixel (a box filter). Colours are
display-referred and premultiplied by opacity over the background (docs/rendering.md), so that the mean of rays is the
mean of light as these pictures have it. The larger picture is drawn in tiles, so that memory does not grow with n.

With an aperture, the same is drawn from points that lie evenly in the opening of a thin lens, by cameras that see the plane in
focus at the same pixels, and the mean of all is taken.
"""

from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, sin, sqrt

import moderngl

from viewer.rendering.camera import ViewCamera
from viewer.rendering.opengl import Drawing, begin_drawing
from viewer.rendering.settings import Aperture, RenderSettings
from viewer.rendering.shader_source import assemble
from viewer.rendering.targets import Target

Pixel = tuple[int, int]  # x, y, from the lower left corner
Box = tuple[int, int, int, int]  # the same, and width and height
Draw = Callable[[moderngl.Framebuffer, ViewCamera, RenderSettings], None]
TILE = 1024  # rays a side that are drawn at once
GOLDEN_ANGLE = pi * (3.0 - sqrt(5.0))


def lens_cameras(camera: ViewCamera, aperture: Aperture) -> list[ViewCamera]:
    """Cameras at points of the opening, of a perspective camera without distortion."""
    cameras = []
    for i in range(aperture.rays):  # a sunflower's spiral: equal areas
        radius, turn = 0.5 * aperture.diameter * sqrt((i + 0.5) / aperture.rays), GOLDEN_ANGLE * i
        right, up = radius * cos(turn), radius * sin(turn)
        matrix = camera.grid_T_camera.copy()
        matrix[:3, 3] += right * matrix[:3, 0] + up * matrix[:3, 1]
        cx, cy = camera.cx + camera.fx * right / aperture.focus, camera.cy - camera.fy * up / aperture.focus
        cameras.append(replace(camera, grid_T_camera=matrix, cx=cx, cy=cy))
    return cameras


class Supersampling:
    """Draws pictures with settings.samples > 1 by way of larger ones, in the OpenGL context `ctx`; and those with an aperture."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self._rays, self._mean = (Target(ctx, dtype="f4") for _ in range(2))
        self._filters: dict[int, Drawing] = {}

    def draw(
        self, draw: Draw, framebuffer: moderngl.Framebuffer, camera: ViewCamera, settings: RenderSettings, corner: Pixel
    ) -> None:
        """Draws the view of `camera` as Renderer.render does. UserError where the driver refuses the texture that it needs.

        draw: draws a view with one ray a pixel into the lower left corner of a framebuffer.
        """
        n, (left, bottom), width, height = settings.samples, corner, camera.width, camera.height
        one, side = replace(settings, samples=1, aperture=None), max(1, TILE // n)
        cameras = [camera] if settings.aperture is None else lens_cameras(camera, settings.aperture)
        larger = [each.resized(n * width, n * height) for each in cameras]
        count = n * n * len(cameras)
        rays = self._rays.fit(n * min(side, width), n * min(side, height))
        mean = self._mean.fit(min(side, width), min(side, height))
        for y in range(0, height, side):
            for x in range(0, width, side):
                w, h = min(side, width - x), min(side, height - y)
                mean.scissor = None  # pyright: ignore[reportAttributeAccessIssue]
                mean.clear()
                for each in larger:
                    draw(rays, each.part(n * x, n * y, n * w, n * h), one)
                    self._average(rays, n, count, mean, (0, 0, w, h))
                self._average(mean, 1, 1, framebuffer, (left + x, bottom + height - y - h, w, h))

    def _average(
        self, rays: moderngl.Framebuffer, n: int, count: int, framebuffer: moderngl.Framebuffer, box: Box
    ) -> None:
        """Puts sums of n × n rays, divided by `count`, into a box; adds them where that is only a part of a pixel's rays."""
        if n not in self._filters:
            fragment = assemble("box_filter.frag", {"SAMPLES": n})
            self._filters[n] = Drawing(self.ctx, assemble("fullscreen.vert"), fragment)
        begin_drawing(framebuffer, box)
        if count > n * n:
            self.ctx.enable_only(moderngl.BLEND)
            self.ctx.blend_func = moderngl.ONE, moderngl.ONE
        self.ctx.clear_samplers(0, 1)
        rays.color_attachments[0].use(0)  # type: ignore[union-attr]
        self._filters[n].write({"corner": box[:2], "count": float(count)})
        self._filters[n].draw(3)
        self.ctx.enable_only(moderngl.NOTHING)

    def release(self) -> None:
        self._rays.release()
        self._mean.release()
        for drawing in self._filters.values():
            drawing.release()
        self._filters = {}
