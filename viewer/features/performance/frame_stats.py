"""Figures of the performance page: frame times and samples per ray.

Counted in a small picture of the same view, over the rays that hit something: those whose opacity exceeds one step of an
8-bit channel.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from viewer.app.application import App

KEPT = 240
AVERAGED = 30  # frames, of the usual time and rate


class FrameStats:
    """The last `KEPT` drawn frames, milliseconds."""

    def __init__(self) -> None:
        self.scene_ms: deque[float] = deque(maxlen=KEPT)  # drawing the picture, wall clock
        self.gpu_ms: deque[float] = deque(maxlen=KEPT)  # the same by the GPU's timer; NaN where it is unreliable
        self.frame_ms: deque[float] = deque(maxlen=KEPT)  # from frame to frame while frames follow one another

    def add(self, frame_ms: float, scene_ms: float, gpu_ms: float | None = None) -> None:
        self.scene_ms.append(scene_ms)
        self.gpu_ms.append(float("nan") if gpu_ms is None else gpu_ms)
        self.frame_ms.append(frame_ms)

    @property
    def mean_ms(self) -> float:
        """From frame to frame, of the last AVERAGED frames; 0 before the first. All of the UI shows it, and the `fps`."""
        return float(np.asarray(self.frame_ms)[-AVERAGED:].mean()) if self.frame_ms else 0.0

    @property
    def fps(self) -> float:
        return 1000.0 / self.mean_ms if self.mean_ms > 0 else 0.0


# --- Ray costs ---

LONGEST_SIDE = 192  # pixels of the picture that is counted in
HIT = 1.0 / 255.0  # opacity


@dataclass(frozen=True, eq=False)
class RayCosts:
    """samples, jumps: of each ray that hit, float32 [n]; one 0 if none did. hit: their share, 0 … 1. size: of the picture."""

    samples: np.ndarray
    jumps: np.ndarray
    hit: float
    size: tuple[int, int]

    @classmethod
    def of(cls, counts: np.ndarray) -> RayCosts:
        """From float32 [h, w, …]: samples, jumps, opacity."""
        hit = counts[..., 2] > HIT
        counted = counts[hit] if hit.any() else np.zeros((1, 2), np.float32)
        return cls(counted[:, 0], counted[:, 1], float(hit.mean()), (counts.shape[1], counts.shape[0]))


@dataclass
class CostMeter:
    """enabled: whether rays are counted at all. costs: of the view that rested last, None before."""

    enabled: bool = False
    costs: RayCosts | None = None
    _measured: tuple[object, ...] = field(default=())

    def switch(self, on: bool) -> None:
        self.enabled, self.costs, self._measured = on, None, ()

    def measure(self, app: App) -> None:
        """Updates the figures; call while nothing moves. Does nothing while counting is off."""
        if not self.enabled or app.canvas is None or app.scene is None:
            return
        camera, settings = app.camera(), replace(app.settings, mode="samples", raw=True)
        key = (id(app.scene.pack), settings, camera.key)
        if key == self._measured:
            return
        self._measured = key
        scale = min(1.0, LONGEST_SIDE / max(camera.width, camera.height))
        size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
        self.costs = RayCosts.of(app.canvas.raw(camera.resized(*size), settings))
        app.touch()
