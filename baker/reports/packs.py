"""The packs and scores behind a report: each is made once, and packs stay in a folder for the next time.

Beside the pack NAME lies NAME.json: what it was baked from and how (`key`), and the seconds of each stage. A pack whose
key is another one (the run went on, other options) is baked anew.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from baker.baking.bake import BakeConfig, work_key
from baker.baking.to_pack import bake_to
from baker.reports.evaluation import evaluate
from console.atomic import write_file
from training.run import Run
from training.scenes import Scene, picture_stems


@dataclass(frozen=True)
class Baked:
    """A pack on disk and the seconds of each stage of its bake."""

    name: str
    path: Path
    seconds: dict[str, float]


@dataclass
class Study:
    """A run, what it is compared with, and what was made of it so far.

    scene: the photographs that count, in `split`. out: the report's folder. options: how its packs are baked
    where a table does not say otherwise. against: a second run of the same scene.
    """

    run: Run
    scene: Scene
    split: str
    out: Path
    options: BakeConfig
    against: Run | None = None
    scores: dict[Path, dict[str, Any]] = field(default_factory=dict)

    def baked(self, run: Run | None = None, **changes: Any) -> Baked:
        """The pack of a run (by default the report's own), from the shelf where it lies there already.

        changes: fields of BakeConfig that differ from `options`.
        """
        run, config = run or self.run, dataclasses.replace(self.options, **changes)
        name = f"{config.resolution}-{config.fine_tune}"
        name += "" if config.tau_weight > 0 else "-all-voxels"
        name = f"against-{name}" if run is self.against else name
        pack, note = self.out / "packs" / name, self.out / "packs" / f"{name}.json"
        key = work_key(run, config) | {
            "tau_weight": config.tau_weight, "fine_tune": config.fine_tune, "fine_tune_epochs": config.fine_tune_epochs,
        }  # fmt: skip
        kept = _read(note)
        if kept.get("key") == key and pack.is_dir():
            return Baked(name, pack, kept["seconds"])
        note.unlink(missing_ok=True)  # first, so that no note ever tells of another pack
        pack.parent.mkdir(parents=True, exist_ok=True)
        seconds = bake_to(run, config, pack)
        write_file(note, json.dumps({"key": key, "seconds": seconds}, indent=2) + "\n")
        return Baked(name, pack, seconds)

    def score(self, subject: Baked | Run) -> dict[str, Any]:
        """psnr, ssim, lpips: means over the views; a pack is drawn by OpenGL. Pictures go to pictures/NAME."""
        name, path = ("field", subject.path) if isinstance(subject, Run) else (subject.name, subject.path)
        if path not in self.scores:
            what = subject if isinstance(subject, Run) else subject.path
            self.scores[path] = evaluate(what, self.scene, self.split, self.out / "pictures" / name)
        return {key: self.scores[path][key] for key in ("psnr", "ssim", "lpips")}

    def picture(self, name: str) -> str:
        """Where the comparison of the middle view lies after `score`, from the report's folder."""
        photographs = self.scene.splits[self.split]
        return f"pictures/{name}/{picture_stems(photographs)[len(photographs) // 2]}.png"


def _read(note: Path) -> dict[str, Any]:
    try:
        kept = json.loads(note.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return kept if isinstance(kept, dict) and isinstance(kept.get("seconds"), dict) else {}
