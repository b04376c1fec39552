"""Where the time of one training step of the multi-resolution field goes, on the machine at hand.

    python -m tools.profile_step RUN                        (a trained run, as its newest checkpoint left it)
    python -m tools.profile_step SCENE --preset quick --steps 300   (photographs, trained that long first)

Steps are made part by part, and training goes on with them; a part's time is its median over rounds.
"""

from __future__ import annotations

import dataclasses
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from baker.reports.pages import markdown_table
from console import UserError, check_results, progress, run_command, write_json, write_result
from training.libraries import begin_libraries

if TYPE_CHECKING:
    from training.multires.state import State
    from training.run import Run

ProfiledPreset = Literal["quick", "normal", "full"]
DESCRIPTION = "Times the parts of one training step of the multi-resolution field (presets quick, normal and full)."

PARTS: Mapping[str, Mapping[str, str]] = {
    "jax": {
        "draw": "rays and their pixels, and samples where the occupancy grid is on",
        "gradient": "features, decoder, compositing, the view MLP, the losses, and all in reverse into one dense gradient",
        "adam": "the optimiser, over every row of the table",
    },
    "fused": {
        "draw": "rays and their pixels",
        "render": "samples, features, decoder, compositing, the view MLP, the losses, and all in reverse to each sample",
        "scatter": "slopes of the samples' features into those of their rows",
        "adam": "the optimiser, over the rows that were touched",
    },
}


def to_markdown(figures: Mapping[str, Any]) -> str:
    """What `profile` found as a table, below lines about what was profiled."""
    about = (
        f"{figures['scene']} after {figures['step']:,} steps: {figures['rows']:,} rows of features, {figures['rays']:,} rays a "
        f"step. {figures['rounds']} rounds on {figures['device']}; medians. Shares are of {figures['shares_of']} time."
    )
    speed = (
        f"Engine {figures['engine']}: {figures['threads']} threads, {figures['samples']:,} samples a step; a step takes "
        f"{figures['step_ms']:.1f} ms and {figures['cpu_ms']:.1f} ms of CPU time: "
        f"{figures['samples_per_cpu_second'] / 1e6:.2f} million samples per CPU second."
    )
    does = PARTS[figures["engine"]]
    rows = [
        (name, does[name], f"{100 * part['share']:.0f} %", f"{part['ms']:.1f}", f"{part['cpu_ms']:.1f}")
        for name, part in figures["parts"].items()
    ]
    table = markdown_table(("part", "what it does", "share", "ms", "CPU ms"), rows)
    return f"{about}\n\n{speed}\n\n{table}\n"


def steps_in_parts(engine: Any, state: State, step: int, progress: float) -> Iterator[tuple[str, Any]]:
    """One step of an engine part by part: after each, its name and what it leaves. The last is ("adam", metrics)."""
    import jax

    from training.dataset import evenly_spread
    from training.multires import jax_engine

    if not isinstance(engine, jax_engine.JaxEngine):
        batch = engine.draw(state, step)
        yield "draw", batch
        output = engine.differentiate(state, batch)
        yield "render", output
        gradient, marks = engine.scatter(state, output)
        yield "scatter", gradient
        yield "adam", engine.move(state, output, gradient, marks, len(batch.start), progress)
        return
    (cells, maps, absent, *_), constants = engine._derived(state), engine._constants(state)
    dataset, compiled = engine.dataset.in_average_look(state.gains), partial(jax.jit, static_argnames="constants")
    ids = evenly_spread(state.next_ray, constants.rays, dataset.count)
    samples, target = compiled(jax_engine.draw)(
        cells, dataset, ids, jax.random.fold_in(engine.key, step), constants=constants
    )
    yield "draw", samples
    gradient, metrics = compiled(jax_engine.loss_and_gradient)(
        state.values, maps, samples, target, engine.pairs(state, step), constants=constants
    )
    yield "gradient", gradient
    rates = np.array(engine.settings.rates_at(state.updates, progress), np.float32)
    state.values, state.first, state.second = compiled(jax_engine.adam)(
        (state.values, state.first, state.second), gradient, absent, rates, constants=constants
    )
    state.updates += 1
    state.next_ray += constants.rays
    jax.block_until_ready(state.values)
    yield "adam", metrics


def profile(run: Run, rounds: int, on_share: Callable[[float], None]) -> dict[str, Any]:
    """Times `rounds` rounds of steps that go on with the run.

    Medians, ms: of wall time, and of CPU time over all threads. The latter tells what a part costs (shares_of), as on a machine
    that others use, too; but not with an accelerator.
    """
    import jax

    method: Any = run.method
    state: Any = run.state
    laps: dict[str, list[np.ndarray]] = {}  # by part: wall and CPU time of each round, ms
    samples, rays = [], 0
    for turn in range(rounds + 1):
        at = run.step + turn
        left: Any = None
        begun = np.array([time.perf_counter(), time.process_time()])
        for name, left in steps_in_parts(method.engine, state, at, min(at / max(method.config.steps, 1), 1.0)):
            jax.block_until_ready(left)
            now = np.array([time.perf_counter(), time.process_time()])
            if turn:  # the first compiles
                laps.setdefault(name, []).append(1000 * (now - begun))
            begun = now
        samples.append(float(left["samples"]))
        rays = int(left["rays"])
        on_share((turn + 1) / (rounds + 1))
    cores, by_cpu = os.cpu_count() or 1, jax.default_backend() == "cpu"
    middle = sorted(samples)[len(samples) // 2]
    medians = {name: np.median(each, axis=0) for name, each in laps.items()}
    step_ms, cpu_ms = np.sum(list(medians.values()), axis=0).tolist()
    return {
        "engine": "fused" if method.config.engine == "fused" else "jax", "step_ms": round(step_ms, 3),
        "cpu_ms": round(cpu_ms, 3), "threads": cores, "samples": int(middle),
        "samples_per_cpu_second": round(1000 * middle / max(cpu_ms, 1e-9)), "shares_of": "CPU" if by_cpu else "wall",
        "parts": {
            name: {"ms": round(wall, 3), "cpu_ms": round(cpu, 3),
                   "share": round(cpu / max(cpu_ms, 1e-9) if by_cpu else wall / max(step_ms, 1e-9), 4)}
            for name, (wall, cpu) in medians.items()
        },
        "scene": run.scene.path.name, "step": run.step, "rows": len(state.values.table), "rays": rays, "rounds": rounds,
        "device": f"{jax.device_count()} x {jax.devices()[0].device_kind}, {cores} cores",
    }  # fmt: skip


def profile_step(
    subject: Path,
    /,
    preset: ProfiledPreset = "quick",
    downscale: int | None = None,
    steps: int = 300,
    rounds: int = 15,
    json: Path | None = None,
    markdown: Path | None = None,
) -> None:
    """Times the parts of one training step of the multi-resolution field.

    Args:
        subject: Folder of a run (its newest checkpoint is used), or of photographs with camera poses.
        preset: Settings to train photographs with.
        downscale: Divide width and height of the photographs by this whole number. The default is that of snerg-make.
        steps: Number of steps to train photographs first: a whole schedule of that length.
        rounds: How often to time each part.
        json: Also write the figures to this file; "-" prints them instead of the table.
        markdown: Also write the table to this file, as Markdown.
    """
    for option, value in (("--steps", steps), ("--rounds", rounds)):
        if value < 1:
            raise UserError("must be at least 1", where=option, found=value)
    check_results(json, markdown)
    begin_libraries()
    from training.run import is_run

    run = _loaded(subject) if is_run(subject) else _trained(subject, preset, downscale, steps)
    with progress("timing", 1.0) as bar:
        figures = profile(run, rounds, bar.update)
    write_result(markdown, to_markdown(figures))
    if not write_json(json, figures):
        print(to_markdown(figures), end="")


def _loaded(path: Path) -> Run:
    from training.run import load_run, read_description

    config = read_description(path).config
    if config.method != "multires":
        raise UserError("only the multi-resolution field can be profiled", where=path,
                        expected="a run of the presets quick, normal, full", found=f"method {config.method}")  # fmt: skip
    return load_run(path)


def _trained(path: Path, preset: ProfiledPreset, downscale: int | None, steps: int) -> Run:
    from training.config import PRESETS
    from training.run import start_run
    from training.scenes import SceneOptions
    from training.scenes.presets import PRESETS as KINDS
    from training.scenes.read import suggested_downscale

    options = SceneOptions(downscale or suggested_downscale(path, KINDS[preset].longest_side))
    with tempfile.TemporaryDirectory(prefix="snerg-profile-") as folder:
        run = start_run(Path(folder), path, dataclasses.replace(PRESETS[preset], steps=steps), options)
    with progress("training", steps) as bar:
        for step in range(steps):
            run.state, _ = run.method.step(run.state, step)
            bar.update(step + 1)
    run.step = steps
    return run


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(profile_step, prog="python -m tools.profile_step", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
