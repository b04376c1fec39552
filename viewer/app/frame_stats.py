"""Frame statistics: times of the last frames, for plots and figures."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

KEPT = 240
AVERAGED = 30  # frames, of the usual time and rate


@dataclass(frozen=True)
class FrameSummary:
    """Milliseconds from frame to frame. All of the UI shows `mean` and the `fps` that follows from it."""

    mean: float = 0.0  # of the last `AVERAGED` frames
    median: float = 0.0  # this and the others: of all frames that are kept
    p95: float = 0.0
    slowest: float = 0.0

    @property
    def fps(self) -> float:
        return 1000.0 / self.mean if self.mean > 0 else 0.0


class FrameStats:
    """The last `KEPT` drawn frames, milliseconds.

    scene_ms: drawing the picture, wall clock. gpu_ms: the same by the GPU's timer; NaN where it is unreliable.
    frame_ms: from frame to frame while frames follow one another.
    """

    def __init__(self) -> None:
        self.scene_ms: deque[float] = deque(maxlen=KEPT)
        self.gpu_ms: deque[float] = deque(maxlen=KEPT)
        self.frame_ms: deque[float] = deque(maxlen=KEPT)
        self.drawn = 0

    def add(self, scene_ms: float, frame_ms: float, gpu_ms: float | None = None) -> None:
        """Adds one drawn frame."""
        self.scene_ms.append(scene_ms)
        self.gpu_ms.append(float("nan") if gpu_ms is None else gpu_ms)
        self.frame_ms.append(frame_ms)
        self.drawn += 1

    def summary(self) -> FrameSummary:
        """Statistics of the frames; zeros before the first."""
        if not self.frame_ms:
            return FrameSummary()
        times = np.asarray(self.frame_ms)
        median, p95 = np.percentile(times, (50, 95))
        return FrameSummary(float(times[-AVERAGED:].mean()), float(median), float(p95), float(times.max()))
