"""The packs and scores behind a report: each is made once, and stays in the report's folder for the next time.

Beside the pack NAME lies NAME.json: what it was baked from and how (`key`), and the seconds of each stage. scores/NAME.json holds
its scores, and of what. A pack or a score whose key is another one (the run went on, other options) is made anew.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from baker.baking.bake import bake_floats, work_key
from baker.baking.config import BakeConfig, BakePreset
from baker.baking.to_pack import bake_to
from baker.reports.evaluation import Drawn, evaluate
from baker.reports.float_pictures import float_pictures
from baker.reports.options import ReportOptions
from baker.reports.paper_figures import Kind, kind_of
from console import write_json
from training.run import Run, load_run
from training.scenes import Photograph, Scene

Score = dict[str, Any]


@dataclass(frozen=True)
class Baked:
    """A pack on disk, what it was made from (`key`), and the seconds of each stage of its bake."""

    name: str
    path: Path
    key: Mapping[str, Any]
    seconds: dict[str, float]


@dataclass
class Study:
    """A run, what it is compared with, and what was made of it so far."""

    run: Run
    scene: Scene  # with the photographs that count
    options: ReportOptions
    resolution: int  # of its packs where a table does not say otherwise
    baselines: Mapping[str, Path] = field(default_factory=dict)  # folders of further runs, by the row of the paper

    @property
    def out(self) -> Path:
        return self.options.out

    @property
    def photographs(self) -> Sequence[Photograph]:
        """Those that are scored."""
        return self.scene.splits[self.options.split]

    @property
    def kind(self) -> Kind:
        return kind_of(self.scene)

    @property
    def name(self) -> str:
        return self.scene.path.resolve().name

    @property
    def mask(self) -> Baked | None:
        """Where a box is baked, the paper's bake of it: all is compared only where that is opaque (appendix C.2)."""
        return self.baked("paper") if self.options.aabb else None

    @cached_property
    def without_sparsity(self) -> Run | None:
        """The run to compare with, loaded when it is first asked for."""
        against = self.options.against
        return None if against is None else load_run(against, scene_path=self.scene.path)

    def config(self, preset: BakePreset, **changes: Any) -> BakeConfig:
        return BakeConfig(**{"resolution": self.resolution, "preset": preset, "aabb": self.options.box, **changes})

    def baked(self, preset: BakePreset, run: Run | None = None, **changes: Any) -> Baked:
        """The pack of a run (by default the report's own), from the report's folder where it lies there already.

        changes: fields of BakeConfig that differ from the report's.
        """
        run, config = run or self.run, self.config(preset, **changes)
        name = f"{preset}-{config.resolution}-{config.quality}" + ("" if run is self.run else "-no-sparsity")
        name += "-with-hidden" if config.keeps_hidden else ""
        pack, note = self.out / "packs" / name, self.out / "packs" / f"{name}.json"
        key, kept = work_key(run, config) | {"quality": config.quality}, read_note(note)
        if kept.get("key") == json.loads(json.dumps(key)) and pack.is_dir() and isinstance(kept.get("seconds"), dict):
            return Baked(name, pack, key, kept["seconds"])
        note.unlink(missing_ok=True)  # first, so that no note ever tells of another pack
        seconds = bake_to(run, config, pack)
        write_json(note, {"key": key, "seconds": seconds})
        return Baked(name, pack, key, seconds)

    def score(self, baked: Baked, mask_of: Baked | None = None) -> Score:
        """psnr, ssim, lpips of a pack: means over the views, drawn by OpenGL, and `views`, each photograph's psnr.

        mask_of: compared where this pack is opaque; by default see `mask`.
        """
        return self._scored(baked.name, baked.key, lambda: baked.path, mask_of)

    def score_field(self, name: str, run: Run, mask_of: Baked | None) -> Score:
        """The same of a trained field."""
        return self._scored(name, work_key(run, BakeConfig()), lambda: run, mask_of)

    def score_floats(self) -> Score:
        """The same of the paper's bake before it is quantised, and `bytes`, of its atlas."""
        config = self.config("paper")
        key = work_key(self.run, config) | {"floats": True}
        name = f"float-{config.resolution}"
        return self._scored(name, key, lambda: float_pictures(bake_floats(self.run, config), self.run))

    def _scored(
        self, name: str, key: Mapping[str, Any], make: Callable[[], Path | Run | Drawn], mask_of: Baked | None = None
    ) -> Score:
        mask_of = mask_of or self.mask
        name += "" if mask_of is None else "-masked"
        note = self.out / "scores" / f"{name}.json"
        views = [photograph.name for photograph in self.photographs]
        about = {"key": key, "views": views, "mask": None if mask_of is None else mask_of.key}
        kept = read_note(note)
        if kept.get("of") == json.loads(json.dumps(about)) and isinstance(kept.get("score"), dict):
            return kept["score"]
        images, subject = f"pictures/{name}", make()
        mask = None if mask_of is None else mask_of.path
        scores = evaluate(subject, self.scene, self.options.split, self.out / images, mask_of=mask)
        psnr_of = {view["name"]: view["psnr"] for view in scores["views"]}
        score = {**{metric: scores[metric] for metric in ("psnr", "ssim", "lpips")}, "views": psnr_of}
        if isinstance(subject, Drawn):
            score["bytes"] = subject.bytes
        score["pictures"] = images
        write_json(note, {"of": about, "score": score})
        return score


def read_note(note: Path) -> dict[str, Any]:
    """The object in a file of JSON; empty where there is none."""
    try:
        kept = json.loads(note.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return kept if isinstance(kept, dict) else {}
