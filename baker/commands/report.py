"""`python -m baker.commands.report RUN --out DIR`: the SNeRG paper's tables of one run (section 6), measured.

Writes DIR/report.md, report.json, plots and cross-sections. Packs are baked into DIR/packs, and scored pictures lie in
DIR/pictures. Typed again, the line goes on: packs are kept, and so are tables that are not asked for this time.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from console import UserError, run_command
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
        out: Folder for the report; packs baked for it stay in its folder packs and are used again.
        scene: Where the photographs are now, if they moved; by default where the run read them.
        split: Which photographs score: test, train or val.
        views: Score at most this many of them, spread evenly; 0 for all.
        tables: Which to make, with commas between: ladder, resolution, codecs, sparsity.
        resolution: Voxels along the longest side for ladder, codecs and sparsity.
        resolutions: Those of the resolution table, with commas between.
        fine_tune: Rungs of the ladder above the field: none, view-mlp, all (the slowest by far).
        fine_tune_epochs: Passes over the training pixels that refine the view MLP, as for snerg-bake.
        against: A second run of the same scene, trained without the sparsity loss, for the table sparsity.
        frames: Of the path on which the resolution table times frames.
        size: WIDTHxHEIGHT in pixels of those frames; by default as snerg-bench.
        quick: In the table codecs only each codec's default quality.
    """
    chosen = _chosen(tables, TABLES, "--tables")
    rungs = _chosen(fine_tune, RUNGS, "--fine-tune")
    sides = _resolutions(resolutions)
    pixels = parse_size(size) if size else None
    if resolution < 1 or frames < 1 or views < 0:
        raise UserError("is too small", where="--resolution, --frames or --views")
    if out.exists() and not out.is_dir():
        raise UserError("is a file", where=out, expected="a folder, or nothing yet")
    from baker.baking.bake import BakeConfig  # JAX starts here, not for --help
    from baker.reports.report import Wanted, open_study, write_tables

    options = BakeConfig(resolution=resolution, fine_tune_epochs=fine_tune_epochs)
    study = open_study(run, out, scene, split, views, options, against)
    write_tables(study, chosen, Wanted(rungs, sides, frames, pixels, quick))


def _chosen(text: str, known: Sequence[str], where: str) -> list[Any]:
    names = list(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    wrong = [name for name in names if name not in known]
    if wrong or not names:
        raise UserError(
            "is no list of these", where=where, expected=", ".join(known), found=wrong[0] if wrong else "none"
        )
    return sorted(names, key=known.index)


def _resolutions(text: str) -> list[int]:
    words = [word.strip() for word in text.split(",") if word.strip()]
    if not words or not all(word.isdecimal() for word in words):
        raise UserError(
            "is no list of whole numbers", where="--resolutions", expected="such as 500,750", found=repr(text)
        )
    return sorted({int(word) for word in words})


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(report, prog="python -m baker.commands.report", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
