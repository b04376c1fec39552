"""The command lines that would make what a row of a table lacks."""

from __future__ import annotations

import shlex
from pathlib import Path

from baker.reports.fields import OWN, row_of
from training.config import PRESETS, TrainConfig
from training.run import Run


def train_command(run: Run, out: Path, preset: str, option: str) -> str:
    """How to train what a row needs, from the photographs of `run`; and with which option of the report to give it then.

    A multi-resolution field without the sparsity loss is one of the same settings but that; all else are presets of the paper's.
    """
    folder = out / "runs" / preset
    words = ["snerg-train", str(run.scene.path), "--out", str(folder), *_training(run, preset), *_reading(run)]
    return f"{shlex.join(words)}; then add {option} {shlex.quote(str(folder))}"


def _training(run: Run, preset: str) -> list[str]:
    if preset != "no-sparsity" or row_of(run.config) != OWN:
        return ["--preset", preset]
    return ["--preset", _like(run.config), "--steps", str(run.config.steps), "--sparsity-weight", "0"]


def _like(config: TrainConfig) -> str:
    """The preset whose field this is, however long it was trained; or the one that is nearest."""
    alike = [
        name for name, preset in PRESETS.items()
        if preset.method == config.method and getattr(preset, preset.method) == getattr(config, config.method)
    ]  # fmt: skip
    return alike[0] if alike else "normal" if config.method == "multires" else "small"


def _reading(run: Run) -> list[str]:
    """How the photographs are read, as options of snerg-train."""
    options, words = run.options, []
    if options.downscale != 1:
        words += ["--downscale", str(options.downscale)]
    words += ["--spherify"] if options.spherify else []
    words += ["--masks"] if options.masks else []
    if options.aabb is not None:
        words.append("--aabb=" + ",".join(f"{c:g}" for c in options.aabb))
    if options.up is not None:
        words.append("--up=" + ",".join(f"{c:g}" for c in options.up))
    return words
