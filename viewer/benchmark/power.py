"""What the graphics card draws, in watts, through NVML where nvidia-ml-py and an NVIDIA card are there."""

from __future__ import annotations

import threading
from contextlib import suppress
from types import TracebackType

EVERY_S = 0.05


class PowerMeter:
    """Averages the card's power while the `with` block runs. watts: None where it cannot be told."""

    def __init__(self, renderer: str) -> None:
        """renderer: GL_RENDERER; on a software rasteriser no card is asked."""
        self.watts: float | None = None
        self._readings: list[float] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        if "nvidia" not in renderer.lower():
            return
        try:
            import pynvml  # pyright: ignore[reportMissingImports]

            pynvml.nvmlInit()
            self._handle = pynvml.nvmlDeviceGetHandleByIndex(0)
            self._nvml = pynvml
            self._read()
        except Exception:  # no package, no driver, or a card that does not tell: each has errors of its own
            return
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def _read(self) -> None:
        self._readings.append(self._nvml.nvmlDeviceGetPowerUsage(self._handle) / 1000.0)

    def _watch(self) -> None:
        while not self._stop.wait(EVERY_S):
            with suppress(Exception):  # one reading less
                self._read()

    def __enter__(self) -> PowerMeter:
        if self._thread is not None:
            self._readings.clear()
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            if self._readings:
                self.watts = sum(self._readings) / len(self._readings)
