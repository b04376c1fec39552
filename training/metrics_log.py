"""metrics.jsonl: one JSON object a line, in the order of steps, trimmed when a run goes back to a checkpoint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from console.atomic import write_file
from console.json_text import parse_json
from training.checkpoints import writing

TEXTS = ("view",)  # the rest are numbers
LARGEST = 1e30  # far from where sums and axes end


class MetricsLog:
    """A run's metrics.jsonl, on disk and as `records`. Each record has "step" (steps done), "seconds" (wall time of the
    run) and "training_seconds" (the same without validation and reports).
    """

    def __init__(self, path: Path, step: int, *, writes: bool = True) -> None:
        """Opens the log of a run that stands at `step`: later records, and a half-written line, are dropped.

        writes: False only reads (the processes of a run but the first).
        """
        self.path, self._writes = path, writes
        self.records = [record for record in read_metrics(path) if record["step"] <= step]
        last = self.records[-1] if self.records else {}
        self.seconds = float(last.get("seconds", 0.0))
        self.training_seconds = float(last.get("training_seconds", self.seconds))
        if writes:
            with writing(path):
                write_file(path, "".join(json.dumps(record) + "\n" for record in self.records))

    def write(self, record: dict[str, Any]) -> None:
        """Appends one record. UserError where the disk is full."""
        self.records.append(record)
        if self._writes:
            with writing(self.path), open(self.path, "a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """The records of a metrics.jsonl. Lines that are no record (cut off by a kill) are left out, and of records whatever is
    neither text nor a number that can be drawn."""
    records = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if path.is_file() else ():
        try:
            record = parse_json(line)
        except ValueError:
            continue
        if isinstance(record, dict) and _has_step_and_times(record):
            plain = {n: v for n, v in record.items() if (isinstance(v, str) if n in TEXTS else _is_number(v))}
            records.append(plain)
    return records


def _has_step_and_times(record: dict[str, Any]) -> bool:
    step, times = record.get("step"), [record.get("seconds"), record.get("training_seconds", 0.0)]
    return type(step) is int and step >= 0 and all(_is_number(time) and time >= 0 for time in times)  # type: ignore[operator]


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) < LARGEST
