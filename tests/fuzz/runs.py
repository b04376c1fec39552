"""Runs: config.json, checkpoints, journals; what is spoilt, and all that going on with one does before its first step."""

import shutil
from pathlib import Path

import jax
import numpy as np

from tests.stored_runs import SCENE, STORED
from training.commands.train import FREE, changed_settings
from training.recorder import Recorder, draw_curves, read_metrics
from training.run import read_description, resume_run

BASES = ("nerf", "multires")


def write_base(name: str, folder: Path) -> None:
    """A run of an older version, with two checkpoints."""
    shutil.copytree(STORED / name, folder)
    newest = max((folder / "checkpoints").glob("*.safetensors"))
    shutil.copy(newest, newest.with_name("step_00000300.safetensors"))


def open_it(path: Path, base: str) -> None:
    """Reads it as `snerg-train --resume`, `snerg-bake` and the viewer's plots do; makes one step where it is as configured."""
    description = read_description(path)
    moved = description.scene == read_description(STORED / base).scene
    run = resume_run(path, description, SCENE if moved else description.scene, description.config)
    recorder = Recorder(run)
    if not np.isfinite([recorder.seconds, recorder.training_seconds]).all():
        raise AssertionError("the run took no time that could be told")
    if recorder.records != read_metrics(STORED / base / "metrics.jsonl"):
        draw_curves(recorder.records, path / "curves.png", "fuzz")
    changed = changed_settings(read_description(STORED / base).config, description.config, leave_out=FREE)
    if base == "multires" and not changed:
        # A state that makes no sense would break compiled loops, which check no index. Arrays of the other method are compared
        # one by one with what they must be.
        run.method.may_hold(run.state, np.zeros((1, 3)), np.ones((1, 3)))
        state, metrics = run.method.step(run.state, run.step + 1, 0.5)
        jax.block_until_ready(metrics)
        run.method.save(state)
