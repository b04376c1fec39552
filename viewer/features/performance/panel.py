"""Performance page: the marcher, frame times and their plots, memory, samples per ray."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from imgui_bundle import ImVec2, imgui, implot

from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.widgets import px
from viewer.features.performance.frame_stats import AVERAGED, KEPT
from viewer.rendering.canvas import Canvas

MARCHERS = {
    "exact": ("Exact", "Jumps over empty space by a grid of distances. The picture is that of every sample."),
    "paper": (
        "Paper",
        "The paper's algorithm: skips empty macroblocks, then asks the nearest opacity before it takes a sample.",
    ),
    "brute": ("Every sample", "Takes every sample, to compare with."),
}


def show(app: App, canvas: Canvas) -> None:
    with ui.card("time", "Frame time"):
        frame_times(app, px(104))
        ui.figure("Frame to frame", f"{app.times.mean_ms:.1f} ms", dot=FRAME)
        ui.figure("Whole picture, wall clock", f"{canvas.picture_ms:.1f} ms", dot=WALL)
        gpu = canvas.picture_gpu_ms
        ui.figure("Whole picture, GPU clock", "not measured" if gpu is None else f"{gpu:.1f} ms", dot=GPU)
        if canvas.clock.reason:
            ui.hint(f"{canvas.clock.reason}: its timer is not reliable.")
        width, height = canvas.drawn_size
        ui.figure("Pixels drawn", f"{width} × {height}")
        app.interface.v_sync = ui.switch("v-sync", app.interface.v_sync, "V-sync")
        ui.tip("Limit the frame rate to that of the screen")
    with ui.card("marcher", "Marcher"):
        app.set(marcher=ui.explained("##marcher", MARCHERS, app.settings.marcher))
    with ui.card("spread", "Spread"):
        histogram(app, px(96))
        for name, share in (("Median", 50), ("95th percentile", 95), ("Slowest", 100)):
            ui.figure(name, f"{np.percentile(app.times.frame_ms or [0.0], share):.1f} ms")
        count = len(app.times.frame_ms)
        ui.hint(f"Of the last {count} frames; the figures above are of the last {min(count, AVERAGED)}.")
    with ui.card("rays", "Rays"):
        _rays(app)
    with ui.card("card", "Graphics card"):
        ui.paragraph(canvas.gpu_name)
        for name, size in canvas.gpu_bytes_by_use.items():
            ui.figure(name, f"{size / 2**20:.0f} MiB")
        ui.figure("All textures", f"{canvas.gpu_bytes / 2**20:.0f} MiB")
        pack = app.open_scene.pack
        ui.figure("Macroblocks", f"{int(pack.occupied.sum())} of {pack.occupied.size}")
        ui.figure("Block size", f"{pack.block_size}³ voxels")


def _rays(app: App) -> None:
    on = ui.switch("rays", app.costs.enabled, "Count at rest")
    ui.tip("Counts in a small picture of the view, once the camera rests")
    if on != app.costs.enabled:
        app.costs.switch(on)
    costs = app.costs.costs
    if not app.costs.enabled:
        ui.hint("How many voxels each ray fetches, and how often it jumps over empty space.")
    elif costs is None:
        ui.hint("Waiting for the camera to rest.")
    else:
        for name, counts in (("Samples", costs.samples), ("Jumps", costs.jumps)):
            ui.figure(f"{name}, mean", f"{counts.mean():.1f}")
            ui.figure(f"{name}, maximum", f"{counts.max():.0f}")
        width, height = costs.size
        text = f"Of the {100 * costs.hit:.0f} % of rays that hit something, counted at {width} × {height}."
        ui.hint(text, theme.MUTED)


# --- Frame times as ImPlot shows them ---

FRAME, WALL, GPU = theme.ACCENT, theme.WARN, theme.BLUE
BINS = 28


def frame_times(app: App, height: float) -> None:
    """The mean time of a frame and the frames per second that follow from it; below, the last frames, newest at the right: frame
    to frame, and of that the picture, by the wall's and the GPU's clock.
    """
    times, frames = app.times, np.asarray(app.times.frame_ms, np.float64)
    ui.headline(f"{times.mean_ms:.1f}", f"ms      {times.fps:.0f} fps")
    with _plot("##rolling", height, (-KEPT, 0.0), _top(app), "") as shown:
        if not shown or not len(frames):
            return
        _line("target", np.full(2, app.resolution.target_ms), theme.FAINT, 1.0, xs=np.array([-KEPT, 0.0]))
        look = implot.Spec(fill_color=theme.rgb(FRAME, 0.16))
        implot.plot_shaded("frame shade", np.arange(1.0 - len(frames), 1.0), frames, 0.0, look)
        for name, values, colour in (("wall", times.scene_ms, WALL), ("gpu", times.gpu_ms, GPU)):
            _line(name, np.asarray(values, np.float64), colour, 1.5)
        _line("frame", frames, FRAME, 1.5)


def histogram(app: App, height: float) -> None:
    """How often which time from frame to frame came up; slower ones than fit are in the last bar."""
    values, top = np.asarray(app.times.frame_ms, np.float64), _top(app)
    with _plot("##histogram", height, (0.0, top), 1.0, "%.0f ms") as shown:
        if not shown:
            return
        counts, edges = np.histogram(np.minimum(values, top), bins=BINS, range=(0.0, top))
        centres = 0.5 * (edges[1:] + edges[:-1])
        look = implot.Spec(fill_color=theme.rgb(FRAME), line_color=theme.rgb(FRAME))
        implot.plot_bars("frames", centres, 0.92 * counts / max(int(counts.max()), 1), 0.85 * top / BINS, look)
        _line("target", np.array([0.0, 1.0]), theme.FAINT, 1.0, xs=np.full(2, app.resolution.target_ms))


def _top(app: App) -> float:
    """The longest time that is shown, ms: round, and beyond both the target and nearly all frames."""
    slow = float(np.percentile(app.times.frame_ms or [0.0], 98))
    longest = max(1.5 * app.resolution.target_ms, 1.15 * slow)
    step = 10.0 ** np.floor(np.log10(longest))
    return float(next(step * m for m in (1, 2, 4, 8, 10) if step * m >= longest))


@contextmanager
def _plot(name: str, height: float, xs: tuple[float, float], top: float, x_format: str) -> Iterator[bool]:
    """An empty plot over xs × 0 … top, with times (ms) at the left unless x has them. Nothing in it can be dragged.

    Gives whether it is in view, and so to be filled.
    """
    colours = {
        implot.Col_.plot_bg: theme.rgb(theme.BASE),
        implot.Col_.frame_bg: theme.rgb(theme.CARD),
        implot.Col_.plot_border: theme.rgb(theme.BASE),
        implot.Col_.axis_text: theme.rgb(theme.MUTED),
        implot.Col_.axis_grid: theme.rgb(theme.LINE),
    }
    for colour, value in colours.items():
        implot.push_style_color(colour, value)
    implot.push_style_var(implot.StyleVar_.plot_padding, ImVec2(0, px(4)))
    implot.push_style_var(implot.StyleVar_.label_padding, ImVec2(px(4), px(4)))
    bare, quiet = implot.AxisFlags_.no_decorations, implot.AxisFlags_.no_tick_marks | implot.AxisFlags_.no_label
    with ui.font(None, theme.SMALL - 1):
        flags = implot.Flags_.canvas_only | implot.Flags_.no_inputs | implot.Flags_.no_frame
        shown = implot.begin_plot(name, ImVec2(-1, height), flags)
        if shown:
            implot.setup_axes("", "", quiet if x_format else bare, bare if x_format else quiet)
            axis = implot.ImAxis_.x1 if x_format else implot.ImAxis_.y1
            implot.setup_axis_format(axis, x_format or "%.0f")
            ticks = (0.25 * xs[1], 0.75 * xs[1]) if x_format else (0.0, top)  # at the ends of x, they would stick out
            implot.setup_axis_ticks(axis, *ticks, 3)
            implot.setup_axes_limits(*xs, 0.0, top, imgui.Cond_.always)
        yield shown
        if shown:
            implot.end_plot()
    implot.pop_style_var(2)
    implot.pop_style_color(len(colours))


def _line(name: str, values: np.ndarray, colour: str, width: float, xs: np.ndarray | None = None) -> None:
    """xs: float64; by default how many frames ago each of the values was, below 0."""
    if len(values) == 0 or np.isnan(values).all():
        return
    look = implot.Spec(line_color=theme.rgb(colour), line_weight=px(width))
    implot.plot_line(name, np.arange(1.0 - len(values), 1.0) if xs is None else xs, values, look)
