"""Plots as small PNGs, drawn with Pillow: lines over x and y, axes with round numbers, labels and a legend.

Here because the trainer and the viewer, which may not import one another, both draw them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, log10
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from console.atomic import replacing

OVERSAMPLED = 3  # drawn larger, then shrunk: Pillow's lines are jagged
LEFT, RIGHT, TOP, BOTTOM = 62, 20, 58, 48  # margins, pixels
INK, FAINT, GRID, PAPER = (36, 41, 47), (101, 109, 118), (225, 228, 232), (255, 255, 255)
COLOURS = ((9, 105, 218), (207, 74, 34), (26, 127, 55), (130, 80, 223), (154, 103, 0), (191, 57, 137), (87, 96, 106))


@dataclass(frozen=True)
class Line:
    """xs, ys: its points. marked: a dot at each. levels: (text, y) of dashed horizontal lines in its colour."""

    label: str
    xs: Sequence[float]
    ys: Sequence[float]
    marked: bool = False
    levels: Sequence[tuple[str, float]] = ()


def round_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """At most `most` + 1 multiples of 1, 2 or 5 times a power of ten within low … high."""
    span = max(high - low, 1e-12)
    power = 10.0 ** floor(log10(span / most))
    step = next(factor * power for factor in (1, 2, 5, 10, 20) if span / (factor * power) <= most)
    return [i * step for i in range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)]


@dataclass(frozen=True)
class Plot:
    """One pair of axes and its lines. y_axis: from zero; from the data's least; or logarithmic (positive values only)."""

    lines: Sequence[Line]
    title: str
    x_label: str
    y_label: str
    y_axis: Literal["zero", "data", "log"] = "zero"


def draw_plot(
    path: Path, lines: Sequence[Line], title: str, x_label: str, y_label: str, size: tuple[int, int] = (720, 360)
) -> None:
    """Writes a plot of `size` (width, height in pixels) to a PNG, aside first. Both axes are linear, y from zero."""
    draw_plots(path, [Plot(lines, title, x_label, y_label)], size)


def draw_plots(path: Path, plots: Sequence[Plot], size: tuple[int, int] = (720, 360)) -> None:
    """Writes plots of `size` each, one below the other, to a PNG, aside first."""
    sheet = Image.new("RGB", (size[0], size[1] * len(plots)), PAPER)
    for i, plot in enumerate(plots):
        sheet.paste(_Drawing(plot, size).finished(), (0, i * size[1]))
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        sheet.quantize(128).save(new, format="PNG", optimize=True)


class _Drawing:
    """Everything in pixels of the finished picture, multiplied by OVERSAMPLED when it is drawn."""

    def __init__(self, plot: Plot, size: tuple[int, int]) -> None:
        self.plot, self.lines, self.size = plot, plot.lines, size
        xs = [x for line in plot.lines for x in line.xs] or [0.0]
        ys = [y for line in plot.lines for y in (*line.ys, *(level for _, level in line.levels))] or [1.0]
        self.x0, self.x1 = (min(xs), max(xs)) if min(xs) < max(xs) else (min(xs) - 0.5, max(xs) + 0.5)
        if self.x0 < 0.35 * self.x1:
            self.x0 = min(self.x0, 0.0)
        if plot.y_axis == "log":
            self.y0, self.y1 = 0.9 * max(min(ys), 1e-12), 1.1 * max(ys)
        elif plot.y_axis == "data":
            room = 0.06 * max(max(ys) - min(ys), 1e-9)
            self.y0, self.y1 = min(ys) - room, max(ys) + room
        else:
            self.y0, self.y1 = 0.0, max(1.08 * max(ys), 1e-9)
        self.image = Image.new("RGB", (size[0] * OVERSAMPLED, size[1] * OVERSAMPLED), PAPER)
        self.pen = ImageDraw.Draw(self.image)

    def at(self, x: float, y: float) -> tuple[float, float]:
        width, height = self.size
        across = (x - self.x0) / (self.x1 - self.x0)
        if self.plot.y_axis == "log":
            up = log10(max(y, 1e-12) / self.y0) / log10(self.y1 / self.y0)
        else:
            up = (y - self.y0) / (self.y1 - self.y0)
        return LEFT + across * (width - LEFT - RIGHT), height - BOTTOM - up * (height - TOP - BOTTOM)

    def line(self, points: Sequence[tuple[float, float]], colour: tuple[int, int, int], width: float) -> None:
        scaled = [(OVERSAMPLED * x, OVERSAMPLED * y) for x, y in points]
        self.pen.line(scaled, fill=colour, width=max(1, round(OVERSAMPLED * width)), joint="curve")

    def text(self, x: float, y: float, text: str, anchor: str, colour=FAINT, points: float = 11.5) -> float:
        """Returns the text's width in pixels."""
        font = ImageFont.load_default(points * OVERSAMPLED)
        self.pen.text((OVERSAMPLED * x, OVERSAMPLED * y), text, fill=colour, font=font, anchor=anchor)
        return self.pen.textlength(text, font=font) / OVERSAMPLED

    def finished(self) -> Image.Image:
        width, height = self.size
        self._axes(self.plot.x_label, self.plot.y_label)
        self.text(LEFT, 14, self.plot.title, "lm", INK, 14)
        for i, line in enumerate(self.lines):
            self._curve(line, COLOURS[i % len(COLOURS)])
        if len(self.lines) > 1:
            font = ImageFont.load_default(11.5 * OVERSAMPLED)
            x, y = float(LEFT), 33.0
            for i, line in enumerate(self.lines):
                if x > LEFT and x + 24 + self.pen.textlength(line.label, font=font) / OVERSAMPLED > width - RIGHT:
                    x, y = float(LEFT), y + 15
                self.line([(x, y), (x + 18, y)], COLOURS[i % len(COLOURS)], 2.4)
                x += 24 + self.text(x + 24, y, line.label, "lm", INK) + 16
        return self.image.resize((width, height), Image.Resampling.LANCZOS)

    def _axes(self, x_label: str, y_label: str) -> None:
        width, height = self.size
        for tick in self._y_ticks():
            _, y = self.at(self.x0, tick)
            self.line([(LEFT, y), (width - RIGHT, y)], GRID, 1)
            self.text(LEFT - 8, y, f"{tick:g}", "rm")
        bottom = height - BOTTOM
        for tick in round_ticks(self.x0, self.x1, 10):
            x, _ = self.at(tick, self.y1)
            self.line([(x, bottom), (x, bottom + 4)], FAINT, 1)
            self.text(x, bottom + 8, f"{tick:g}", "mt")
        self.line([(LEFT, bottom), (width - RIGHT, bottom)], FAINT, 1)
        self.text((LEFT + width - RIGHT) / 2, height - 8, x_label, "mb")
        self._upright(y_label)

    def _y_ticks(self) -> list[float]:
        if self.plot.y_axis != "log":
            return round_ticks(self.y0, self.y1)
        powers = range(floor(log10(self.y0)), ceil(log10(self.y1)) + 1)
        factors = (1, 2, 5) if len(powers) <= 4 else (1,)
        ticks = [factor * 10.0**power for power in powers for factor in factors]
        return [tick for tick in ticks if self.y0 <= tick <= self.y1]

    def _upright(self, text: str) -> None:
        """The y axis's label, turned to run upwards along the left edge."""
        font = ImageFont.load_default(11.5 * OVERSAMPLED)
        label = Image.new("RGB", (round(self.pen.textlength(text, font=font)) + 4, 16 * OVERSAMPLED), PAPER)
        ImageDraw.Draw(label).text((2, label.height / 2), text, fill=FAINT, font=font, anchor="lm")
        label = label.rotate(90, expand=True)
        middle = (TOP + self.size[1] - BOTTOM) / 2 * OVERSAMPLED
        self.image.paste(label, (4 * OVERSAMPLED, round(middle - label.height / 2)))

    def _curve(self, line: Line, colour: tuple[int, int, int]) -> None:
        points = [self.at(x, y) for x, y in zip(line.xs, line.ys, strict=True)]
        light = tuple(int(255 - 0.55 * (255 - c)) for c in colour)
        right = self.size[0] - RIGHT
        for i, (text, level) in enumerate(line.levels):
            _, y = self.at(self.x0, level)
            for x in np.arange(LEFT, right, 9):
                self.line([(float(x), y), (min(float(x) + 5, right), y)], light, 1.2)  # type: ignore[arg-type]
            self.text(right - 4 - 110 * (len(line.levels) - 1 - i), y - 3, text, "rb", colour)
        if len(points) > 1:
            self.line(points, colour, 1.6 if not line.marked else 2.4)
        if line.marked or len(points) == 1:
            for x, y in points:
                box = [
                    OVERSAMPLED * (x - 3.6),
                    OVERSAMPLED * (y - 3.6),
                    OVERSAMPLED * (x + 3.6),
                    OVERSAMPLED * (y + 3.6),
                ]
                self.pen.ellipse(box, fill=colour)
