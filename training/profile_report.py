"""What profiling a step has found: times of its parts for each engine, as a table and as JSON. Nothing of JAX is needed here."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

JAX_PARTS = {
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
FUSED_PARTS = {
    "draw": "random rays, their pixels, and their way through the grid",
    "march": "which samples of each ray lie in stored voxels, and which rows are around them",
    "fetch": "these rows, blended and activated",
    "forward": "compositing, the view MLP once a ray, forth and back, the losses",
    "backward": "the slopes of each sample",
    "variation": "total variation of random windows of voxels, forth and back",
    "scatter": "slopes of samples and windows into those of their rows",
    "adam": "the optimiser, over the rows that were touched",
    "remember": "how deep, optically, cells are: one look in 50 steps, spread over them",
}


class Times(NamedTuple):
    """Milliseconds: wall time, and CPU time over all threads."""

    wall: float
    cpu: float


@dataclass(frozen=True)
class EngineProfile:
    """parts: of each part, by its name. step: of the whole step; medians all. samples: of a step. by_cpu: CPU time tells what a
    part costs, as on a machine that others use, too; False for accelerators."""

    parts: Mapping[str, Times]
    step: Times
    samples: float
    threads: int
    by_cpu: bool = True

    @property
    def shares(self) -> dict[str, float]:
        """Each part's share of their sum; a difference below zero is noise and counts as nothing."""
        costs = {name: max(times.cpu if self.by_cpu else times.wall, 0.0) for name, times in self.parts.items()}
        total = max(sum(costs.values()), 1e-9)
        return {name: cost / total for name, cost in costs.items()}

    @property
    def samples_per_second(self) -> float:
        """Samples a second of wall time."""
        return 1000 * self.samples / max(self.step.wall, 1e-9)

    @property
    def samples_per_cpu_second(self) -> float:
        """Samples a second of one processor's time."""
        return 1000 * self.samples / max(self.step.cpu, 1e-9)

    def to_json(self) -> dict[str, Any]:
        """{"step_ms", "cpu_ms", "threads", "samples", "samples_per_cpu_second", "parts": {name: {"ms", "cpu_ms", "share"}}}."""
        parts = {
            name: {"ms": round(times.wall, 3), "cpu_ms": round(times.cpu, 3), "share": round(self.shares[name], 4)}
            for name, times in self.parts.items()
        }
        return {
            "step_ms": round(self.step.wall, 3), "cpu_ms": round(self.step.cpu, 3), "threads": self.threads,
            "samples": int(self.samples), "samples_per_cpu_second": round(self.samples_per_cpu_second), "parts": parts,
        }  # fmt: skip

    def to_markdown(self, title: str, what: Mapping[str, str]) -> str:
        """A line about the step, and the table of its parts."""
        about = (
            f"{title}: {self.threads} threads, {self.samples:,.0f} samples a step; a step takes {self.step.wall:.1f} ms and "
            f"{self.step.cpu:.1f} ms of CPU time: {self.samples_per_cpu_second / 1e6:.2f} million samples per CPU second."
        )
        rows = [
            f"| {name} | {what[name]} | {100 * self.shares[name]:.0f} % | {times.wall:.1f} | {times.cpu:.1f} |"
            for name, times in self.parts.items()
        ]
        return "\n".join(
            [about, "", "| part | what it does | share | ms | CPU ms |", "| --- | --- | --- | --- | --- |", *rows]
        )


@dataclass(frozen=True)
class Profile:
    """Both engines at one state; fused is None where there is none. facts: what was profiled, on what."""

    jax: EngineProfile
    fused: EngineProfile | None
    facts: dict[str, Any]

    def ratios(self) -> dict[str, float]:
        """How many times the JAX engine's samples the fused engine computes, a second and a CPU second."""
        assert self.fused is not None
        return {
            "ratio": round(self.fused.samples_per_second / self.jax.samples_per_second, 3),
            "cpu_ratio": round(self.fused.samples_per_cpu_second / self.jax.samples_per_cpu_second, 3),
        }

    def to_json(self) -> dict[str, Any]:
        """For scripts: the JAX engine's figures, what was profiled, and "fused": those of the other engine and the ratios."""
        told = {**self.jax.to_json(), **self.facts}
        if self.fused is not None:
            told["fused"] = {**self.fused.to_json(), **self.ratios()}
        return told

    def to_markdown(self) -> str:
        """A table for each engine, below lines about what was profiled."""
        facts = self.facts
        about = (
            f"{facts['scene']} after {facts['step']:,} steps: {facts['voxels']:,} voxels, {facts['rays']:,} rays a step. "
            f"{facts['rounds']} rounds on {facts['device']}; medians. Shares are of {'CPU' if self.jax.by_cpu else 'wall'} time."
        )
        parts = [about, self.jax.to_markdown("JAX engine", JAX_PARTS)]
        if self.fused is not None:
            ratios = self.ratios()
            parts.append(self.fused.to_markdown("Fused engine", FUSED_PARTS))
            parts.append(
                f"In the same rounds, the fused engine computed {ratios['ratio']:.1f} times the JAX engine's samples a second, "
                f"and {ratios['cpu_ratio']:.1f} times its samples a CPU second."
            )
        return "\n\n".join(parts) + "\n"


class Stopwatch:
    """Laps by name: rounds of (wall, CPU) milliseconds."""

    def __init__(self) -> None:
        self.laps: dict[str, list[Times]] = {}
        self.start()

    def start(self) -> None:
        """Begins a lap."""
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def lap(self, name: str) -> None:
        """Ends the lap, under this name, and begins the next."""
        wall, cpu = time.perf_counter() - self._wall, time.process_time() - self._cpu
        self.laps.setdefault(name, []).append(Times(1000 * wall, 1000 * cpu))
        self.start()

    def forget(self) -> None:
        """Drops all laps: they were of a round that compiled."""
        self.laps.clear()

    def rounds(self) -> dict[str, np.ndarray]:
        """[rounds, 2] of each name."""
        return {name: np.array(laps) for name, laps in self.laps.items()}


def median(values: np.ndarray) -> Times:
    """Of rounds [rounds, 2], without the precision that they do not have."""
    return Times(*(float(value) for value in np.median(values, axis=0)))


def jax_profile(
    rounds: Mapping[str, np.ndarray], every: int, samples: float, threads: int, by_cpu: bool
) -> EngineProfile:
    """From the rounds [rounds, 2] of programs that end with each of JAX_PARTS, of the whole "step" and of "remember".

    every: steps between two looks at how deep cells are.
    """
    before, parts = np.zeros_like(rounds["step"]), {}
    for name in [*(name for name in JAX_PARTS if name not in ("adam", "remember")), "step"]:
        parts["adam" if name == "step" else name] = median(rounds[name] - before)
        before = rounds[name]
    parts["remember"] = median(rounds["remember"] / every)
    return EngineProfile(parts, median(rounds["step"]), samples, threads, by_cpu)


def fused_profile(rounds: Mapping[str, np.ndarray], every: int, samples: float, threads: int) -> EngineProfile:
    """From the rounds [rounds, 2] of the laps of one step, of passes "up to march", …, and of "remember"."""
    within = ("march", "fetch", "forward")  # a chunk of rays
    up_to = [np.zeros_like(rounds["draw"]), *(rounds[f"up to {name}"] for name in within), rounds["render"]]
    apart = dict(zip((*within, "backward"), np.diff(up_to, axis=0), strict=True))
    apart |= {**rounds, "remember": rounds["remember"] / every}
    whole = sum(rounds[name] for name in ("draw", "render", "variation", "scatter", "adam"))
    return EngineProfile(
        {name: median(apart[name]) for name in FUSED_PARTS}, median(np.asarray(whole)), samples, threads
    )
