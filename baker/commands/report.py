"""`python -m baker.commands.report RUN --out DIR`: the SNeRG paper's tables of one run (section 6), measured.

Writes DIR/report.md, report.json, plots and cross-sections. Packs are baked into DIR/packs, and scored pictures lie in
DIR/pictures. Typed again, the line goes on: packs are kept, and so are tables that are not asked for this time.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from console import UserError, check_results, run_command
from console.arguments import parse_size

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
        fine_tune: Rows of the table ladder, separated by commas: none, view-mlp, all.
        fine_tune_epochs: Passes over the training pixels while the view MLP is tuned, as for snerg-bake.
        against: For the table sparsity: a second run of the same scene, trained without the sparsity loss.
        frames: For the table resolution: number of frames to time.
        size: For the table resolution: picture size, WIDTHxHEIGHT in pixels. The default is that of snerg-bench.
        quick: For the table codecs: measure only the default quality of each codec.
    """
    chosen = _chosen(tables, TABLES, "--tables")
    rungs = _chosen(fine_tune, RUNGS, "--fine-tune")
    sides = _resolutions(resolutions)
    pixels = parse_size(size) if size else None
    if resolution < 1 or frames < 1 or views < 0:
        raise UserError("is too small", where="--resolution, --frames or --views")
    if out.exists() and not out.is_dir():
        raise UserError("is a file", where=out, expected="a folder, or nothing yet")
    check_results(folder=out)
    from baker.baking.bake import BakeConfig  # JAX starts here, not for --help
    from baker.reports.report import Wanted, open_study, write_tables

    # Every table but the ladder is of packs that are fine-tuned as the paper's.
    options = BakeConfig(resolution=resolution, fine_tune="view-mlp", fine_tune_epochs=fine_tune_epochs)
    study = open_study(run, out, scene, split, views, options, against)
    write_tables(study, chosen, Wanted(rungs, sides, frames, pixels, quick))


def _chosen(text: str, known: Sequence[str], where: str) -> list[Any]:
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


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(report, prog="python -m baker.commands.report", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
