"""A measurement as JSON, as a terminal's table, as Markdown, and as a plot of frame times; all from the same figures."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from console.plots import Line, Plot, draw_plots
from viewer.benchmark.frames import Measurement, Photographs

ORBITS = {"paper": "the paper's", "content": "around the content", "given": "as given"}
HEADINGS = ("", "ms mean ± std", "p50", "p95", "p99", "FPS", "p50 / ours", "GPU MiB")


def figures(
    measurement: Measurement, photographs: Photographs | None = None, *, systems: bool = False
) -> dict[str, Any]:
    """The measured part of the JSON that docs/commands.md promises. photographs: what `measurement.photographs` is of.

    systems: the contenders are two packs, each with a marcher of its own.
    """
    ours, *others = measurement.contenders
    first = ours.statistics()
    result: dict[str, Any] = {
        **first,
        "gpu_bytes": measurement.gpu_bytes[ours.name],
        "watts": measurement.watts,
        "fps_per_watt": None if measurement.watts is None else first["fps"] / measurement.watts,
    }
    shown = measurement.photographs
    if photographs is not None:
        views = photographs.scene.splits[photographs.split]
        result["photographs"] = {
            "scene": str(photographs.scene.path),
            "split": photographs.split,
            "views": len(views),
            "width": views[0].camera.width,
            "height": views[0].camera.height,
            "psnr": shown[ours.name],
        }
    for other in others:
        statistics = {**other.statistics(), "gpu_bytes": measurement.gpu_bytes[other.name]}
        if systems:
            result["against"] = {
                "systems": [ours.name, other.name],
                **statistics,
                **other.ratio_to(ours),
                "psnr": shown.get(other.name),
            }
        elif other.name == "paper":
            psnr = measurement.psnr["paper"]
            psnr = psnr if isfinite(psnr) else None  # JSON knows no infinity
            result["compare"] = {"paper": statistics, **other.ratio_to(ours), "psnr": psnr}
        else:
            result.setdefault("ablations", {})[other.name] = statistics
    return result


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
    """What was measured: size, frames, protocol, distance of the orbit."""
    orbit = ""
    if result["distance"] is not None:
        orbit = f", orbit at {result['distance']:.4g} ({ORBITS[result['distance_from']]})"
    return f"{result['width']}x{result['height']}, {result['frames']} frames, {result['protocol']}, {result['fov']:g}°{orbit}"


def notes(result: Mapping[str, Any], measurement: Measurement) -> list[str]:
    """The lines below the table: device and clock, power, comparison."""
    grid = " x ".join(map(str, measurement.grid_size)) + " voxels"
    halved = ", at reduced resolution" if result["halved"] else ""
    lines = [f"{measurement.renderer}; {measurement.clock}; {grid}{halved}"]
    if measurement.watts is not None:
        lines.append(f"{measurement.watts:.1f} W, {result['fps'] / measurement.watts:.3f} FPS/W")
    if "compare" in result:
        psnr = measurement.psnr["paper"]
        lines.append(f"exact is {_times(result['compare'])} as fast as paper; PSNR between them {psnr:.1f} dB")
    if "against" in result:
        ours, theirs = result["against"]["systems"]
        lines.append(f"{ours} is {_times(result['against'])} as fast as {theirs}")
    if "photographs" in result:
        about = result["photographs"]
        scores = ", ".join(f"{name} {value:.2f} dB" for name, value in measurement.photographs.items())
        lines.append(f"PSNR against {about['views']} photographs ({about['width']}x{about['height']}): {scores}")
    return lines


def _times(compared: Mapping[str, Any]) -> str:
    """A ratio with its spread over pairs of frames."""
    low, high = compared["ratio_p5"], compared["ratio_p95"]
    return f"{compared['ratio']:.2f} times ({low:.2f} to {high:.2f} frame by frame)"


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
