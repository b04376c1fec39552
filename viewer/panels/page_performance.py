"""How fast, and what it costs."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, imgui, implot

from viewer.app.application import App
from viewer.canvas import Canvas
from viewer.panels import theme
from viewer.panels.page_view import frame_time
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, figure, label, px, switch


def show(app: App, canvas: Canvas, fonts: Fonts) -> None:
    """Draws the page."""
    with card("time", fonts, "Frame time"):
        frame_time(app, canvas, fonts)
        label("Wait for the screen")
        app.interface.v_sync = switch("v-sync", app.interface.v_sync)
    summary = app.times.summary()
    with card("spread", fonts, "Spread"):
        _histogram(app)
        for name, key in (("Mean", "mean"), ("Median", "p50"), ("95th percentile", "p95"), ("Slowest", "max")):
            figure(name, f"{summary[key]:.1f} ms", fonts)
    with card("card", fonts, "Graphics card"):
        imgui.push_text_wrap_pos(0.0)
        imgui.text_unformatted(str(canvas.ctx.info.get("GL_RENDERER", "unknown")))
        imgui.pop_text_wrap_pos()
        figure("Texture memory", f"{canvas.gpu_bytes / 2**20:.0f} MiB", fonts)
        if app.scene is not None:
            pack = app.scene.pack
            figure("Macroblocks", f"{int(pack.occupied.sum())} of {pack.occupied.size}", fonts)
            figure("Block size", f"{pack.block_size}³ voxels", fonts)


def _histogram(app: App) -> None:
    """How often which frame time came up; the slowest hundredth is left out."""
    times = np.asarray(app.times.frame_ms, np.float64)
    if len(times) < 2:
        return
    top = max(2.0 * app.governor.target_ms, float(np.percentile(times, 99)))
    flags = implot.Flags_.canvas_only | implot.Flags_.no_inputs
    implot.push_style_color(implot.Col_.plot_bg, theme.rgb(theme.BASE))
    implot.push_style_color(implot.Col_.frame_bg, theme.rgb(theme.CARD))
    if implot.begin_plot("##histogram", ImVec2(-1, px(110)), flags):
        implot.setup_axes("", "", implot.AxisFlags_.no_grid_lines, implot.AxisFlags_.no_decorations)
        implot.setup_axes_limits(0.0, top, 0.0, 1.0, imgui.Cond_.always)
        counts, edges = np.histogram(np.minimum(times, top), bins=28, range=(0.0, top))
        heights = 0.95 * counts / max(int(counts.max()), 1)
        centres = 0.5 * (edges[1:] + edges[:-1])
        look = implot.Spec()
        look.fill_color = theme.rgb(theme.ACCENT)
        look.line_color = theme.rgb(theme.ACCENT)
        implot.plot_bars("ms", centres, heights, 0.85 * top / 28, look)
        implot.end_plot()
    implot.pop_style_color(2)
