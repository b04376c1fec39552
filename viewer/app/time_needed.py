"""What making a scene will take on this computer: time, memory and disk, before it is begun.

A child process (training.speed) tells how many samples a run takes, and times a few on this machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from training.scenes.presets import PRESETS
from viewer.app.background import JsonTask

MODULE = "training.speed"
# Of five captures in docs/results.md: baking took 0.8 to 1.1 times as long as training.
BAKING_BY_TRAINING = 1.0
# Peaks of snerg-make on lego at 800 x 800: 2.8, 3.5 and 4.8 GB at 512, 750 and 1000 voxels.
MEMORY, MEMORY_OF_1000 = 2.2e9, 2.6e9
# Bytes of a bake's pieces, and its pack: lego took half of that, rooms take up to twice as many blocks.
DISK_OF_1000 = 1.1e9


class TimeNeeded(JsonTask):
    """An estimate for photographs of these longer sides (pixels), from the moment this is made. Poll `news`, and close it.

    after: waits for what else is being measured.
    """

    def __init__(self, sides: Sequence[int], after: Callable[[], object] = lambda: None) -> None:
        words = [str(side) for side in sorted(set(sides))]
        self._runs: Mapping[str, Any] = {}
        self._per_sample: float | None = None
        self._after = after
        super().__init__(MODULE, words, self._hear)

    def before(self) -> None:
        self._after()

    def state(self) -> object:
        return len(self._runs), self._per_sample

    def seconds(self, preset: str, side: int) -> float | None:
        """For training and baking, without finding poses; None where it is not known, as for presets with the paper's MLP."""
        run = self._runs.get(preset, {}).get(str(side))
        if run is None or self._per_sample is None:
            return None
        return (1.0 + BAKING_BY_TRAINING) * self._per_sample * run["samples"]

    def disk(self, preset: str, side: int) -> float | None:
        """Bytes for the run, the bake's pieces and the pack; None where it is not known."""
        run = self._runs.get(preset, {}).get(str(side))
        return None if run is None else run["disk"] + DISK_OF_1000 * _share(preset, side)

    def _hear(self, said: Mapping[str, Any]) -> None:
        self._runs = said.get("runs", self._runs)
        self._per_sample = said.get("seconds_per_sample", self._per_sample)


def memory(preset: str, side: int) -> float:
    """Bytes that making a scene holds at most, about."""
    return MEMORY + MEMORY_OF_1000 * _share(preset, side)


def _share(preset: str, side: int) -> float:
    """Of what a bake at 1000 voxels takes: it grows with surfaces."""
    return (PRESETS[preset].resolution_for(side) / 1000) ** 2  # type: ignore[index]
