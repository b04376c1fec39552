"""What making a scene will take on this computer: time, memory and disk, before it is begun.

A child process (training.speed) tells how many samples a run takes, and times a few on this machine.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from training.scenes.presets import PRESETS
from viewer.app.child import POLITENESS

MODULE = "training.speed"
# Of five captures in docs/results.md: baking took 0.8 to 1.1 times as long as training.
BAKING_BY_TRAINING = 1.0
# Peaks of snerg-make on lego at 800 x 800: 2.8, 3.5 and 4.8 GB at 512, 750 and 1000 voxels.
MEMORY, MEMORY_OF_1000 = 2.2e9, 2.6e9
DISK_OF_1000 = (
    1.1e9  # bytes of a bake's pieces, and its pack: lego took half of that, rooms take up to twice as many blocks
)


class TimeNeeded:
    """An estimate for photographs of these longer sides (pixels), from the moment this is made. Poll `news`, and close it.

    forward: they look one way. after: waits for what else is being measured.
    """

    def __init__(self, sides: Sequence[int], forward: bool, after: Callable[[], object] = lambda: None) -> None:
        self._words = [str(side) for side in sorted(set(sides))] + ["--forward"] * forward
        self._after = after
        self._runs: Mapping[str, Any] = {}
        self._per_sample: float | None = None
        self._process: subprocess.Popen[str] | None = None
        self._closed = False
        self._told: object = None
        self._thread = threading.Thread(target=self._run, name="snerg-time-needed", daemon=True)
        self._thread.start()

    @property
    def coming(self) -> bool:
        """Whether more is on its way."""
        return self._thread.is_alive()

    def news(self) -> bool:
        """Whether more is known since this was asked last."""
        state = (len(self._runs), self._per_sample, self.coming)
        told, self._told = self._told, state
        return told != state

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

    def close(self) -> None:
        """Ends the process."""
        self._closed = True
        if self._process is not None:
            self._process.kill()

    def _run(self) -> None:
        self._after()
        if self._closed:
            return
        self._process = process = subprocess.Popen(
            [sys.executable, "-m", MODULE, *self._words],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            start_new_session=True, creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )  # fmt: skip
        if self._closed:
            process.kill()
        if sys.platform != "win32":  # as what is begun later, so that it is measured likewise
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, process.pid, POLITENESS)
        assert process.stdout is not None and process.stdin is not None
        with contextlib.suppress(ValueError, KeyError, TypeError):  # it was ended within a line
            for line in process.stdout:
                said = json.loads(line)
                self._runs = said.get("runs", self._runs)
                self._per_sample = said.get("seconds_per_sample", self._per_sample)
        process.kill()
        process.wait()
        process.stdout.close()
        with contextlib.suppress(OSError):
            process.stdin.close()


def memory(preset: str, side: int) -> float:
    """Bytes that making a scene holds at most, about."""
    return MEMORY + MEMORY_OF_1000 * _share(preset, side)


def _share(preset: str, side: int) -> float:
    """Of what a bake at 1000 voxels takes: it grows with surfaces."""
    return (PRESETS[preset].resolution_for(side) / 1000) ** 2  # type: ignore[index]
