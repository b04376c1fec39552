"""Where the time of one training step of the multi-resolution field goes, on the machine at hand.

    python -m tools.profile_step RUN                        (a trained run, as its newest checkpoint left it)
    python -m tools.profile_step SCENE --preset quick --steps 300   (photographs, trained that long first)

Steps are made part by part, and training goes on with them; a part's time is its median over rounds.
"""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from console import UserError, check_results, progress, run_command, write_json, write_result
from training.libraries import begin_libraries

if TYPE_CHECKING:
    from training.multires.method import MultiresMethod
    from training.multires.state import State

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


class Times(NamedTuple):
    """Milliseconds: wall time, and CPU time over all threads."""

    wall: float
    cpu: float


@dataclass(frozen=True)
class Profile:
    """engine: its name. parts: medians of each part, by its name. samples: of a step. by_cpu: CPU time tells what a part costs,
    as on a machine that others use, too; False for accelerators. facts: what was profiled, on what."""

    engine: str
    parts: Mapping[str, Times]
    samples: float
    threads: int
    by_cpu: bool
    facts: Mapping[str, Any]

    @property
    def step(self) -> Times:
        """The whole step."""
        return Times(*(float(sum(column)) for column in zip(*self.parts.values(), strict=True)))

    @property
    def shares(self) -> dict[str, float]:
        """Each part's share of the step."""
        costs = {name: times.cpu if self.by_cpu else times.wall for name, times in self.parts.items()}
        return {name: cost / max(sum(costs.values()), 1e-9) for name, cost in costs.items()}

    @property
    def samples_per_cpu_second(self) -> float:
        """Samples a second of one processor's time."""
        return 1000 * self.samples / max(self.step.cpu, 1e-9)

    def to_json(self) -> dict[str, Any]:
        """{"step_ms", "cpu_ms", "threads", "samples", "samples_per_cpu_second", "parts": {name: {"ms", "cpu_ms", "share"}}}, and
        the facts."""
        parts = {
            name: {"ms": round(times.wall, 3), "cpu_ms": round(times.cpu, 3), "share": round(self.shares[name], 4)}
            for name, times in self.parts.items()
        }
        return {
            "engine": self.engine, "step_ms": round(self.step.wall, 3), "cpu_ms": round(self.step.cpu, 3),
            "threads": self.threads, "samples": int(self.samples),
            "samples_per_cpu_second": round(self.samples_per_cpu_second), "parts": parts, **self.facts,
        }  # fmt: skip

    def to_markdown(self) -> str:
        """A table below lines about what was profiled."""
        facts = self.facts
        about = (
            f"{facts['scene']} after {facts['step']:,} steps: {facts['rows']:,} rows of features, {facts['rays']:,} rays a step. "
            f"{facts['rounds']} rounds on {facts['device']}; medians. Shares are of {'CPU' if self.by_cpu else 'wall'} time."
        )
        speed = (
            f"Engine {self.engine}: {self.threads} threads, {self.samples:,.0f} samples a step; a step takes "
            f"{self.step.wall:.1f} ms and {self.step.cpu:.1f} ms of CPU time: {self.samples_per_cpu_second / 1e6:.2f} million "
            "samples per CPU second."
        )
        rows = [
            f"| {name} | {PARTS[self.engine][name]} | {100 * self.shares[name]:.0f} % | {times.wall:.1f} | {times.cpu:.1f} |"
            for name, times in self.parts.items()
        ]
        head = ["| part | what it does | share | ms | CPU ms |", "| --- | --- | --- | --- | --- |"]
        return "\n".join([about, "", speed, "", *head, *rows]) + "\n"


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


def profile(
    method: MultiresMethod, state: State, step: int, rounds: int, on_share: Callable[[float], None] = lambda _: None
) -> Profile:
    """Times `rounds` rounds at a state, which goes on from there. step: how many steps were done before."""
    import jax

    laps: dict[str, list[np.ndarray]] = {}  # by part: wall and CPU time of each round, ms
    samples, rays = [], 0
    for turn in range(rounds + 1):
        at = step + turn
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
    cores = os.cpu_count() or 1
    facts = {
        "step": step, "rows": len(state.values.table), "rays": rays, "rounds": rounds,
        "device": f"{jax.device_count()} x {jax.devices()[0].device_kind}, {cores} cores",
    }  # fmt: skip
    engine = "fused" if method.config.engine == "fused" else "jax"
    middle = sorted(samples)[len(samples) // 2]
    parts = {name: Times(*np.median(each, axis=0).tolist()) for name, each in laps.items()}
    return Profile(engine, parts, middle, cores, jax.default_backend() == "cpu", facts)


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

    method, state, step, name = _of_run(subject) if is_run(subject) else _trained(subject, preset, downscale, steps)
    with progress("timing", 1.0) as bar:
        measured = profile(method, state, step, rounds, bar.update)
    measured = dataclasses.replace(measured, facts={"scene": name, **measured.facts})
    if markdown is not None:
        write_result(markdown, measured.to_markdown())
    if not write_json(json, measured.to_json()):
        print(measured.to_markdown(), end="")


def _of_run(path: Path) -> tuple[Any, Any, int, str]:
    from training.run import load_run, read_description

    config = read_description(path).config
    if config.method != "multires":
        raise UserError("only the multi-resolution field can be profiled", where=path,
                        expected="a run of the presets quick, normal, full", found=f"method {config.method}")  # fmt: skip
    run = load_run(path)
    return run.method, run.state, run.step, run.scene.path.name


def _trained(
    path: Path, preset: ProfiledPreset, downscale: int | None, steps: int
) -> tuple[Any, Any, int, str]:  # fmt: skip
    import jax

    from training.config import PRESETS
    from training.dataset import make_dataset
    from training.run import make_method, settled
    from training.scenes import load_scene
    from training.scenes.presets import PRESETS as KINDS
    from training.scenes.read import suggested_downscale

    scene = load_scene(path, downscale=downscale or suggested_downscale(path, KINDS[preset].longest_side))
    config = settled(dataclasses.replace(PRESETS[preset], steps=steps))
    method = make_method(config, make_dataset(scene))
    state = method.start(jax.random.PRNGKey(config.seed))
    with progress("training", steps) as bar:
        for step in range(steps):
            state, _ = method.step(state, step)
            bar.update(step + 1)
    return method, state, steps, path.name


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(profile_step, prog="python -m tools.profile_step", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
