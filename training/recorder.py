"""What a run leaves to look at while it trains: metrics.jsonl, validation/, curves.png; and at its end report/.

Only process 0 writes and renders; in the others these calls do next to nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from training.checkpoints import cannot_write
from training.clock import Clock
from training.curves import draw_curves
from training.devices import here, is_writer
from training.journal import Journal
from training.report import write_report
from training.run import Run
from training.validation import validate, validation_photographs

VALIDATION_PIXELS = 200 * 200  # a validation picture should cost seconds, not minutes
DRAW_EVERY_SECONDS = 15.0  # curves are drawn anew at most so often, and at the end


class Recorder:
    """Watches over one run."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.journal = Journal(run.path / "metrics.jsonl", run.step, writes=is_writer())
        self.clock = Clock(self.journal.seconds, self.journal.training_seconds)
        self._photographs = validation_photographs(run.scene, run.config.validate_views)
        self._drawn = 0.0

    @property
    def seconds(self) -> float:
        """Wall time of the run so far."""
        return self.clock.seconds

    def log(self, metrics: dict[str, float]) -> dict[str, float]:
        """A line of the journal from a step's metrics; returns the few that progress shows."""
        steps = self.clock.steps_per_second(self.run.step)
        record = {**self._when(), **metrics}
        shown = {"psnr": metrics["psnr"]}
        if steps is not None:
            rays = metrics.get("rays", float(self.run.config.batch_size)) * steps
            record |= {"steps_per_second": round(steps, 3), "rays_per_second": round(rays, 1)}
            if "samples" in metrics:
                record["samples_per_second"] = round(metrics["samples"] * steps, 1)
            shown["rays_per_second"] = rays
        self.journal.write(record)
        self._draw_now_and_then()
        return shown

    def validate(self) -> None:
        """Renders held-out photographs: mean PSNR to the journal, and one picture."""
        run = self.run
        picture = run.path / "validation" / f"step_{run.step:08d}.png"
        when = self._when()
        if not is_writer():
            return
        with self.clock.paused():
            try:
                state = here(run.state)
                scores = validate(run.method, state, run.dataset, self._photographs, picture, VALIDATION_PIXELS)
            except OSError as error:
                raise cannot_write(picture, error) from error
        record = {**when, "validation_psnr": float(np.mean(scores)), "view": self._photographs[0].name}
        if len(scores) > 1:
            record |= {"views": len(scores)}
        self.journal.write(record)
        self._draw_now_and_then()

    def has_validated(self) -> bool:
        """Whether the journal has a validation of the step that the run stands at."""
        return any(r["step"] == self.run.step and "validation_psnr" in r for r in self.journal.records)

    def report(self) -> None:
        """The final report, from everything in the journal."""
        if is_writer():
            with self.clock.paused():
                self._draw()
                write_report(self.run, self.journal.records)

    def _when(self) -> dict[str, Any]:
        return {
            "step": self.run.step,
            "seconds": round(self.clock.seconds, 3),
            "training_seconds": round(self.clock.training_seconds, 3),
        }

    def _draw_now_and_then(self) -> None:
        if self.clock.seconds - self._drawn > DRAW_EVERY_SECONDS:
            self._draw()

    def _draw(self) -> None:
        if not is_writer():
            return
        picture = self.run.path / "curves.png"
        with self.clock.paused():
            try:
                draw_curves(self.journal.records, picture, f"{self.run.scene.path.name}: PSNR")
            except OSError as error:
                raise cannot_write(picture, error) from error
        self._drawn = self.clock.seconds
