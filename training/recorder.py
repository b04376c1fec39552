"""What a run writes for people while it trains: metrics.jsonl, validation/, curves.png.

metrics.jsonl has one JSON object a line, in the order of steps, each with "step" (steps done), "seconds" (wall time of the run)
and "training_seconds" (the same without validation and pictures). Only process 0 writes and renders.
"""

import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
from PIL import Image

from console.atomic import replacing, write_file
from console.json_text import parse_json
from console.plots import Line, Plot, draw_plots
from training.checkpoints import writing
from training.dataset import RayDataset
from training.devices import here, is_writer
from training.method import Method, Rays
from training.rendering import psnr_of
from training.run import Run
from training.scenes import Photograph, Scene
from training.scenes.pictures import over_background

Records = Sequence[Mapping[str, Any]]
POINTS = 400  # of a curve; more are averaged
TEXTS = ("view",)  # the records' values that are no numbers
LARGEST = 1e30  # of a record's numbers; far from where sums and axes end
VALIDATION_PIXELS = 200 * 200  # a validation picture should cost seconds, not minutes
DRAW_EVERY_SECONDS = 15.0  # curves are drawn anew at most so often, and at the end


class Recorder:
    """Records one run; records: what metrics.jsonl says up to its step. `seconds` counts all times that it was trained,
    `training_seconds` without those within paused()."""

    def __init__(self, run: Run) -> None:
        self.run, self._log = run, run.path / "metrics.jsonl"
        self.records = [record for record in read_metrics(self._log) if record["step"] <= run.step]
        last = self.records[-1] if self.records else {"seconds": 0.0}
        self._start = time.monotonic() - last["seconds"]
        self._paused = last["seconds"] - last.get("training_seconds", last["seconds"])
        self._last_record: tuple[int, float] | None = None  # its step and training_seconds
        self._photographs = validation_photographs(run.scene, run.config.validate_views)
        self._drawn_at = 0.0
        if is_writer():
            with writing(self._log):
                write_file(self._log, "".join(json.dumps(record) + "\n" for record in self.records))

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._start

    @property
    def training_seconds(self) -> float:
        return self.seconds - self._paused

    @contextmanager
    def paused(self) -> Iterator[None]:
        """The time of the block does not count as training."""
        started = time.monotonic()
        try:
            yield
        finally:
            self._paused += time.monotonic() - started

    def record(self, metrics: dict[str, float]) -> dict[str, float]:
        """Writes a step's metrics to the log; returns the few that progress shows."""
        record, shown = {**self._when(), **metrics}, {"psnr": metrics["psnr"]}
        before, self._last_record = self._last_record, (self.run.step, self.training_seconds)
        if before is not None and self.run.step > before[0]:  # the first stretch holds the compilation
            steps = (self.run.step - before[0]) / max(self._last_record[1] - before[1], 1e-9)
            rays = metrics["rays"] * steps
            record |= {"steps_per_second": round(steps, 3), "rays_per_second": round(rays, 1)}
            if "samples" in metrics:
                record["samples_per_second"] = round(metrics["samples"] * steps, 1)
            shown["rays_per_second"] = rays
        self._write(record)
        return shown

    def validate(self) -> None:
        """Renders held-out photographs: their mean PSNR to the log, the first beside its rendering to a PNG and latest.png."""
        if not is_writer():
            return
        run, when = self.run, self._when()
        picture = run.path / "validation" / f"step_{run.step:08d}.png"
        with self.paused(), writing(picture):
            state, scores = here(run.state), []
            for photograph in self._photographs:
                rendered, truth = render_photograph(run.method, state, run.dataset, photograph, VALIDATION_PIXELS)
                scores.append(float(psnr_of(np.square(rendered - truth).mean())))
                if len(scores) == 1:
                    picture.parent.mkdir(parents=True, exist_ok=True)
                    row = np.rint(np.clip(np.concatenate([truth, rendered], axis=1), 0, 1) * 255).astype(np.uint8)
                    with replacing(picture) as new:
                        Image.fromarray(row).save(new, format="PNG")
                    write_file(picture.with_name("latest.png"), picture.read_bytes())
        record = {**when, "validation_psnr": float(np.mean(scores)), "view": self._photographs[0].name}
        self._write(record | ({"views": len(scores)} if len(scores) > 1 else {}))

    def _when(self) -> dict[str, Any]:
        times = {"seconds": round(self.seconds, 3), "training_seconds": round(self.training_seconds, 3)}
        return {"step": self.run.step, **times}

    def _write(self, record: dict[str, Any]) -> None:
        self.records.append(record)
        if not is_writer():
            return
        with writing(self._log), self._log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
        if self.seconds - self._drawn_at > DRAW_EVERY_SECONDS:
            self.draw()

    def draw(self) -> None:
        """The curves, from everything in the log."""
        if not is_writer():
            return
        picture = self.run.path / "curves.png"
        with self.paused(), writing(picture):
            draw_curves(self.records, picture, f"{self.run.scene.path.name}: PSNR")
        self._drawn_at = self.seconds


def validation_photographs(scene: Scene, count: int) -> tuple[Photograph, ...]:
    """`count` photographs (or all) spread evenly over val, else test, else train; the middle one, which is pictured, first."""
    photographs = next(scene.splits[split] for split in ("val", "test", "train") if scene.splits.get(split))
    middle = len(photographs) // 2
    spread = np.unique(np.linspace(0, len(photographs) - 1, max(count, 1)).round().astype(int))
    others = np.delete(spread, np.abs(spread - middle).argmin())
    return (photographs[middle], *(photographs[i] for i in others))


def render_photograph(
    method: Method, state: Any, dataset: RayDataset, photograph: Photograph, max_pixels: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(rendered, photographed), float32 [H, W, 3] in [0, 1] over the background.

    max_pixels: where there are more, one in so many of each row and column is compared. Shrunk photographs would not show what
    rays through the middles of larger pixels see.
    """
    camera = photograph.camera
    step = max(1, math.ceil(math.sqrt(camera.width * camera.height / (max_pixels or math.inf))))
    rows, columns = (slice(step // 2 % n, None, step) for n in (camera.height, camera.width))
    pixels = np.arange(camera.height * camera.width).reshape(camera.height, camera.width)[rows, columns]
    rays = Rays(*(array[pixels.ravel()] for array in dataset.view_rays(camera)))
    rgb = np.asarray(jax.device_get(method.render(state, rays).rgb))
    truth = over_background(photograph.load(), dataset.background)
    return np.clip(rgb.reshape(*pixels.shape, 3), 0.0, 1.0), truth.reshape(-1, 3)[pixels]


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """The records of a metrics.jsonl, without values that cannot be drawn, and without lines that a kill cut off."""
    records = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if path.is_file() else ():
        try:
            record = parse_json(line)
        except ValueError:
            continue
        if not isinstance(record, dict) or type(record.get("step")) is not int:
            continue
        times = [record["step"], record.get("seconds"), record.get("training_seconds", 0.0)]
        if all(_is_number(time) and time >= 0 for time in times):
            records.append({n: v for n, v in record.items() if (isinstance(v, str) if n in TEXTS else _is_number(v))})
    return records


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) < LARGEST


# --- curves.png --------------------------------------------------------------------------------------------------------


def draw_curves(records: Records, path: Path, title: str) -> None:
    """PSNR, loss and rays per second over the steps as a PNG, without empty curves. OSError where it cannot be written."""
    psnr = _curve("training rays", records, "psnr")
    psnr += _curve("photographs held out", records, "validation_psnr", marked=True)
    loss = _curve("loss", [r for r in records if r.get("loss", 0.0) > 0], "loss")
    speed = _curve("rays per second", records, "rays_per_second")
    plots = [
        Plot(psnr, title, "steps", "PSNR (dB)", "data"),
        Plot(loss, "loss", "steps", "loss", "log"),
        Plot(speed, "rays per second", "steps", "rays per second", "zero"),
    ]
    if plots := [plot for plot in plots if plot.lines]:
        draw_plots(path, plots, (720, 270))


def _curve(label: str, records: Records, name: str, *, marked: bool = False) -> list[Line]:
    """At most POINTS points, means of equal numbers of neighbours; nothing where no record has a value."""
    points = [(r["step"], r[name]) for r in records if name in r and np.isfinite(r[name])]
    if not points:
        return []
    means = [part.mean(axis=0).tolist() for part in np.array_split(np.array(points, float), min(len(points), POINTS))]
    return [Line(label, *map(list, zip(*means, strict=True)), marked=marked)]
