"""Where the time of one training step of the fast method goes, on the machine at hand, for both engines.

    python -m training.profile_step RUN                        (a trained run, as its newest checkpoint left it)
    python -m training.profile_step SCENE --preset cpu --steps 300   (photographs, trained that long first)

The JAX step (training.voxels.step.update) is compiled up to each of its parts. These programs take turns, round by round, with
the whole step, which goes on training; a part's time is the median over rounds of the difference between its program
and the one before, so that a machine that slows down slows all alike. What a compiler may fuse across the border of two
parts is counted with the later one.

The fused step tells its own parts (training.voxels.fused.engine.FusedEngine.parts); what happens within a chunk of rays is
taken apart by passes that end earlier, over other rays of the same state.
"""

from __future__ import annotations

import dataclasses
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from console import Notice, UserError, check_results, progress, run_command, write_json, write_text
from training.libraries import begin_libraries
from training.profile_report import JAX_PARTS, Profile, Stopwatch, fused_profile, jax_profile

if TYPE_CHECKING:
    from training.voxels.jax_engine import JaxEngine
    from training.voxels.method import VoxelMethod
    from training.voxels.state import VoxelState

DESCRIPTION = "Times the parts of one training step of the voxel method (presets cpu and fast)."


def profile(
    method: VoxelMethod, state: VoxelState, step: int, rounds: int, on_share: Callable[[float], None] = lambda _: None
) -> Profile:
    """Times `rounds` rounds at a state, which goes on from there. step: how many steps were done before.

    Where the fused engine can be had, it is taken apart in the same rounds.
    """
    import jax

    from training.voxels.engines import chosen_engine, make_engine
    from training.voxels.jax_engine import JaxEngine
    from training.voxels.method import REMEMBER_EVERY

    config, plain = method.config, method.engine.end(state)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Notice)
        fused = chosen_engine("auto") == "fused"
    other: Any = make_engine("fused", method.dataset, method.plan, method.settings, config.seed) if fused else None
    others = other.remember(other.begin(plain)) if other else None  # copied before JAX uses it up
    engine = JaxEngine(method.dataset, method.plan, method.settings, config.seed)
    state = engine.begin(plain)
    programs = _programs(engine, state)
    watch, fused_watch = Stopwatch(), Stopwatch()
    metrics: dict[str, Any] = {}
    fused_samples: list[float] = []
    for turn in range(rounds + 1):
        at = step + turn
        share = min(at / max(config.steps, 1), 1.0)
        watch.start()
        for name, program in programs.items():
            jax.block_until_ready(program(state, at))
            watch.lap(name)
        state, metrics = engine.step(state, at, share)
        jax.block_until_ready(state.optimised)
        watch.lap("step")
        jax.block_until_ready(engine.remember(state).layout.support)
        watch.lap("remember")
        if other:
            fused_samples.append(_fused_round(other, others, at, share, fused_watch))
        if not turn:  # the first compiles
            watch.forget()
            fused_watch.forget()
        on_share((turn + 1) / (rounds + 1))
    facts = {
        "step": step, "voxels": int(state.trainable.rows.shape[0] - 1), "rays": state.rays, "rounds": rounds,
        "device": f"{jax.device_count()} x {jax.devices()[0].device_kind}, {os.cpu_count()} cores",
    }  # fmt: skip
    of_jax = jax_profile(
        watch.rounds(), REMEMBER_EVERY, float(metrics["samples"]), os.cpu_count() or 1, jax.default_backend() == "cpu"
    )
    if not other:
        return Profile(of_jax, None, facts)
    samples = sorted(fused_samples)[len(fused_samples) // 2]
    return Profile(of_jax, fused_profile(fused_watch.rounds(), REMEMBER_EVERY, samples, other.workers.count), facts)


def _fused_round(engine: Any, state: Any, step: int, share: float, watch: Stopwatch) -> float:
    """One step of the fused engine, taken apart; the samples that it had."""
    import numpy as np

    stepper = state.stepper
    for number, part in enumerate(("march", "fetch", "forward")):
        batch = engine.draw(state, np.random.default_rng((step, number)), state.rays)  # rows that no cache holds yet
        watch.start()
        stepper.render(state.values, batch, part)
        watch.lap(f"up to {part}")
    lefts: list[Any] = []
    watch.start()
    for part, left in engine.parts(state, step, share):
        watch.lap(part)
        lefts.append(left)
    stepper.remember_depths(state.values)
    watch.lap("remember")
    return lefts[-1][1]["samples"]


def _programs(engine: JaxEngine, state: VoxelState) -> dict[str, Callable[[VoxelState, int], Any]]:
    """The step up to each part but the optimiser, jitted: (state, number of the step) -> what that part leaves.

    Those before `variation` look at one window of voxels only; `variation` is all up to the gradient with every window.
    """
    import jax
    import numpy as np

    from training.voxels.step import draw, gradient_parts

    sizes = state.sizes
    assert sizes is not None, "known since the engine began with the state"

    def up_to(part: str, trainable: Any, stage: Any, dataset: Any, key: Any, step: Any, *, share: float) -> Any:
        settings = engine.settings._replace(variation_share=share)
        batch = draw(stage, dataset, key, step, state.rays, settings)
        if part == "draw":
            return batch
        made = gradient_parts(trainable, stage, batch, dataset.mesh, sizes=sizes, settings=settings)
        return next(left for name, left in made if name == part)

    def program(name: str) -> Callable[[VoxelState, int], Any]:
        part, share = ("backward", engine.settings.variation_share) if name == "variation" else (name, 0.0)
        jitted = jax.jit(partial(up_to, part, share=share))
        return lambda now, step: jitted(now.trainable, now.stage, engine.dataset, engine.key, np.int32(step))

    return {name: program(name) for name in JAX_PARTS if name not in ("adam", "remember")}


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
    begin_libraries()
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
    from training.scenes import load_scene
    from training.scenes.downscale import suggested_downscale
    from training.scenes.presets import PRESETS as KINDS

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
