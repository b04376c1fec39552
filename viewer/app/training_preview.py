"""Training preview: the small pack of the present state that the training process writes now and then (baker.baking.preview).

A thread reads it. The writer replaces the file by a rename, so a file that is being read stays whole.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenepack.pack import Pack
from scenepack.reader import load_pack
from viewer.app.background import Task
from viewer.app.loading import work_out_ahead

FILE = "preview.zip"  # in the folder for the results; equals baker.baking.preview.NAME
EVERY_S = 30  # interval that the training process is asked for


@dataclass(frozen=True)
class TrainingPreview:
    """The state of a training run as a pack."""

    pack: Pack
    steps: int  # done
    of_steps: int  # in all; 0 if unknown

    @property
    def description(self) -> str:
        """What is shown, for people."""
        return f"preview after {self.steps:,} steps"


class TrainingPreviewFile:
    """Reads the file in a thread. Call `poll` now and then."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._seen: tuple[int, int] | None = None  # inode and time of the file that was read last
        self._task: Task[TrainingPreview | None] | None = None

    def poll(self) -> TrainingPreview | None:
        """A preview that was read since the last call, if any. Never waits; starts to read a file that has changed."""
        if self.reading:
            return None
        task, self._task = self._task, None
        if task is not None and (read := task.result()) is not None:
            return read
        try:
            there = self.file.stat()
        except OSError:  # none yet, or no more
            return None
        if self._seen != (there.st_ino, there.st_mtime_ns):
            self._seen = there.st_ino, there.st_mtime_ns
            self._task = Task(self._read)
        return None

    @property
    def reading(self) -> bool:
        return self._task is not None and not self._task.finished

    def _read(self) -> TrainingPreview | None:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                pack = load_pack(self.file)
            made: Any = pack.metadata.get("provenance")
            work_out_ahead(pack)
            return TrainingPreview(pack, int(made["steps"]), int(made.get("of_steps", 0)))
        except Exception:  # gone meanwhile, or none of ours: the next will do, and the pack in the end
            return None
