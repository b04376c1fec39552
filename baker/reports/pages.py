"""A report as Markdown, and its plots: what baker.reports.tables measured, for people to read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from baker.reports.codec_report import as_markdown
from console.plots import Line, Plot, draw_plots
from console.progress import duration

Table = Mapping[str, Any]
ALPHA_BINS = 16
RUNGS = {
    "field": "the trained field itself",
    "none": "baked, not fine-tuned",
    "view-mlp": "view MLP fine-tuned (the paper's)",
    "all": "voxels and view MLP fine-tuned",
}


def report_text(document: Mapping[str, Any]) -> str:
    """report.md: a section for each table that was made, in the order of SECTIONS."""
    about = document["about"]
    lines = [
        f"# {Path(about['run']).name}",
        "",
        f"{about['run']}, {about['step']} steps on {about['scene']}. Scores are means of {about['views']} {about['split']} "
        f"photographs of {about['width']} x {about['height']} pixels; packs are drawn by the OpenGL renderer. MB are 10⁶ bytes.",
    ]
    for name, (title, section) in SECTIONS.items():
        if name in document["tables"]:
            lines += ["", f"## {title}", "", *section(document["tables"][name])]
    return "\n".join(lines) + "\n"


def draw_report_plots(out: Path, tables: Mapping[str, Table]) -> None:
    """resolution.png, codecs.png and sparsity.png, of the tables that are there."""
    if "resolution" in tables:
        rows = tables["resolution"]["rows"]
        x_label = "voxels along the longest side"
        psnr, megabytes, ms = (
            [_over(rows, "resolution", "", value)]
            for value in (lambda r: r["psnr"], lambda r: r["bytes"] / 1e6, lambda r: r["ms_p50"])
        )
        plots = [
            Plot(psnr, "Quality and resolution", x_label, "PSNR (dB)", "data"),
            Plot(megabytes, "Size and resolution", x_label, "MB on disk"),
            Plot(ms, "Frame time and resolution (exact, p50)", x_label, "milliseconds"),
        ]
        draw_plots(out / "resolution.png", plots, (720, 270))
    if "codecs" in tables:
        rows = [row | {"mb": row["bytes"] / 1e6} for row in tables["codecs"]["rows"]]
        names = dict.fromkeys(row["codec"] for row in rows)
        lines = [_over([r for r in rows if r["codec"] == n], "mb", n, lambda r: r["psnr"]) for n in names]
        draw_plots(out / "codecs.png", [Plot(lines, "Quality and size, by codec", "MB on disk", "PSNR (dB)", "data")])
    if "sparsity" in tables:
        lines = []
        for row in tables["sparsity"]["rows"]:
            share = alpha_shares(row["alpha_histogram"], row["voxels"]["stored"])
            lines.append(Line(row["label"], [(i + 0.5) / ALPHA_BINS for i in range(ALPHA_BINS)], share, marked=True))
        draw_plots(out / "sparsity.png", [
            Plot(lines, "Opacity of stored voxels (alpha 0 left out)", "alpha", "% of stored voxels", "zero")
        ])  # fmt: skip


def alpha_shares(histogram: Sequence[int], stored: int) -> list[float]:
    """Percent of the stored voxels whose alpha (1 … 255 of 255) is in each of ALPHA_BINS equal ranges."""
    counts = np.concatenate([[0], np.asarray(histogram)]).reshape(ALPHA_BINS, -1).sum(1)
    return (100 * counts / max(stored, 1)).tolist()


def _over(rows: Iterable[Mapping[str, Any]], key: str, label: str, value: Callable[[Any], float]) -> Line:
    points = sorted((float(row[key]), float(value(row))) for row in rows)
    return Line(label, [x for x, _ in points], [y for _, y in points], marked=True)


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(headings)} |", "| --- |" + " ---: |" * (len(headings) - 1)]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows)]


def _scores(row: Mapping[str, Any]) -> list[str]:
    lpips = "–" if row["lpips"] is None else f"{row['lpips']:.4f}"
    return [f"{row['psnr']:.2f}", f"{row['ssim']:.4f}", lpips]


def _mb(count: int | None) -> str:
    return "" if count is None else f"{count / 1e6:.2f}"


def _ladder(table: Table) -> list[str]:
    headings = ["", "PSNR (dB)", "SSIM", "LPIPS", "against the field (dB)", "MB", "time"]
    rows, field = table["rows"], table["rows"][0]["psnr"]
    cells = []
    for row in rows:
        gap = "" if row["of"] == "field" else f"{row['psnr'] - field:+.2f}"
        took = "" if row["seconds"] is None else duration(row["seconds"])
        cells.append([RUNGS[row["of"]], *_scores(row), gap, _mb(row["bytes"]), took])
    lines = [f"Baked at {table['resolution']} voxels along the longest side.", "", *_table(headings, cells), ""]
    lines += ["Time is of training for the field, of baking for the packs.", ""]
    for row in rows:
        caption = f"{RUNGS[row['of']]}: picture, photograph, five times their difference"
        lines += [f"![{caption}]({row['picture']})", "", f"{caption[0].upper()}{caption[1:]}.", ""]
    return lines[:-1]


def _resolution(table: Table) -> list[str]:
    headings = [
        "voxels",
        "grid",
        "PSNR (dB)",
        "SSIM",
        "LPIPS",
        "MB",
        "macroblocks",
        "GPU MB",
        "p50 of exact (ms)",
        "bake",
    ]
    cells = [
        [str(row["resolution"]), " x ".join(map(str, row["grid"])), *_scores(row), _mb(row["bytes"]),
         str(row["macroblocks"]), _mb(row["gpu_bytes"]), f"{row['ms_p50']:.1f}", duration(row["seconds"])]
        for row in table["rows"]
    ]  # fmt: skip
    return [
        *_table(headings, cells),
        "",
        f"Frame times: {table['renderer']}; {table['clock']}; {table['width']} x {table['height']} pixels, path "
        f"{table['protocol']}, {table['frames']} frames, each drawn from every pack in turn.",
        *(f"Note: {notice}." for notice in table["notices"]),
        "",
        "![Quality, size and frame time over the resolution](resolution.png)",
    ]


def _codecs(table: Table) -> list[str]:
    about = f"The pack at {table['resolution']} voxels, view MLP fine-tuned."
    return [about, "", as_markdown(table["rows"]), "", "![PSNR over megabytes, by codec](codecs.png)"]


def _sparsity(table: Table) -> list[str]:
    headings = ["run", "lambda", "steps", "PSNR (dB)", "SSIM", "LPIPS", "MB", "macroblocks", "voxels with alpha"]
    cells = []
    for row in table["rows"]:
        blocks, voxels = row["macroblocks"], row["voxels"]
        cells.append([
            Path(row["run"]).name, f"{row['sparsity_weight']:g}", str(row["step"]), *_scores(row), _mb(row["bytes"]),
            f"{blocks['occupied']} of {blocks['grid']}", f"{voxels['with_alpha']} of {voxels['grid']}",
        ])  # fmt: skip
    lines = [
        f"Baked at {table['resolution']} voxels with --tau-weight 0, as the paper bakes: otherwise voxels that no "
        "photograph shows are emptied, and with them the fog that a field trained without the loss leaves.",
        "",
        *_table(headings, cells),
        "",
        "![Opacity of stored voxels](sparsity.png)",
        "",
    ]
    if len(table["rows"]) == 1:
        lines += [
            "To compare: train with `--preset no-sparsity`, or `--sparsity-weight 0`, and give that run by `--against`."
        ]
        lines.append("")
    lines += ["Cross-sections through the middle: above, opacity (ink is the square root of alpha, so that fog is seen; "
              "stored macroblocks are blue); below, diffuse colours over white.", ""]  # fmt: skip
    for cut in table["sections"]:
        told = "; ".join(
            f"{label}: {100 * s['opaque']:.2f} % opaque, {100 * s['with_alpha']:.2f} % with alpha, "
            f"{100 * s['stored']:.1f} % in stored macroblocks"
            for label, s in cut["shares"].items()
        )
        lines += [f"Across {cut['axis']} at {cut['at']:.3g}. {told}.", ""]
        lines += [f"![Cross-section across {cut['axis']}]({cut['picture']})", ""]
    return lines[:-1]


SECTIONS: Mapping[str, tuple[str, Callable[[Table], list[str]]]] = {
    "ladder": ("Quality: field, baked, fine-tuned", _ladder),
    "resolution": ("Resolution", _resolution),
    "codecs": ("Storage: codecs", _codecs),
    "sparsity": ("Sparsity loss", _sparsity),
}
