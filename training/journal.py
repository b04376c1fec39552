"""metrics.jsonl: one JSON object a line, in the order of steps, trimmed when a run goes back to a checkpoint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from console.atomic import write_file
from console.json_text import parse_json
from training.checkpoints import cannot_write

TIMES = ("seconds", "training_seconds")
TEXTS = ("view",)  # the rest are numbers
LARGEST = 1e30  # far from where sums and axes end


class Journal:
    """A run's metrics.jsonl, on disk and as `records`. Each record has "step" (steps done), "seconds" (wall time of the
    run) and "training_seconds" (the same without validation and reports).
    """

    def __init__(self, path: Path, step: int, *, writes: bool = True) -> None:
        """Opens the journal of a run that stands at `step`: later records, and a half-written line, are dropped.

        writes: False only reads (the processes of a run but the first).
        """
        self.path, self._writes = path, writes
        self.records = [record for record in read_journal(path) if record["step"] <= step]
        last = self.records[-1] if self.records else {}
        self.seconds = float(last.get("seconds", 0.0))
        self.training_seconds = float(last.get("training_seconds", self.seconds))
        if writes:
            try:
                write_file(path, "".join(json.dumps(record) + "\n" for record in self.records))
            except OSError as error:
                raise cannot_write(path, error) from error

    def write(self, record: dict[str, Any]) -> None:
        """Appends one record. UserError where the disk is full."""
        self.records.append(record)
        if not self._writes:
            return
        try:
            with open(self.path, "a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")
        except OSError as error:
            raise cannot_write(self.path, error) from error


def read_journal(path: Path) -> list[dict[str, Any]]:
    """The records of a metrics.jsonl. Lines that are no record (cut off by a kill) are left out, and of records whatever is
    neither text nor a number that can be drawn."""
    records = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if path.is_file() else ():
        try:
            record = parse_json(line)
        except ValueError:
            continue
        if isinstance(record, dict) and _is_step(record.get("step")) and all(_is_time(name, record) for name in TIMES):
            records.append({name: value for name, value in record.items() if _is_plain(name, value)})
    return records


def _is_step(value: Any) -> bool:
    return type(value) is int and value >= 0


def _is_time(name: str, record: dict[str, Any]) -> bool:
    """Whether a record has this time and it is one; the second of TIMES may be missing."""
    value = record.get(name, None if name == TIMES[0] else 0.0)
    return _is_number(value) and value >= 0


def _is_plain(name: str, value: Any) -> bool:
    return isinstance(value, str) if name in TEXTS else _is_number(value)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) < LARGEST
