"""What profiling a step has found: times of its parts, as a table and as JSON. Nothing of JAX is needed here."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

PARTS: Mapping[str, Mapping[str, str]] = {
    "jax": {
        "draw": "random rays and their pixels, and samples where the occupancy grid is on",
        "gradient": "features, decoder, compositing, the view MLP, the losses, and all in reverse into one dense gradient",
        "adam": "the optimiser, over every row of the table",
    },
    "fused": {
        "draw": "random rays and their pixels",
        "render": "samples, features, decoder, compositing, the view MLP, the losses, and all in reverse to each sample",
        "scatter": "slopes of the samples' features into those of their rows",
        "adam": "the optimiser, over the rows that were touched",
    },
}


class Times(NamedTuple):
    """Milliseconds: wall time, and CPU time over all threads."""

    wall: float
    cpu: float


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

    def medians(self) -> dict[str, Times]:
        """Of each name, over the rounds."""
        return {name: Times(*(float(v) for v in np.median(laps, axis=0))) for name, laps in self.laps.items()}


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
