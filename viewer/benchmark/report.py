"""A measurement as a terminal's table, as Markdown, and as a plot of frame times; all from the same rows."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from console.plots import Line, Plot, draw_plots
from viewer.benchmark.frames import Measurement

HEADINGS = ("", "ms mean ± std", "p50", "p95", "p99", "FPS", "p50 / ours", "GPU MiB")


def rows(measurement: Measurement) -> list[tuple[str, ...]]:
    """A row for each contender, under HEADINGS."""
    base = measurement.contenders[0].statistics()["ms_p50"]
    table = []
    for contender in measurement.contenders:
        s = contender.statistics()
        times = (f"{s[key]:.2f}" for key in ("ms_p50", "ms_p95", "ms_p99"))
        mebibytes = f"{measurement.gpu_bytes[contender.name] / 2**20:.1f}"
        spread = f"{s['ms_mean']:.2f} ± {s['ms_std']:.2f}"
        table.append((contender.name, spread, *times, f"{s['fps']:.1f}", f"{s['ms_p50'] / base:.2f}", mebibytes))
    return table


def title(result: Mapping[str, Any]) -> str:
    """What was measured: size, frames, protocol."""
    return f"{result['width']}x{result['height']}, {result['frames']} frames, {result['protocol']}, {result['fov']:g}°"


def notes(result: Mapping[str, Any], measurement: Measurement) -> list[str]:
    """The lines below the table: device and clock, power, comparison."""
    grid = " x ".join(map(str, measurement.grid_size)) + " voxels"
    halved = ", at reduced resolution" if result["halved"] else ""
    lines = [f"{measurement.renderer}; {measurement.clock}; {grid}{halved}"]
    if measurement.watts is not None:
        lines.append(f"{measurement.watts:.1f} W, {result['fps'] / measurement.watts:.3f} FPS/W")
    if "compare" in result:
        ratio, psnr = result["compare"]["ratio"], measurement.psnr["paper"]
        lines.append(f"exact is {ratio:.2f} times as fast as paper; PSNR between them {psnr:.1f} dB")
    return lines


def print_table(result: Mapping[str, Any], measurement: Measurement) -> None:
    """Prints the table and its notes on stdout."""
    table = Table(title=title(result))
    for i, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="right" if i else "left")
    for row in rows(measurement):
        table.add_row(*row)
    console = Console(width=None if sys.stdout.isatty() else 120)
    console.print(table)
    for line in notes(result, measurement):
        console.print(line, highlight=False)


def markdown(name: str, result: Mapping[str, Any], measurement: Measurement) -> str:
    """The same as Markdown text. name: of the pack."""
    lines = [f"**{name}**, {title(result)}", "", f"| {' | '.join(HEADINGS)} |"]
    lines.append("| --- |" + " ---: |" * (len(HEADINGS) - 1))
    lines += [f"| {' | '.join(row)} |" for row in rows(measurement)]
    return "\n".join([*lines, "", *(f"{line}  " for line in notes(result, measurement))]) + "\n"


def plot(path: Path, name: str, result: Mapping[str, Any], measurement: Measurement) -> None:
    """A PNG of each frame's time, with p50 and p95 as dashed lines."""
    lines = []
    for contender in measurement.contenders:
        s = contender.statistics()
        levels = [(f"{key} {s[f'ms_{key}']:.1f} ms", s[f"ms_{key}"]) for key in ("p50", "p95")]
        lines.append(Line(contender.name, range(len(contender.ms)), contender.ms, levels=levels))
    if len(lines) > 2:  # levels of many would hide the curves
        lines = [Line(line.label, line.xs, line.ys) for line in lines]
    draw_plots(path, [Plot(lines, f"{name}, {title(result)}", "frame", "milliseconds")])
