"""The training loop: one Method, step by step, with a journal, validation pictures and checkpoints.

Randomness comes from (seed, step) alone, so a run that was stopped and resumed repeats the losses of an
unbroken one.
"""

from __future__ import annotations

import math
import shlex
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from console import UserError, progress
from training.allocator import keep_freed_memory
from training.checkpoints import cannot_write, list_checkpoints, write_checkpoint
from training.config import TrainConfig
from training.interrupt import interruptible
from training.journal import Journal
from training.run import Run, resume_run, start_run
from training.scenes import SceneOptions
from training.validation import validate, validation_photograph

VALIDATION_PIXELS = 200 * 200  # a validation picture should cost seconds, not minutes


def train(
    scene_path: str | Path,
    out: str | Path,
    config: TrainConfig,
    *,
    downscale: int = 1,
    spherify: bool | None = None,
    masks: bool = False,
    resume: bool = False,
) -> Run:
    """Trains into the folder `out` until config.steps, and returns the finished run.

    resume: go on from the newest checkpoint in `out` (the scene is read as it was then). Ctrl-C saves a
    checkpoint and raises KeyboardInterrupt that says how to go on. UserError for bad scenes, divergence, a
    full disk, and for an `out` that exists already.
    """
    keep_freed_memory()
    scene_path, out = Path(scene_path), Path(out)
    options = SceneOptions(downscale, spherify, masks)
    run = resume_run(out, scene_path, config) if resume else start_run(out, scene_path, config, options)
    journal = Journal(run.path / "metrics.jsonl", run.step)
    photograph = validation_photograph(run.scene)
    clock = _Clock(journal.seconds, config.batch_size)

    with interruptible() as asked_to_stop, progress("training", config.steps - run.step) as bar:
        first = run.step
        for step in range(run.step, config.steps):
            run.state, metrics = run.method.step(run.state, step)
            run.step = step + 1
            out_of_time = 0 < config.minutes * 60 <= clock.seconds
            stopping = asked_to_stop()  # once a step, so that what is raised below was saved above
            last = run.step == config.steps or out_of_time or stopping

            if last or run.step % config.log_every == 0:
                bar.update(run.step - first, _log(run, metrics, clock, journal))
            if last or run.step % config.checkpoint_every == 0:
                _checkpoint(run)
            pictured = config.validate_every and run.step % config.validate_every == 0
            if (last or pictured) and not stopping:
                _validate(run, photograph, clock, journal)
            if stopping and run.step < config.steps:
                raise KeyboardInterrupt(f"saved at step {run.step}; continue with: {how_to_resume(run)}")
            if out_of_time:
                break
    return run


def how_to_resume(run: Run) -> str:
    """The command line that goes on with a run."""
    return f"snerg-train {shlex.quote(str(run.scene.path))} --out {shlex.quote(str(run.path))} --resume"


class _Clock:
    """Seconds of training so far, over all sittings, and rays per second since the last asking."""

    def __init__(self, seconds_before: float, batch_size: int) -> None:
        self._start = time.monotonic() - seconds_before
        self._batch_size = batch_size
        self._mark, self._marked_step = time.monotonic(), None

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._start

    def rays_per_second(self, step: int) -> float | None:
        now = time.monotonic()
        rate = None
        if self._marked_step is not None:  # the first stretch holds the compilation
            rate = (step - self._marked_step) * self._batch_size / max(now - self._mark, 1e-9)
        self._mark, self._marked_step = now, step
        return rate


def _log(run: Run, metrics: dict[str, Any], clock: _Clock, journal: Journal) -> str:
    """Writes a line of the journal; returns the few figures that progress shows."""
    values = {name: float(value) for name, value in jax.device_get(metrics).items()}
    _refuse_divergence(run, values["loss"])
    rate = clock.rays_per_second(run.step)
    record = {"step": run.step, "seconds": round(clock.seconds, 3), **values}
    if rate is not None:
        record["rays_per_second"] = round(rate, 1)
    journal.write(record)
    speed = f"  {rate / 1000:.1f}k rays/s" if rate else ""
    return f"PSNR {values['psnr']:.2f} dB{speed}"


def _checkpoint(run: Run) -> None:
    arrays = run.method.save(run.state)
    if any(np.issubdtype(array.dtype, np.floating) and np.isnan(array).any() for array in arrays.values()):
        _refuse_divergence(run, math.nan)
    write_checkpoint(run.checkpoints, run.step, arrays)


def _validate(run: Run, photograph: Any, clock: _Clock, journal: Journal) -> None:
    picture = run.path / "validation" / f"step_{run.step:08d}.png"
    try:
        score = validate(run.method, run.state, run.dataset, photograph, picture, VALIDATION_PIXELS)
    except OSError as error:
        raise cannot_write(picture, error) from error
    journal.write(
        {
            "step": run.step,
            "seconds": round(clock.seconds, 3),
            "validation_psnr": score,
            "view": photograph.name,
        }
    )
    clock.rays_per_second(run.step)  # the picture's time is not the steps'


def _refuse_divergence(run: Run, loss: float) -> None:
    if math.isfinite(loss):
        return
    saved = list_checkpoints(run.checkpoints)
    good = f"the last good checkpoint is of step {saved[-1][0]}" if saved else "no checkpoint was saved before"
    raise UserError(
        f"training diverged at step {run.step}: the loss is no finite number; {good}",
        where=run.path,
        remedy="train again with a lower learning rate or another --seed",
    )
