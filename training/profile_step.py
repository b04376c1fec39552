"""Where the time of one training step of the fast method goes, on the machine at hand.

    python -m training.profile_step RUN                        (a trained run, as its newest checkpoint left it)
    python -m training.profile_step SCENE --preset cpu --steps 300   (photographs, trained that long first)

The step (training.voxels.step.parts) is compiled up to each of its parts. These programs take turns, round by round, with
the whole step, which goes on training; a part's time is the median over rounds of the difference between its program
and the one before, so that a machine that slows down slows all alike. What a compiler may fuse across the border of two
parts is counted with the later one.
"""

from __future__ import annotations

import dataclasses
import os
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from console import Notice, UserError, check_results, progress, run_command, write_json, write_text

if TYPE_CHECKING:
    from training.voxels.method import VoxelMethod
    from training.voxels.state import VoxelState
    from training.voxels.step import JaxEngine

DESCRIPTION = "Times the parts of one training step of the voxel method (presets cpu and fast)."
PARTS = {
    "draw": "random rays and their pixels, and what else is random",
    "march": "which samples of each ray lie in stored voxels",
    "look up": "which rows hold the 8 voxels around each sample",
    "gather": "these rows, fetched and blended",
    "forward": "activation, compositing, the view MLP once a ray, the losses",
    "backward": "all of these in reverse, and the scatter into one dense gradient",
    "variation": "total variation of random windows of voxels, forth and back",
    "adam": "the optimiser, over every stored voxel",
    "remember": "how deep, optically, cells are: one look in 50 steps, spread over them",
}
WHOLE_STEP = "step"
FUSED = "fused"  # the whole step of the other engine


@dataclass(frozen=True)
class Profile:
    """parts: milliseconds of each of PARTS. step_ms: the whole step, by its own median. facts: what was profiled, on what."""

    parts: dict[str, float]
    step_ms: float
    facts: dict[str, Any]

    @property
    def shares(self) -> dict[str, float]:
        """Each part's share of their sum; a difference below zero is noise and counts as nothing."""
        times = {name: max(ms, 0.0) for name, ms in self.parts.items()}
        total = max(sum(times.values()), 1e-9)
        return {name: ms / total for name, ms in times.items()}

    def to_json(self) -> dict[str, Any]:
        """For scripts: {"step_ms", "parts": {name: {"ms", "share"}}, and what was profiled}."""
        parts = {name: {"ms": round(ms, 3), "share": round(self.shares[name], 4)} for name, ms in self.parts.items()}
        return {"step_ms": round(self.step_ms, 3), "parts": parts, **self.facts}

    def to_markdown(self) -> str:
        """The table, below a line about what was profiled."""
        facts = self.facts
        about = (
            f"{facts['scene']} after {facts['step']:,} steps: {facts['voxels']:,} voxels, {facts['rays']:,} rays and "
            f"{facts['samples']:,} samples a step. {facts['rounds']} rounds on {facts['device']}; a step took "
            f"{self.step_ms:.0f} ms, by the median."
        )
        if FUSED in facts:
            other = facts[FUSED]
            about += (
                f" In the same rounds, a step of the fused engine took {other['ms']:.0f} ms for {other['samples']:,} samples: "
                f"{other['ratio']:.1f} times the samples a second."
            )
        rows = [
            f"| {name} | {what} | {100 * self.shares[name]:.0f} % | {self.parts[name]:.1f} |"
            for name, what in PARTS.items()
        ]
        return "\n".join([about, "", "| part | what it does | share | ms |", "| --- | --- | --- | --- |", *rows]) + "\n"


def profile(
    method: VoxelMethod, state: VoxelState, step: int, rounds: int, on_share: Callable[[float], None] = lambda _: None
) -> Profile:
    """Times `rounds` rounds at a state, which goes on from there. step: how many steps were done before.

    The JAX step is taken apart; where the fused engine can be had, its whole step is timed in the same rounds.
    """
    import jax
    import numpy as np

    from training.voxels.engines import chosen_engine, make_engine
    from training.voxels.method import REMEMBER_EVERY
    from training.voxels.step import JaxEngine

    config, plain = method.config, method.engine.end(state)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Notice)
        fused = chosen_engine("auto") == "fused"
    other = make_engine("fused", method.dataset, method.plan, method.settings, config.seed) if fused else None
    others = other.remember(other.begin(plain)) if other else None  # copied before JAX uses it up
    engine = JaxEngine(method.dataset, method.settings, config.seed)
    state = engine.begin(plain)
    programs = _programs(engine, state)
    names = [*programs, WHOLE_STEP, "remember", *([FUSED] if other else [])]
    times: dict[str, list[float]] = {name: [] for name in names}
    metrics: dict[str, Any] = {}
    fused_samples: list[float] = []
    for turn in range(rounds + 1):  # the first compiles, and is not counted
        at = step + turn
        for name, taken in times.items():
            began = time.perf_counter()
            if name == WHOLE_STEP:
                state, metrics = engine.step(state, at, min(at / max(config.steps, 1), 1.0))
                jax.block_until_ready(state.optimised)
            elif name == FUSED:
                assert other is not None
                others, told = other.step(others, at, min(at / max(config.steps, 1), 1.0))
                fused_samples.append(told["samples"])
            elif name == "remember":
                jax.block_until_ready(engine.remember(state).layout.support)
            else:
                jax.block_until_ready(programs[name](state, at))
            if turn:
                taken.append(1000 * (time.perf_counter() - began))
        on_share((turn + 1) / (rounds + 1))
    whole, samples = float(np.median(times[WHOLE_STEP])), float(metrics["samples"])
    parts = _differences({name: np.array(values) for name, values in times.items() if name != FUSED}, REMEMBER_EVERY)
    facts = {
        "step": step, "voxels": int(state.trainable.rows.shape[0] - 1), "rays": state.rays,
        "samples": int(metrics["samples"]), "rounds": rounds,
        "device": f"{jax.device_count()} x {jax.devices()[0].device_kind}, {os.cpu_count()} cores",
    }  # fmt: skip
    if other:
        ms, drawn = float(np.median(times[FUSED])), float(np.median(fused_samples))
        facts[FUSED] = {"ms": round(ms, 3), "samples": int(drawn), "ratio": round(drawn / ms * whole / samples, 3)}
    return Profile(parts, whole, facts)


def _differences(times: dict[str, Any], every: int) -> dict[str, float]:
    """Milliseconds of each of PARTS, from those [rounds] of the programs that end with it."""
    import numpy as np

    order = [*(name for name in PARTS if name not in ("adam", "remember")), WHOLE_STEP]
    before, parts = np.zeros_like(times[WHOLE_STEP]), {}
    for name in order:
        parts["adam" if name == WHOLE_STEP else name] = float(np.median(times[name] - before))
        before = times[name]
    return {**parts, "remember": float(np.median(times["remember"])) / every}


def _programs(engine: JaxEngine, state: VoxelState) -> dict[str, Callable[[VoxelState, int], Any]]:
    """The step up to each part but the optimiser, jitted: (state, number of the step) -> what that part leaves.

    Those before `variation` look at one window of voxels only; `variation` is all up to the gradient with every window.
    """
    import jax
    import numpy as np

    from training.voxels.step import parts

    def up_to(part: str, trainable: Any, stage: Any, dataset: Any, key: Any, step: Any, *, share: float) -> Any:
        settings = engine.settings._replace(variation_share=share)
        made = parts(trainable, stage, dataset, key, step, sizes=state.sizes, rays=state.rays, settings=settings)
        return next(left for name, left in made if name == part)

    def program(name: str) -> Callable[[VoxelState, int], Any]:
        part, share = ("backward", engine.settings.variation_share) if name == "variation" else (name, 0.0)
        jitted = jax.jit(partial(up_to, part, share=share))
        return lambda now, step: jitted(now.trainable, now.stage, engine.dataset, engine.key, np.int32(step))

    return {name: program(name) for name in PARTS if name not in ("adam", "remember")}


def profile_step(
    subject: Path,
    /,
    preset: Literal["cpu", "fast"] = "cpu",
    downscale: int | None = None,
    steps: int = 300,
    rounds: int = 15,
    json: Path | None = None,
    markdown: Path | None = None,
) -> None:
    """Times the parts of one training step of the fast method.

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
    from training.run import is_run

    method, state, step, name = _of_run(subject) if is_run(subject) else _trained(subject, preset, downscale, steps)
    with progress("timing", 1.0) as bar:
        measured = profile(method, state, step, rounds, bar.update)
    measured = dataclasses.replace(measured, facts={"scene": name, **measured.facts})
    if markdown is not None:
        write_text(markdown, measured.to_markdown())
    if not write_json(json, measured.to_json()):
        print(measured.to_markdown(), end="")


def _of_run(path: Path) -> tuple[Any, Any, int, str]:
    from training.run import load_run, read_description

    config = read_description(path).config
    if config.method != "voxels":
        raise UserError("only the voxel method can be profiled", where=path, expected="a run of the presets cpu, fast",
                        found=f"method {config.method}")  # fmt: skip
    run = load_run(path)
    return run.method, run.state, run.step, run.scene.path.name


def _trained(
    path: Path, preset: Literal["cpu", "fast"], downscale: int | None, steps: int
) -> tuple[Any, Any, int, str]:
    import jax

    from training.config import PRESETS
    from training.dataset import make_dataset
    from training.methods import make_method
    from training.presets import PRESETS as KINDS
    from training.scenes import load_scene
    from training.scenes.downscale import suggested_downscale

    scene = load_scene(path, downscale=downscale or suggested_downscale(path, KINDS[preset].longest_side))
    config = dataclasses.replace(PRESETS[preset], steps=steps)
    method = make_method(config, make_dataset(scene))
    state = method.start(jax.random.PRNGKey(config.seed))
    with progress("training", steps) as bar:
        for step in range(steps):
            state, _ = method.step(state, step)
            bar.update(step + 1)
    return method, state, steps, path.name


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(profile_step, prog="python -m training.profile_step", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
