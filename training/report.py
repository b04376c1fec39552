"""The report of a finished run, in its folder report/: report.md, report.json, and pictures beside them.

report.json: {"scene", "step", "steps", "seconds", "training_seconds", "psnr" and "loss" (of the last logged batch),
"validation" [{"step", "seconds", "psnr"}], "best_validation_psnr", "rays_per_second" (median), "config", "provenance"}.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from console.atomic import write_file
from console.progress import duration
from training.checkpoints import cannot_write
from training.config import to_json
from training.curves import draw_psnr_over_minutes, series
from training.run import Run

Records = Sequence[Mapping[str, Any]]


def write_report(run: Run, records: Records) -> Path:
    """Writes the folder and returns report.md. UserError where the disk is full."""
    folder = run.path / "report"
    figures = report_figures(run, records)
    try:
        folder.mkdir(exist_ok=True)
        write_file(folder / "report.json", json.dumps(figures, indent=2) + "\n")
        if figures["validation"]:
            draw_psnr_over_minutes(
                {"held out": records}, folder / "psnr-minutes.png", f"{run.scene.path.name}: PSNR against minutes"
            )
        for source in (run.path / "curves.png", run.path / "validation" / "latest.png"):
            if source.is_file():
                shutil.copyfile(source, folder / source.name)
        write_file(folder / "report.md", report_text(run, figures, folder))
    except OSError as error:
        raise cannot_write(folder, error) from error
    return folder / "report.md"


def report_figures(run: Run, records: Records) -> dict[str, Any]:
    """What report.json holds."""
    batches = [r for r in records if "loss" in r]
    validation = [
        {"step": r["step"], "seconds": r.get("training_seconds", r["seconds"]), "psnr": r["validation_psnr"]}
        for r in records
        if "validation_psnr" in r
    ]
    speeds = series(records, "rays_per_second")[1]
    last: Mapping[str, Any] = batches[-1] if batches else {}
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
        "config": to_json(run.config),
        "provenance": run.description.provenance,
    }


def report_text(run: Run, figures: Mapping[str, Any], folder: Path) -> str:
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
    captions = {
        "latest.png": "Photograph and rendering, side by side.",
        "psnr-minutes.png": "PSNR of held-out photographs against minutes.",
        "curves.png": "Curves over the steps.",
    }
    for name, caption in captions.items():
        if (folder / name).is_file():
            lines += [f"![{caption}]({name})", ""]
    return "\n".join(lines)
