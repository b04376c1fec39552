"""metrics.jsonl: one JSON object a line, in the order of steps, trimmed when a run goes back to a checkpoint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from training.checkpoints import cannot_write, write_aside


class Journal:
    """Appends records to a run's metrics.jsonl; each has "step" (steps done) and "seconds" (wall time of
    training).
    """

    def __init__(self, path: Path, step: int) -> None:
        """Opens the journal of a run that stands at `step`: later records, and a half-written line, are dropped."""
        self.path = path
        kept = [record for record in read_journal(path) if record["step"] <= step]
        self.seconds = float(kept[-1].get("seconds", 0.0)) if kept else 0.0
        try:
            write_aside(path, "".join(json.dumps(record) + "\n" for record in kept).encode())
        except OSError as error:
            raise cannot_write(path, error) from error

    def write(self, record: dict[str, Any]) -> None:
        """Appends one record. UserError where the disk is full."""
        try:
            with open(self.path, "a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")
        except OSError as error:
            raise cannot_write(self.path, error) from error


def read_journal(path: Path) -> list[dict[str, Any]]:
    """The records of a metrics.jsonl; lines that are no record (cut off by a kill) are left out."""
    records = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if path.is_file() else ():
        try:
            record = json.loads(line)
        except ValueError:
            continue
        if isinstance(record, dict) and isinstance(record.get("step"), int):
            records.append(record)
    return records
