"""The training loop: a Method step by step, with checkpoints and what training.recorder writes.

Randomness comes from (seed, step) alone, so a resumed run repeats the losses of an unbroken one. Of many processes
(training.devices) all run this loop alike, and process 0 writes.
"""

import math
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import jax
import numpy as np

from console import UserError, progress
from console.atomic import locked_folder
from training.checkpoints import list_checkpoints, write_checkpoint
from training.config import TrainConfig
from training.devices import agree, anywhere, is_writer, together
from training.libraries import keep_freed_memory
from training.recorder import Recorder
from training.run import Run, RunDescription, resume_run, start_run
from training.scenes import SceneOptions
from training.scenes.files import notice
from training.scenes.read import AS_IT_IS
from training.scenes.scene import few_line, split_line
from training.scenes.scene_options import box_line, box_text

AGREE_EVERY = 10  # steps between asking the other processes whether one is to stop, and process 0 for the time


def train(
    scene_path: str | Path, out: str | Path, config: TrainConfig, options: SceneOptions = AS_IT_IS, *,
    resume: RunDescription | None = None, after_step: Callable[[Run], None] | None = None,
) -> Run:  # fmt: skip
    """Trains into the folder `out` until config.steps, and returns the finished run.

    options: how the photographs are read. resume: the description of the run in `out`, to continue from its newest checkpoint,
    its photographs read as before. after_step: called after each step but the last, in a single process; it does not change the
    run, and its time is not counted as training time. Ctrl-C saves a checkpoint and raises a KeyboardInterrupt that says how to
    go on. UserError for bad scenes, divergence, a full disk, and an `out` that exists already or is being trained into.
    """
    scene_path, out = Path(scene_path), Path(out)
    with ExitStack() as held:
        with together():
            if is_writer():
                held.enter_context(locked_folder(out, "training into this run"))
        if resume is None:
            return _train(start_run(out, scene_path, config, options), after_step)
        return _train(resume_run(out, resume, scene_path, config), after_step)


def _train(run: Run, after_step: Callable[[Run], None] | None) -> Run:
    config = run.config
    if config.engine != "fused":  # whose loops keep their memory themselves, and leave the rest to the system
        keep_freed_memory()
    if is_writer():
        if line := few_line(run.scene):
            notice(run.scene.path, line)
        contracted = run.dataset.facts.contraction is not None
        for line in (split_line(run.scene), box_line(run.scene, run.options.aabb is not None, contracted)):
            if line:
                print(line, file=sys.stderr, flush=True)
    with together():
        recorder = Recorder(run)
        validated = any(r["step"] == run.step and "validation_psnr" in r for r in recorder.records)
        if run.step and _is_pictured(run) and not validated:  # killed between checkpoint and validation
            recorder.validate()

    stopping, seconds = False, float(agree(np.array(recorder.seconds)))
    shown = progress("training", config.steps, quiet=not is_writer(), begun=run.step)
    with _stop_on_signal() as asked_to_stop, shown as bar:
        if run.step < config.steps:
            bar.update(run.step, "compiling, and first steps")
        for step in range(run.step, config.steps):
            by_time = seconds / (60.0 * config.minutes) if config.minutes > 0 else 0.0
            progress_made = min(max(step / config.steps, by_time), 1.0)  # how far down the learning rates are
            run.state, metrics = run.method.step(run.state, step, progress_made)
            run.step = step + 1
            if jax.process_count() == 1 or run.step % AGREE_EVERY == 0 or run.step == config.steps:
                stopping, seconds = anywhere(asked_to_stop()), float(agree(np.array(recorder.seconds)))
            out_of_time = 0 < config.minutes * 60 <= seconds

            last = run.step == config.steps or out_of_time or stopping
            if last or run.step % config.log_every == 0:
                values = {name: float(value) for name, value in jax.device_get(metrics).items()}
                _refuse_divergence(run, values["loss"])
                _refuse_emptiness(run, values)
                values["progress"] = progress_made
                with together():
                    done = max(run.step, round(progress_made * config.steps))  # the time may end the run first
                    bar.update(done, metrics=recorder.record(values))
            if last or run.step % config.checkpoint_every == 0:
                _checkpoint(run)
            if (last or _is_pictured(run)) and not stopping:
                with together():
                    recorder.validate()
            if after_step is not None and not last and jax.process_count() == 1:
                with recorder.paused():
                    after_step(run)
            if stopping and run.step < config.steps:
                command = shlex.join(["snerg-train", str(run.scene.path), "--out", str(run.path), "--resume"])
                raise KeyboardInterrupt(f"saved at step {run.step}; continue with: {command}")
            if out_of_time:
                break
    with together():
        recorder.draw()
    return run


@contextmanager
def _stop_on_signal() -> Iterator[Callable[[], bool]]:
    """Yields a function that says whether Ctrl-C or SIGTERM asked for a stop. A second Ctrl-C stops at once, with nothing saved.

    An exception within a step could come when the old state's buffers are given away and the new state is not there.
    """
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set  # signals reach the main thread only
        return

    def ask(number: int, frame: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before[signal.SIGINT])
        print("stopping after this step (Ctrl-C again to stop at once) ...", file=sys.stderr, flush=True)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _is_pictured(run: Run) -> bool:
    """Whether the step that a run stands at ends with a validation."""
    every = run.config.validate_every
    return run.step == run.config.steps or bool(every and run.step % every == 0)


def _checkpoint(run: Run) -> None:
    with together():
        if not is_writer():
            return
        arrays = run.method.save(run.state)
        if any(np.issubdtype(array.dtype, np.floating) and np.isnan(array).any() for array in arrays.values()):
            _refuse_divergence(run, math.nan)
        write_checkpoint(run.checkpoints, run.step, arrays)


def _refuse_emptiness(run: Run, metrics: dict[str, float]) -> None:
    """UserError where no ray of a step met anything: a field without content agrees with photographs of nothing."""
    if metrics.get("samples") == 0:
        raise UserError(
            f"the field is empty after step {run.step}: no ray meets anything in it", where=run.path,
            expected="photographs that show something within the box", found=box_text(run.scene.aabb),
            remedy="check the camera poses and the masks, or name the box with --aabb",
        )  # fmt: skip


def _refuse_divergence(run: Run, loss: float) -> None:
    if math.isfinite(loss):
        return
    saved = list_checkpoints(run.checkpoints)
    good = f"the last good checkpoint is of step {saved[-1][0]}" if saved else "no checkpoint was saved before"
    raise UserError(f"training diverged at step {run.step}: the loss is not finite; {good}", where=run.path,
                    remedy="train again with a lower learning rate or another --seed")  # fmt: skip
