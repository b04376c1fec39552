"""Plots as PNGs, drawn with matplotlib: lines over x and y, in one style for reports, runs and docs.

Here because the trainer and the viewer, which may not import one another, both draw them. matplotlib comes with the extra
`train`; the viewer does without it.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from console.atomic import replacing
from console.errors import UserError
from console.streams import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI, SAVED_DPI = 100, 150  # sizes are meant at the first; the second is for screens with fine pixels
LEFT, RIGHT, ABOVE, BELOW, LEGEND_ROW = 80, 24, 34, 50, 20  # around axes, pixels at DPI
LEGEND_LETTERS = 110  # in a row
INK, FAINT, GRID, PAPER = "#24292f", "#656d76", "#e1e4e8", "#ffffff"
COLOURS = ("#0969da", "#cf4a22", "#1a7f37", "#8250df", "#9a6700", "#bf3989", "#57606a")


@dataclass(frozen=True)
class Line:
    """xs, ys: its points. marked: a dot at each."""

    label: str
    xs: Sequence[float]
    ys: Sequence[float]
    marked: bool = False


@dataclass(frozen=True)
class Plot:
    """One pair of axes and its lines. y_axis: from zero; from the data's least; or logarithmic (positive values only)."""

    lines: Sequence[Line]
    title: str
    x_label: str
    y_label: str
    y_axis: Literal["zero", "data", "log"] = "zero"


def require_plots() -> None:
    """UserError, with the remedy, where matplotlib is not installed: for commands to ask before work, not after."""
    if importlib.util.find_spec("matplotlib") is None:
        raise UserError("drawing a plot needs matplotlib", remedy="pip install matplotlib, or 'snerg[train]'")


def draw_plots(path: Path, plots: Sequence[Plot], size: tuple[int, int] = (720, 360)) -> None:
    """Writes plots of `size` each (width, height in pixels at 100 dpi), one below the other, to a PNG.

    UserError where matplotlib is not installed, OSError where the file cannot be written.
    """
    require_plots()
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # a first start need not tell of its font cache
    from matplotlib.figure import Figure  # not pyplot, which keeps figures and may look for a display

    width, height = size
    figure = Figure((width / DPI, height * len(plots) / DPI), DPI, facecolor=PAPER)
    for number, plot in enumerate(reversed(plots)):  # matplotlib's own layout draws everything twice
        above = ABOVE + LEGEND_ROW * _legend_shape(plot.lines)[0]
        place = np.array([LEFT, number * height + BELOW, width - LEFT - RIGHT, height - BELOW - above])
        _draw(figure.add_axes(tuple(place / (np.array([width, height * len(plots)] * 2)))), plot)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        figure.savefig(new, format="png", dpi=SAVED_DPI, metadata={"Software": None})


def _draw(axes: Axes, plot: Plot) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    for i, line in enumerate(plot.lines):
        dots = "o" if line.marked or len(line.xs) == 1 else None
        axes.plot(
            line.xs, line.ys, color=COLOURS[i % len(COLOURS)], label=printable(line.label), marker=dots, markersize=5,
            linewidth=1.8 if dots else 1.2,
        )  # fmt: skip
    if plot.y_axis == "log":
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.ticklabel_format(axis="y", style="plain", useOffset=False)  # no power of ten above, where the legend is
    if plot.y_axis == "zero":
        axes.set_ylim(bottom=0, top=max(axes.get_ylim()[1], 1e-9))
    xs = [x for line in plot.lines for x in line.xs]
    if xs and 0 <= min(xs) < 0.35 * max(xs):
        axes.set_xlim(left=0)
    axes.set_xlabel(plot.x_label, color=FAINT, fontsize=9)
    axes.set_ylabel(plot.y_label, color=FAINT, fontsize=9)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8.5, labelcolor=FAINT, color=FAINT, which="major")
    axes.tick_params(axis="y", length=0, which="both")
    axes.spines[["top", "left", "right"]].set_visible(False)
    axes.spines["bottom"].set_color(FAINT)
    rows, columns = _legend_shape(plot.lines)
    pad = 8 + (2 + 14 * rows if rows else 0)
    axes.set_title(printable(plot.title), loc="left", parse_math=False, color=INK, fontsize=11, pad=pad)
    if rows:
        legend = axes.legend(
            loc="lower left", bbox_to_anchor=(0, 1), ncols=columns, borderaxespad=0.6, borderpad=0, handlelength=1.4,
            columnspacing=1.4, frameon=False, fontsize=8.5, labelcolor=INK,
        )  # fmt: skip
        for text in legend.get_texts():
            text.set_parse_math(False)  # a dollar in a name is a dollar


def _legend_shape(lines: Sequence[Line]) -> tuple[int, int]:
    """Rows and columns; no rows where nothing needs telling."""
    if len(lines) < 2:
        return 0, 1
    widest = max(len(line.label) for line in lines)
    columns = min(len(lines), max(LEGEND_LETTERS // (widest + 6), 1))
    return -(-len(lines) // columns), columns
