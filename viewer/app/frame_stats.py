"""Rolling frame times for plots and figures."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

KEPT = 240
AVERAGED = 30  # frames, of the usual time and rate


@dataclass(frozen=True)
class FrameSummary:
    """Milliseconds from frame to frame. mean: of the last `AVERAGED` frames, and fps, the rate that follows from it: these
    two are shown wherever a frame time or a rate is. median, p95 and slowest: of all frames that are kept.
    """

    mean: float = 0.0
    median: float = 0.0
    p95: float = 0.0
    slowest: float = 0.0

    @property
    def fps(self) -> float:
        return 1000.0 / self.mean if self.mean > 0 else 0.0


class FrameStats:
    """The last `KEPT` drawn frames, in milliseconds.

    scene_ms: what was drawn of the picture, by the wall clock. gpu_ms: the same by the card's own clock, NaN where that is
    not to be trusted. frame_ms: from frame to frame while active.
    """

    def __init__(self) -> None:
        self.scene_ms: deque[float] = deque(maxlen=KEPT)
        self.gpu_ms: deque[float] = deque(maxlen=KEPT)
        self.frame_ms: deque[float] = deque(maxlen=KEPT)
        self.drawn = 0

    def add(self, scene_ms: float, frame_ms: float, gpu_ms: float | None = None) -> None:
        """One drawn frame."""
        self.scene_ms.append(scene_ms)
        self.gpu_ms.append(float("nan") if gpu_ms is None else gpu_ms)
        self.frame_ms.append(frame_ms)
        self.drawn += 1

    def summary(self) -> FrameSummary:
        """Its figures; zeros while nothing was drawn."""
        if not self.frame_ms:
            return FrameSummary()
        times = np.asarray(self.frame_ms)
        median, p95 = np.percentile(times, (50, 95))
        return FrameSummary(float(times[-AVERAGED:].mean()), float(median), float(p95), float(times.max()))
