"""Screen: points, lines and textures over the picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2, imgui

from viewer.core import theme
from viewer.core.pose import project
from viewer.core.widgets import Box, draw_picture, px
from viewer.rendering.targets import Layer

if TYPE_CHECKING:
    from viewer.app.application import App

AXIS_COLOURS = ("#f2777a", "#6fd08c", "#6cb2f5")
LENS_PIECES = 12  # that a straight line is drawn as through a lens


def draw_layers(layers: list[Layer], box: Box) -> None:
    x, y, width, height = box
    for layer in layers:
        x0, y0, x1, y1 = layer.box
        low, high = ImVec2(x + x0 * width, y + y0 * height), ImVec2(x + x1 * width, y + y1 * height)
        draw_picture(layer.texture, low, high, (layer.uv0, layer.uv1), opacity=layer.opacity, rounding=0.0)


class Screen:
    def __init__(self, app: App, box: Box) -> None:
        camera = app.viewport.camera
        assert camera is not None
        self.camera, self.box = camera, box
        self.scale = 1.0 / app.viewport.pixels_per_unit

    def points(self, grid: np.ndarray) -> tuple[list[ImVec2], np.ndarray]:
        pixels, before = project(self.camera, grid)
        return [ImVec2(x, y) for x, y in (self.box[:2] + self.scale * pixels).tolist()], before

    def outlined_lines(
        self, grid: np.ndarray, edges, colour: str, width: float, dark: float, shade: float = 0.75
    ) -> None:
        """Lines on wider dark ones, to be seen on any picture. width, dark: in units of a 100 % display. shade: 0 … 1."""
        self.lines(grid, edges, theme.packed(theme.BASE, shade), px(dark))
        self.lines(grid, edges, theme.packed(colour), px(width))

    def lines(self, grid: np.ndarray, edges, colour: int, width: float) -> None:
        if any(self.camera.distortion):  # a lens bends them
            grid, edges = _in_pieces(grid, edges)
        points, before = self.points(grid)
        draw = imgui.get_window_draw_list()
        for a, b in edges:
            if before[a] and before[b]:
                draw.add_line(points[a], points[b], colour, width)


def _in_pieces(grid: np.ndarray, edges) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Points and edges of the same lines, each cut into LENS_PIECES."""
    share = np.linspace(0.0, 1.0, LENS_PIECES + 1)[:, None]
    points = np.concatenate([(1 - share) * grid[a] + share * grid[b] for a, b in edges])
    starts = [line * (LENS_PIECES + 1) + i for line in range(len(edges)) for i in range(LENS_PIECES)]
    return points, [(start, start + 1) for start in starts]
