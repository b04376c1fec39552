"""What an export would look like, made in a thread while its choices are made: coarse, and anew with each of them."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from console import UserError
from scenepack.pack import Pack
from viewer.app.background import Task

if TYPE_CHECKING:  # SciPy is loaded once it is needed
    from scenepack.exports.export_preview import PreviewGeometry
    from scenepack.exports.scene import Export

SETTLED_S = 0.25  # without a change, before it is begun: sliders pass through many values


class _Superseded(Exception):
    """Something else is wanted by now."""


class ExportPreview:
    """geometry: the newest one, also while another is made; None before the first. error: why there is none of what is wanted."""

    def __init__(self) -> None:
        self.geometry: PreviewGeometry | None = None
        self.error = ""
        self._wanted: tuple[int, Export] | None = None
        self._changed, self._begun = 0.0, True
        self._task: Task[None] | None = None
        self._share = 0.0
        self._told: object = None

    @property
    def working(self) -> bool:
        """Whether another preview is wanted and not there yet."""
        return not self._begun or self._busy

    @property
    def _busy(self) -> bool:
        return self._task is not None and not self._task.finished  # what is superseded ends at its next report

    @property
    def share(self) -> float:
        """How much of what is being made is done, 0 … 1."""
        return self._share

    def follow(self, pack: Pack, export: Export) -> None:
        """What is wanted now. Call it often."""
        wanted = (id(pack), export)
        if wanted != self._wanted:
            self._wanted, self._changed, self._begun = wanted, time.monotonic(), False
        first = self.geometry is None and not self.error
        if not self._begun and not self._busy and (first or time.monotonic() - self._changed >= SETTLED_S):
            self._begun, self._share = True, 0.0
            self._task = Task(lambda: self._make(pack, wanted))

    def news(self) -> bool:
        """Whether there is something else to show since this was asked last."""
        state = (self.geometry, self.error, self.working, round(50 * self._share))
        told, self._told = self._told, state
        return told != state

    def close(self) -> None:
        """Nothing is wanted any more."""
        self._wanted = None

    def _make(self, pack: Pack, wanted: tuple[int, Export]) -> None:
        from scenepack.exports.export_preview import preview_geometry

        def tell(share: float, note: str) -> None:
            if self._wanted != wanted:
                raise _Superseded
            self._share = share

        try:
            made = preview_geometry(pack, wanted[1], tell)
            tell(1.0, "")
            self.geometry, self.error = made, ""
        except _Superseded:
            pass
        except (UserError, MemoryError) as error:
            self.error = error.what if isinstance(error, UserError) else "there is not enough memory for a preview"
