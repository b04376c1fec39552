"""Report of a run: curves.png, and in the end the folder report/ with report.md, report.json and pictures.

report.json: {"scene", "step", "steps", "seconds", "training_seconds", "psnr" and "loss" (of the last logged batch),
"validation" [{"step", "seconds", "psnr"}], "best_validation_psnr", "rays_per_second" (median), "config", "provenance"}.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from console.atomic import write_file
from console.plots import Line, Plot, draw_plots
from console.progress import duration
from training.checkpoints import writing
from training.run import Run

Records = Sequence[Mapping[str, Any]]
POINTS = 400  # a picture shows no more; longer runs are averaged


def draw_curves(records: Records, path: Path, title: str) -> None:
    """PSNR, loss and rays per second over the steps as a PNG, without empty curves. OSError where it cannot be written."""
    psnr = _curve("training rays", records, "psnr")
    psnr += _curve("photographs held out", records, "validation_psnr", marked=True)
    loss = _curve("loss", [r for r in records if r.get("loss", 0.0) > 0], "loss")
    speed = _curve("rays per second", records, "rays_per_second")
    plots = [
        Plot(psnr, title, "steps", "PSNR (dB)", "data"),
        Plot(loss, "loss", "steps", "loss", "log"),
        Plot(speed, "rays per second", "steps", "rays per second", "zero"),
    ]
    if plots := [plot for plot in plots if plot.lines]:
        draw_plots(path, plots, (720, 270))


def _curve(label: str, records: Records, name: str, *, marked: bool = False) -> list[Line]:
    """At most POINTS points, means of equal numbers of neighbours; nothing where no record has a value."""
    xs, ys = (np.asarray(values) for values in _series(records, name))
    parts = np.array_split(np.arange(len(xs)), min(len(xs), POINTS)) if len(xs) else []
    return [Line(label, *([float(v[p].mean()) for p in parts] for v in (xs, ys)), marked=marked)] if parts else []


def _series(records: Records, name: str, over: str = "step") -> tuple[list[float], list[float]]:
    """x ("step" or "training_seconds") and y of the finite values under a name."""
    pairs = [(float(r[over]), float(r[name])) for r in records if name in r and over in r and np.isfinite(r[name])]
    return [x for x, _ in pairs], [y for _, y in pairs]


def write_report(run: Run, records: Records) -> None:
    """Writes the folder report/. UserError where the disk is full."""
    folder = run.path / "report"
    figures = _figures(run, records)
    with writing(folder):
        folder.mkdir(exist_ok=True)
        write_file(folder / "report.json", json.dumps(figures, indent=2) + "\n")
        if figures["validation"]:
            seconds, values = _series(records, "validation_psnr", "training_seconds")
            line = Line("held out", [s / 60 for s in seconds], values, marked=True)
            title = f"{run.scene.path.name}: PSNR against minutes"
            plot = Plot([line], title, "minutes of training", "PSNR (dB)", "data")
            draw_plots(folder / "psnr-minutes.png", [plot])
        for source in (run.path / "curves.png", run.path / "validation" / "latest.png"):
            if source.is_file():
                shutil.copyfile(source, folder / source.name)
        write_file(folder / "report.md", _text(run, figures, folder))


def _figures(run: Run, records: Records) -> dict[str, Any]:
    """What report.json holds."""
    validation = [
        {"step": r["step"], "seconds": r.get("training_seconds", r["seconds"]), "psnr": r["validation_psnr"]}
        for r in records
        if "validation_psnr" in r
    ]
    speeds = _series(records, "rays_per_second")[1]
    last: Mapping[str, Any] = next((r for r in reversed(records) if "loss" in r), {})
    return {
        "scene": str(run.scene.path),
        "step": run.step,
        "steps": run.config.steps,
        "seconds": records[-1]["seconds"] if records else 0.0,
        "training_seconds": records[-1].get("training_seconds") if records else 0.0,
        "psnr": last.get("psnr"),
        "loss": last.get("loss"),
        "validation": validation,
        "best_validation_psnr": max((v["psnr"] for v in validation), default=None),
        "rays_per_second": float(np.median(speeds)) if speeds else None,
        "config": dataclasses.asdict(run.config),
        "provenance": run.description.provenance,
    }


def _text(run: Run, figures: Mapping[str, Any], folder: Path) -> str:
    """What report.md says."""
    provenance, config = figures["provenance"], run.config
    photographs = ", ".join(f"{len(p)} {split}" for split, p in run.scene.splits.items())
    camera = run.scene.splits["train"][0].camera
    speed = figures["rays_per_second"]
    rows = [
        ("scene", f"{run.scene.path} ({run.scene.kind}; {photographs}; {camera.width} x {camera.height} pixels)"),
        ("method", f"{config.method}, seed {config.seed}"),
        ("steps", f"{figures['step']} of {figures['steps']}"),
        ("time", f"{duration(figures['seconds'])}, of which training {duration(figures['training_seconds'] or 0)}"),
        ("device", provenance.get("device", "unknown")),
        ("speed", "unknown" if speed is None else f"{speed:,.0f} rays/s (median)"),
        ("made by", f"snerg {provenance.get('snerg')}, JAX {provenance.get('jax')}, begun {provenance.get('started')}"),
    ]
    lines = [f"# {run.path.name}", "", "| | |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in rows), ""]
    if figures["validation"]:
        lines += ["## Photographs held out", "", "| step | minutes of training | PSNR (dB) |", "| --- | --- | --- |"]
        lines += [f"| {v['step']} | {v['seconds'] / 60:.2f} | {v['psnr']:.2f} |" for v in figures["validation"]]
        lines += ["", "Minutes are of training alone, without the time that validation took.", ""]
    for name, caption in (
        ("latest.png", "Photograph and rendering, side by side."),
        ("psnr-minutes.png", "PSNR of held-out photographs against minutes."),
        ("curves.png", "Curves over the steps."),
    ):
        if (folder / name).is_file():
            lines += [f"![{caption}]({name})", ""]
    return "\n".join(lines)
