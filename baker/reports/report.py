"""The SNeRG paper's tables of one run (section 6), measured one after another and kept in the report's folder."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baker.baking.bake import BLOCK_SIZE, BakeConfig
from baker.reports import tables
from baker.reports.packs import Study
from baker.reports.pages import draw_report_plots, report_text
from console import UserError
from console.atomic import write_file
from scenepack.constants import MAX_BLOCK_INDEX
from training.run import load_run, require_bakeable


@dataclass(frozen=True)
class Wanted:
    """What tables show. rungs: of fine-tuning, above the field. resolutions: of the resolution table, whose frame times
    are of `frames` frames of `size` (width, height; None: the protocol's). quick: only each codec's default quality.
    """

    rungs: Sequence[tables.Tuned]
    resolutions: Sequence[int]
    frames: int
    size: tuple[int, int] | None
    quick: bool


def write_tables(study: Study, chosen: Sequence[str], wanted: Wanted) -> None:
    """Makes the tables `chosen`, of ladder, resolution, codecs and sparsity, and writes the report anew after each.

    UserError, before anything is baked, where a resolution cannot be.
    """
    _check_resolutions([study.options.resolution, *wanted.resolutions])
    document = _begun(study)
    makers = {
        "ladder": lambda: tables.ladder_table(study, wanted.rungs),
        "resolution": lambda: tables.resolution_table(study, wanted.resolutions, wanted.frames, wanted.size),
        "codecs": lambda: tables.codecs_table(study, wanted.quick),
        "sparsity": lambda: tables.sparsity_table(study),
    }
    for name in chosen:
        document["tables"][name] = makers[name]()
        _write(study.out, document)  # now: what follows may take an hour
        print(f"{name}: in {study.out / 'report.md'}", flush=True)


def _check_resolutions(sides: Sequence[int]) -> None:
    """UserError, before anything is baked, where a grid can be too coarse or too fine."""
    most = MAX_BLOCK_INDEX * BLOCK_SIZE
    for side in sides:
        if not BLOCK_SIZE <= side <= most:
            raise UserError("cannot be baked", where="--resolution, --resolutions",
                            expected=f"{BLOCK_SIZE} ... {most} voxels", found=side)  # fmt: skip


def open_study(
    run_path: Path,
    out: Path,
    scene_path: Path | None,
    split: str,
    views: int,
    options: BakeConfig,
    against: Path | None,
) -> Study:
    """The run, its photographs that count, and the run to compare with. UserError where they do not fit together.

    scene_path: where the photographs are now. views: score at most this many of `split`; 0 for all.
    """
    run = load_run(run_path, scene_path=scene_path)
    other = None if against is None else load_run(against, scene_path=scene_path)
    for loaded in filter(None, (run, other)):
        require_bakeable(loaded)
    if other is not None and (other.scene.path.resolve() != run.scene.path.resolve() or other.options != run.options):
        raise UserError(
            "is a run of another scene, or reads the scene differently", where=against,
            expected=f"{run.scene.path}, {vars(run.options)}", found=f"{other.scene.path}, {vars(other.options)}",
        )  # fmt: skip
    photographs = run.scene.splits.get(split, ())
    if not photographs:
        raise UserError(
            "no photographs in this split", where="--split", expected=", ".join(run.scene.splits), found=split
        )
    if 0 < views < len(photographs):
        photographs = tuple(photographs[i] for i in np.linspace(0, len(photographs) - 1, views).round().astype(int))
    scored = dataclasses.replace(run.scene, splits={**run.scene.splits, split: photographs})
    return Study(run, scored, split, out, options, other)


def _begun(study: Study) -> dict[str, Any]:
    """The report so far: what an earlier call left, if it was about the same run and photographs."""
    photographs = study.scene.splits[study.split]
    camera = photographs[0].camera
    about = {
        "run": str(study.run.path.resolve()), "step": study.run.step, "scene": str(study.scene.path),
        "downscale": study.run.downscale, "split": study.split, "views": len(photographs), "width": camera.width,
        "height": camera.height,
    }  # fmt: skip
    try:
        kept = json.loads((study.out / "report.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        kept = {}
    same = isinstance(kept, dict) and kept.get("about") == about and isinstance(kept.get("tables"), dict)
    return {"about": about, "tables": kept["tables"] if same else {}}


def _write(out: Path, document: dict[str, Any]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    draw_report_plots(out, document["tables"])
    write_file(out / "report.json", json.dumps(document, indent=2) + "\n")
    write_file(out / "report.md", report_text(document))
