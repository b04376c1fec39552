"""A run's curves over its steps, drawn from metrics.jsonl: PSNR, loss, rays per second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from console.plots import Line, Plot, draw_plots

Records = Sequence[Mapping[str, Any]]
POINTS = 400  # a picture shows no more; longer runs are averaged


def series(records: Records, name: str, over: str = "step") -> tuple[list[float], list[float]]:
    """The finite values of a name in the records, and what they lie over ("step", "seconds", "training_seconds")."""
    pairs = [(float(r[over]), float(r[name])) for r in records if name in r and over in r and np.isfinite(r[name])]
    return [x for x, _ in pairs], [y for _, y in pairs]


def thinned(xs: Sequence[float], ys: Sequence[float]) -> tuple[list[float], list[float]]:
    """At most POINTS points: means of equal numbers of neighbours."""
    if len(xs) <= POINTS:
        return list(xs), list(ys)
    parts = np.array_split(np.arange(len(xs)), POINTS)
    return [float(np.mean(np.asarray(xs)[p])) for p in parts], [float(np.mean(np.asarray(ys)[p])) for p in parts]


def draw_curves(records: Records, path: Path, title: str) -> None:
    """Writes the PNG; curves without a value yet are left out. OSError where it cannot be written."""
    plots = []
    psnr = [
        Line(label, *thinned(*series(records, name)), marked=marked)
        for label, name, marked in (("training rays", "psnr", False), ("photographs held out", "validation_psnr", True))
    ]
    psnr = [line for line in psnr if line.xs]
    if psnr:
        plots.append(Plot(psnr, title, "steps", "PSNR (dB)", "data"))
    axes: tuple[tuple[str, str, Literal["log", "zero"]], ...] = (
        ("loss", "loss", "log"),
        ("rays per second", "rays_per_second", "zero"),
    )
    for label, name, axis in axes:
        xs, ys = series(records, name)
        if axis == "log":
            xs, ys = [x for x, y in zip(xs, ys, strict=True) if y > 0], [y for y in ys if y > 0]
        if xs:
            plots.append(Plot([Line(label, *thinned(xs, ys))], label, "steps", label, axis))
    if plots:
        draw_plots(path, plots, (720, 270))


def draw_psnr_over_minutes(runs: Mapping[str, Records], path: Path, title: str) -> None:
    """Validation PSNR against minutes of training (validation itself not counted), one line a run."""
    lines = []
    for label, records in runs.items():
        seconds, values = series(records, "validation_psnr", "training_seconds")
        lines.append(Line(label, [s / 60 for s in seconds], values, marked=True))
    draw_plots(path, [Plot(lines, title, "minutes of training", "PSNR (dB)", "data")])
