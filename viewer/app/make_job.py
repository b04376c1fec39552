"""Make job: the process that makes a scene, with its progress for the window."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from PIL import Image

from console.progress_protocol import Report
from viewer.app.command_process import CommandProcess
from viewer.app.make_plan import Plan

KEPT_FIGURES = 400
PICTURE_SIDE = 512  # pixels of the longer side, at most


@dataclass
class MakeJob:
    """A running or stopped job."""

    plan: Plan
    child: CommandProcess
    started: float = field(default_factory=time.monotonic)
    report: Report | None = None  # the last progress that the process reported
    figures: list[float] = field(default_factory=list)  # PSNR (dB) during training
    picture: np.ndarray | None = None  # a held-out photograph beside its rendering, uint8 [h, w, 3]
    _picture_time: float = 0.0

    @property
    def stopping(self) -> bool:
        """Whether it was asked to stop."""
        return self.child.stopping

    @property
    def stage(self) -> int:
        """Number of the plan's stage, from 1; 0 before the first report."""
        if self.report is None:
            return 0
        name = {"poses": "Poses", "baking": "Baking"}.get(self.report.stage, "Training")
        return self.plan.stages.index(name) + 1 if name in self.plan.stages else 1

    def poll(self) -> bool:
        """Reads new progress; True if there is something new to show."""
        report = self.child.report()
        changed = report is not None and report != self.report
        if changed and report is not None:
            later, self.report = self.report is None or report.done != self.report.done, report
            if later and "psnr" in report.metrics:
                self.figures = [*self.figures[-KEPT_FIGURES + 1 :], report.metrics["psnr"]]
        return self._read_picture() or changed

    def _read_picture(self) -> bool:
        file = self.plan.run / "validation" / "latest.png"
        try:
            changed = file.stat().st_mtime
            if changed == self._picture_time:
                return False
            with Image.open(file, formats=["PNG"]) as opened:
                picture = opened.convert("RGB")
            picture.thumbnail((PICTURE_SIDE, PICTURE_SIDE))
            self.picture, self._picture_time = np.asarray(picture), changed
        except (OSError, ValueError):  # not there yet
            return False
        return True
