"""Rolling frame times for plots and figures."""

from __future__ import annotations

from collections import deque

import numpy as np

KEPT = 240


class FrameTimes:
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

    def summary(self) -> dict[str, float]:
        """mean, p50, p95 and max of the frame times (ms), and fps; zeros while nothing was drawn."""
        if not self.frame_ms:
            return {"mean": 0.0, "p50": 0.0, "p95": 0.0, "max": 0.0, "fps": 0.0}
        times = np.asarray(self.frame_ms)
        p50, p95 = np.percentile(times, (50, 95))
        fps = 1000.0 / float(np.mean(times[-30:]))
        return {
            "mean": float(times.mean()),
            "p50": float(p50),
            "p95": float(p95),
            "max": float(times.max()),
            "fps": fps,
        }
