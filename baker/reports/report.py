"""`python -m baker.reports.report RUN --out DIR`: the SNeRG paper's tables of one run (section 6), measured.

Writes DIR/report.md, report.json, plots and cross-sections. Packs are baked into DIR/packs, and scored pictures lie in
DIR/pictures. Typed again, the line goes on: packs are kept, and so are tables that are not asked for this time.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from console import UserError, run_command

if TYPE_CHECKING:
    from baker.baking.bake import BakeConfig
    from baker.reports.packs import Study

DESCRIPTION = "Measures the paper's tables on a trained run: quality ladder, resolution, codecs, sparsity loss."
TABLES = ("ladder", "resolution", "codecs", "sparsity")
RUNGS = ("none", "view-mlp", "all")


def report(
    run: Path,
    /,
    out: Path,
    scene: Path | None = None,
    split: str = "test",
    views: int = 0,
    tables: str = "ladder,resolution,codecs,sparsity",
    resolution: int = 512,
    resolutions: str = "500,750,1000",
    fine_tune: str = "none,view-mlp,all",
    fine_tune_epochs: int = 100,
    against: Path | None = None,
    frames: int = 150,
    size: str | None = None,
    quick: bool = False,
) -> None:
    """Measures the paper's tables on a trained run and writes them as Markdown, JSON and pictures.

    Args:
        run: Folder of the run, from snerg-train.
        out: Folder for the report. The packs that it bakes stay in OUT/packs and are reused.
        scene: Folder of the photographs, if they moved. The default is where the run read them.
        split: Which photographs to use: test, train or val.
        views: Score at most this many of them, evenly spread; 0 for all.
        tables: Tables to make, separated by commas: ladder, resolution, codecs, sparsity.
        resolution: Voxels along the longest side, for the tables ladder, codecs and sparsity.
        resolutions: Voxels along the longest side, separated by commas, for the table resolution.
        fine_tune: Rows of the table ladder, separated by commas: none, view-mlp, all (by far the slowest).
        fine_tune_epochs: Passes over the training pixels while the view MLP is tuned, as for snerg-bake.
        against: For the table sparsity: a second run of the same scene, trained without the sparsity loss.
        frames: For the table resolution: number of frames to time.
        size: For the table resolution: picture size, WIDTHxHEIGHT in pixels. The default is that of snerg-bench.
        quick: For the table codecs: measure only the default quality of each codec.
    """
    chosen = _chosen(tables, TABLES, "--tables")
    rungs = _chosen(fine_tune, RUNGS, "--fine-tune")
    sides = _resolutions(resolutions)
    if resolution < 1 or frames < 1 or views < 0:
        raise UserError("is too small", where="--resolution, --frames or --views")
    if out.exists() and not out.is_dir():
        raise UserError("is a file", where=out, expected="a folder, or nothing yet")
    from baker.baking.bake import BakeConfig
    from baker.reports import tables as report_tables
    from console.arguments import parse_size

    pixels = parse_size(size) if size else None
    options = BakeConfig(resolution=resolution, fine_tune_epochs=fine_tune_epochs)
    study = _study(run, out, scene, split, views, options, against)
    _check_resolutions([resolution, *sides])
    document = _begun(study)
    makers = {
        "ladder": lambda: report_tables.ladder_table(study, rungs),  # type: ignore[arg-type]
        "resolution": lambda: report_tables.resolution_table(study, sides, frames, pixels),
        "codecs": lambda: report_tables.codecs_table(study, quick),
        "sparsity": lambda: report_tables.sparsity_table(study),
    }
    for name in chosen:
        document["tables"][name] = makers[name]()
        _write(out, document)  # now: what follows may take an hour
        print(f"{name}: in {out / 'report.md'}", flush=True)


def _chosen(text: str, known: Sequence[str], where: str) -> list[str]:
    names = list(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    wrong = [name for name in names if name not in known]
    if wrong or not names:
        raise UserError(
            "is not a list of these", where=where, expected=", ".join(known), found=wrong[0] if wrong else "none"
        )
    return sorted(names, key=known.index)


def _resolutions(text: str) -> list[int]:
    words = [word.strip() for word in text.split(",") if word.strip()]
    if not words or not all(word.isdecimal() for word in words):
        raise UserError(
            "is not a list of whole numbers", where="--resolutions", expected="such as 500,750", found=repr(text)
        )
    return sorted({int(word) for word in words})


def _check_resolutions(sides: Sequence[int]) -> None:
    """UserError, before anything is baked, where a grid can be too coarse or too fine."""
    from baker.baking.bake import BLOCK_SIZE
    from scenepack.constants import MAX_BLOCK_INDEX

    most = MAX_BLOCK_INDEX * BLOCK_SIZE
    for side in sides:
        if not BLOCK_SIZE <= side <= most:
            raise UserError("cannot be baked", where="--resolution, --resolutions",
                            expected=f"{BLOCK_SIZE} ... {most} voxels", found=side)  # fmt: skip


def _study(
    run_path: Path,
    out: Path,
    scene_path: Path | None,
    split: str,
    views: int,
    options: BakeConfig,
    against: Path | None,
) -> Study:
    from baker.reports.packs import Study
    from training.run import load_run, require_bakeable

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
    from baker.reports.pages import draw_report_plots, report_text
    from console.atomic import write_file

    out.mkdir(parents=True, exist_ok=True)
    draw_report_plots(out, document["tables"])
    write_file(out / "report.json", json.dumps(document, indent=2) + "\n")
    write_file(out / "report.md", report_text(document))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(report, prog="python -m baker.reports.report", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
