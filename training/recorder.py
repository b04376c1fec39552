"""What a run leaves to look at while it trains: metrics.jsonl, validation/, curves.png; and at its end report/.

Only process 0 writes and renders; in the others these calls do next to nothing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
from PIL import Image

from console.atomic import replacing, write_file
from training.checkpoints import writing
from training.dataset import RayDataset
from training.devices import here, is_writer
from training.method import Method, Rays
from training.metrics import psnr
from training.metrics_log import MetricsLog
from training.report import draw_curves, write_report
from training.run import Run
from training.scenes import Photograph, Scene
from training.scenes.pictures import over_background

VALIDATION_PIXELS = 200 * 200  # a validation picture should cost seconds, not minutes
DRAW_EVERY_SECONDS = 15.0  # curves are drawn anew at most so often, and at the end


class Recorder:
    """Records one run. `seconds` counts all times that the run was trained, `training_seconds` without what paused() spans."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.log = MetricsLog(run.path / "metrics.jsonl", run.step, writes=is_writer())
        self._start = time.monotonic() - self.log.seconds
        self._paused = self.log.seconds - self.log.training_seconds
        self._last_record: tuple[int, float] | None = None  # its step and training_seconds
        self._photographs = validation_photographs(run.scene, run.config.validate_views)
        self._drawn_at = 0.0

    @property
    def seconds(self) -> float:
        """Wall time of the run so far."""
        return time.monotonic() - self._start

    @property
    def training_seconds(self) -> float:
        """The same without validation, reports and whoever watches."""
        return self.seconds - self._paused

    @contextmanager
    def paused(self) -> Iterator[None]:
        """What the block does is not training."""
        started = time.monotonic()
        try:
            yield
        finally:
            self._paused += time.monotonic() - started

    def record(self, metrics: dict[str, float]) -> dict[str, float]:
        """Writes a step's metrics to the log; returns the few that progress shows."""
        steps = self._steps_per_second()
        record, shown = {**self._when(), **metrics}, {"psnr": metrics["psnr"]}
        if steps is not None:
            rays = metrics.get("rays", float(self.run.config.batch_size)) * steps
            record |= {"steps_per_second": round(steps, 3), "rays_per_second": round(rays, 1)}
            if "samples" in metrics:
                record["samples_per_second"] = round(metrics["samples"] * steps, 1)
            shown["rays_per_second"] = rays
        self._write(record)
        return shown

    def validate(self) -> None:
        """Renders held-out photographs: their mean PSNR to the log; of the first "photograph | rendering" as a PNG, and the
        same as latest.png beside it, where a viewer of pictures can watch it change."""
        if not is_writer():
            return
        run, when = self.run, self._when()
        picture = run.path / "validation" / f"step_{run.step:08d}.png"
        with self.paused(), writing(picture):
            state, scores = here(run.state), []
            for photograph in self._photographs:
                rendered, truth = render_photograph(run.method, state, run.dataset, photograph, VALIDATION_PIXELS)
                scores.append(psnr(rendered, truth))
                if len(scores) == 1:
                    picture.parent.mkdir(parents=True, exist_ok=True)
                    _save_side_by_side([truth, rendered], picture)
                    write_file(picture.with_name("latest.png"), picture.read_bytes())
        record = {**when, "validation_psnr": float(np.mean(scores)), "view": self._photographs[0].name}
        self._write(record | ({"views": len(scores)} if len(scores) > 1 else {}))

    def has_validated(self) -> bool:
        """Whether the log has a validation of the step that the run stands at."""
        return any(r["step"] == self.run.step and "validation_psnr" in r for r in self.log.records)

    def report(self) -> None:
        """The final report, from everything in the log."""
        if is_writer():
            with self.paused():
                self._draw()
                write_report(self.run, self.log.records)

    def _when(self) -> dict[str, Any]:
        times = {"seconds": round(self.seconds, 3), "training_seconds": round(self.training_seconds, 3)}
        return {"step": self.run.step, **times}

    def _steps_per_second(self) -> float | None:
        """Since it was asked last; None the first time, since that stretch holds the compilation."""
        before, self._last_record = self._last_record, (self.run.step, self.training_seconds)
        if before is None or self.run.step <= before[0]:
            return None
        return (self.run.step - before[0]) / max(self._last_record[1] - before[1], 1e-9)

    def _write(self, record: dict[str, Any]) -> None:
        self.log.write(record)
        if is_writer() and self.seconds - self._drawn_at > DRAW_EVERY_SECONDS:
            with self.paused():
                self._draw()

    def _draw(self) -> None:
        picture = self.run.path / "curves.png"
        with writing(picture):
            draw_curves(self.log.records, picture, f"{self.run.scene.path.name}: PSNR")
        self._drawn_at = self.seconds


def validation_photographs(scene: Scene, count: int) -> tuple[Photograph, ...]:
    """`count` photographs (or all there are) spread evenly over val, else test, else (for want of better) train.

    The middle one of the split comes first: it is the one that is pictured.
    """
    photographs = next(scene.splits[split] for split in ("val", "test", "train") if scene.splits.get(split))
    middle = len(photographs) // 2
    spread = np.unique(np.linspace(0, len(photographs) - 1, max(count, 1)).round().astype(int))
    others = [i for i in spread if i != middle]
    if len(others) == max(count, 1):
        others.remove(min(others, key=lambda i: abs(i - middle)))
    return (photographs[middle], *(photographs[i] for i in others))


def render_photograph(
    method: Method, state: Any, dataset: RayDataset, photograph: Photograph, max_pixels: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(rendered, photographed), float32 [H, W, 3] in [0, 1] over the background.

    max_pixels: where there are more, one in so many of each row and column is compared. Both are never shrunk: a ray through the
    middle of a larger pixel does not see what a shrunk photograph shows (a lego at 800 × 800 then scored 29.5 dB, not 33.7).
    """
    camera = photograph.camera
    step = max(1, math.ceil(math.sqrt(camera.width * camera.height / (max_pixels or math.inf))))
    rows, columns = (slice(step // 2 % n, None, step) for n in (camera.height, camera.width))
    pixels = np.arange(camera.height * camera.width).reshape(camera.height, camera.width)[rows, columns]
    rays = Rays(*(array[pixels.ravel()] for array in dataset.view_rays(camera)))
    rgb = np.asarray(jax.device_get(method.render(state, rays).rgb))
    truth = over_background(photograph.load(), dataset.background)
    return np.clip(rgb.reshape(*pixels.shape, 3), 0.0, 1.0), truth.reshape(-1, 3)[pixels]


def _save_side_by_side(pictures: Sequence[np.ndarray], path: Path) -> None:
    """Writes pictures float [H, W, 3] of one height next to each other as a PNG."""
    row = np.rint(np.clip(np.concatenate(pictures, axis=1), 0, 1) * 255).astype(np.uint8)
    with replacing(path) as new:
        Image.fromarray(row).save(new, format="PNG")
