"""How fast, and what it costs."""

from __future__ import annotations

from imgui_bundle import imgui

from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.app.frame_stats import AVERAGED
from viewer.panels import theme, time_plots
from viewer.panels.page_view import headline
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, figure, hint, label, px, switch, tip


def show(app: App, canvas: CanvasInterface, fonts: Fonts) -> None:
    """Draws the page."""
    summary, target = app.times.summary(), app.resolution.target_ms
    with card("time", fonts, "Frame time"):
        headline(app, fonts)
        time_plots.rolling(app.times, target, px(104))
        figure("Frame to frame", f"{summary.mean:.1f} ms", fonts, dot=time_plots.FRAME)
        figure("Whole picture, wall clock", f"{canvas.picture_ms:.1f} ms", fonts, dot=time_plots.WALL)
        gpu = canvas.picture_gpu_ms
        figure(
            "Whole picture, GPU clock", "not measured" if gpu is None else f"{gpu:.1f} ms", fonts, dot=time_plots.GPU
        )
        if canvas.clock_problem:
            hint(f"{canvas.clock_problem}: its timer is not reliable.")
        width, height = canvas.drawn_size
        figure("Pixels drawn", f"{width} × {height}", fonts)
        label("V-sync")
        app.interface.v_sync = switch("v-sync", app.interface.v_sync)
        tip("Limit the frame rate to that of the screen")
    with card("spread", fonts, "Spread"):
        time_plots.histogram(app.times, target, px(96))
        for name, value in (
            ("Median", summary.median),
            ("95th percentile", summary.p95),
            ("Slowest", summary.slowest),
        ):
            figure(name, f"{value:.1f} ms", fonts)
        hint(f"Of the last {len(app.times.frame_ms)} frames; the figures above are of the last {AVERAGED}.")
    with card("rays", fonts, "Rays"):
        _rays(app, fonts)
    with card("card", fonts, "Graphics card"):
        imgui.push_text_wrap_pos(0.0)
        imgui.text_unformatted(canvas.card)
        imgui.pop_text_wrap_pos()
        for name, size in canvas.gpu_bytes_by_use.items():
            figure(name, f"{size / 2**20:.0f} MiB", fonts)
        figure("All textures", f"{canvas.gpu_bytes / 2**20:.0f} MiB", fonts)
        if app.scene is not None:
            pack = app.scene.pack
            figure("Macroblocks", f"{int(pack.occupied.sum())} of {pack.occupied.size}", fonts)
            figure("Block size", f"{pack.block_size}³ voxels", fonts)


def _rays(app: App, fonts: Fonts) -> None:
    label("Count at rest")
    on = switch("rays", app.costs.enabled)
    tip("Counts in a small picture of the view, once the camera rests")
    if on != app.costs.enabled:
        app.costs.switch(on)
        app.touch()
    costs = app.costs.costs
    if not app.costs.enabled:
        hint("How many voxels each ray fetches, and how often it jumps over empty space.")
    elif costs is None:
        hint("Waiting for the camera to rest.")
    else:
        figure("Samples, mean", f"{costs.samples_mean:.1f}", fonts)
        figure("Samples, maximum", f"{costs.samples_max}", fonts)
        figure("Jumps, mean", f"{costs.jumps_mean:.1f}", fonts)
        figure("Jumps, maximum", f"{costs.jumps_max}", fonts)
        width, height = costs.size
        hint(f"Of the {100 * costs.hit:.0f} % of rays that hit something, counted at {width} × {height}.", theme.MUTED)
