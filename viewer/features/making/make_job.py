"""Make job: the process that makes a scene, and what it leaves to look at: progress, previews, rejected photographs."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from console import UserError, collect_notices
from console.json_text import read_json_file
from scenepack.pack import Pack
from scenepack.reader import load_pack
from training.scenes.pictures import UNREADABLE, small_picture
from viewer.core.files import POSED, REPORT
from viewer.core.tasks import CommandProcess, Task
from viewer.features.making.make_plan import Plan
from viewer.features.opening.opening import work_out_ahead
from viewer.rendering.targets import Sheet

T = TypeVar("T")
KEPT_FIGURES = 400
PICTURE_SIDE = 512  # pixels of the longer side, at most


class FileWatch(Generic[T]):
    """Reads a file in a thread whenever it has changed. Its writer renames it into place, so that it is always whole."""

    def __init__(self, file: Path, read: Callable[[Path], T]) -> None:
        self._file, self._read = file, read
        self._seen: tuple[int, int] | None = None  # inode and time of the file that was read last
        self._task: Task[T | None] | None = None

    def poll(self) -> T | None:
        """What was read since the last call, if anything. Never waits; starts to read a file that has changed."""
        if self._task is not None and self._task.finished:
            task, self._task = self._task, None
            return task.result()
        if self._task is None:
            with contextlib.suppress(OSError):  # none yet, or no more
                there = self._file.stat()
                if self._seen != (there.st_ino, there.st_mtime_ns):
                    self._seen = there.st_ino, there.st_mtime_ns
                    self._task = Task(self._try_to_read)
        return None

    def _try_to_read(self) -> T | None:
        try:
            with collect_notices():
                return self._read(self._file)
        except Exception:  # gone meanwhile, or none of ours: the next will do, and the pack in the end
            return None


def read_preview(file: Path) -> Pack:
    """The state of a training run as a pack."""
    pack = load_pack(file)
    work_out_ahead(pack)
    return pack


def preview_title(preview: Pack) -> str:
    provenance: Any = preview.metadata["provenance"]
    return f"preview after {provenance['steps']:,} steps"


@dataclass
class MakeJob:
    plan: Plan
    child: CommandProcess
    status: int | None = None  # of the process, once it has ended
    figures: list[float] = field(default_factory=list)  # PSNR (dB) during training
    warnings: list[str] = field(default_factory=list)  # of the process
    picture: np.ndarray | None = None  # a held-out photograph beside its rendering, uint8 [h, w, 3]
    preview: Pack | None = None  # the newest state of the training
    preview_offered: bool = False  # whether one was shown without being asked for

    def __post_init__(self) -> None:
        latest = self.plan.run / "validation" / "latest.png"
        self._pictures = FileWatch(latest, lambda file: np.asarray(small_picture(file, PICTURE_SIDE, "RGB")))
        self._previews = None if self.plan.poses_only else FileWatch(self.plan.preview_file, read_preview)

    @property
    def stage(self) -> int:
        """Number of the plan's stage, from 1; 0 before the first report."""
        if self.child.report is None:
            return 0
        name = {"poses": "Poses", "baking": "Baking"}.get(self.child.report.stage, "Training")
        return self.plan.stages.index(name) + 1 if name in self.plan.stages else 1

    def poll(self) -> bool:
        """Reads new progress, pictures and previews; True if there is something new to show on the card."""
        before, picture = self.child.report, self._pictures.poll()
        self.status = self.child.poll()
        if self._previews is not None:
            self.preview = self._previews.poll() or self.preview
        report = self.child.report
        if report != before:
            self.warnings = self.child.warnings()
        if picture is not None:
            self.picture = picture
        if report is not None and (before is None or report.done != before.done) and "psnr" in report.metrics:
            self.figures = [*self.figures[-KEPT_FIGURES + 1 :], report.metrics["psnr"]]
        return report != before or picture is not None


# --- Rejected photographs ---

UNFINISHED = Path("posing") / "left_out.json"
CELL, MOST = 128, 24  # pixels of the longer side; number of thumbnails


class RejectedPhotographs(Task[None], Sheet):
    """Reads their thumbnails in a thread; unreadable pictures have none."""

    def __init__(self, why: Mapping[str, str], files: Mapping[str, Path]) -> None:
        self.why = why  # reason by name, in order
        self._files = files
        Sheet.__init__(self, CELL, min(len(why), MOST), 1)
        super().__init__(self._read)

    def _read(self) -> None:
        for index, name in enumerate(list(self.why)[:MOST]):
            with contextlib.suppress(UserError, *UNREADABLE):  # gone, or only the program that finds poses can read it
                self.put(index, np.asarray(small_picture(self._files[name], CELL, "RGB")))


def rejected_photographs_of(out: Path) -> RejectedPhotographs | None:
    """Those that training.posing listed beside the poses, or in its working folder if it failed; None for none."""
    for file in (out / POSED / REPORT, out / UNFINISHED):
        try:
            said = read_json_file(file)
            why = {str(name): str(reason) for name, reason in said["left_out"].items()}
            source, kept = Path(said["photographs"]), dict(said.get("files", {}))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        files = {name: Path(kept[name]) if name in kept else source / name for name in why}
        return RejectedPhotographs(why, files) if why else None
    return None
