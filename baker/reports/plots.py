"""The plots of a report: resolution.png, storage.png and sparsity.png, of the tables that are there."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from console.plots import Line, Plot, draw_plots

ALPHA_BINS = 16


def draw_report_plots(out: Path, tables: Mapping[str, Mapping[str, Any]]) -> None:
    """Draws what there is; the paper's own figures of resolutions as a line of theirs."""
    if "resolution" in tables:
        _draw_resolution(out / "resolution.png", tables["resolution"]["rows"])
    if "storage" in tables:
        _draw_storage(out / "storage.png", tables["storage"]["rows"])
    if "sparsity" in tables:
        lines = []
        for row in tables["sparsity"]["rows"]:
            if "alpha_histogram" in row:
                share = alpha_shares(row["alpha_histogram"], row["voxels"]["stored"])
                lines.append(
                    Line(row["label"], [(i + 0.5) / ALPHA_BINS for i in range(ALPHA_BINS)], share, marked=True)
                )
        draw_plots(out / "sparsity.png", [
            Plot(lines, "Opacity of stored voxels (alpha 0 left out)", "alpha", "% of stored voxels", "zero")
        ])  # fmt: skip


def _draw_resolution(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    measured = {label: [r for r in rows if r["sparsity"] == on and "psnr" in r]
                for label, on in (("with the sparsity loss", True), ("without", False))}  # fmt: skip
    printed = [{"resolution": r["resolution"], **r["paper"]} for r in rows if r["paper"]]
    x_label = "voxels along the longest side"

    def lines(ours: Callable[[Any], float], theirs: Callable[[Any], float] | None) -> list[Line]:
        drawn = [_over(some, "resolution", label, ours) for label, some in measured.items() if some]
        return drawn + ([_over(printed, "resolution", "the paper", theirs)] if theirs and printed else [])

    plots = [
        Plot(lines(lambda r: r["psnr"], lambda r: r["psnr"]), "Quality and resolution", x_label, "PSNR (dB)", "data"),
        Plot(lines(lambda r: r["bytes"] / 1e6, lambda r: r["mb"]), "Size and resolution", x_label, "MB on disk"),
        Plot(lines(lambda r: r["ms_p50"], None), "Frame time and resolution (exact, p50)", x_label, "milliseconds"),
    ]
    draw_plots(path, plots, (720, 270))


def _draw_storage(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    measured = [{**row, "mb": row["bytes"] / 1e6} for row in rows if row.get("codec")]
    names = dict.fromkeys(row["codec"] for row in measured)
    lines = [_over([r for r in measured if r["codec"] == n], "mb", n, lambda r: r["psnr"]) for n in names]
    draw_plots(path, [Plot(lines, "Quality and size, by codec", "MB on disk", "PSNR (dB)", "data")])


def alpha_shares(histogram: Sequence[int], stored: int) -> list[float]:
    """Percent of the stored voxels whose alpha (1 … 255 of 255) is in each of ALPHA_BINS equal ranges."""
    counts = np.concatenate([[0], np.asarray(histogram)]).reshape(ALPHA_BINS, -1).sum(1)
    return (100 * counts / max(stored, 1)).tolist()


def _over(rows: Iterable[Mapping[str, Any]], key: str, label: str, value: Callable[[Any], float]) -> Line:
    points = sorted((float(row[key]), float(value(row))) for row in rows)
    return Line(label, [x for x, _ in points], [y for _, y in points], marked=True)
