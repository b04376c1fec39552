"""`snerg-report RUN --out DIR`: the SNeRG paper's tables of one run (section 7 and appendix), measured; and of several scenes.

Writes DIR/report.md, report.json, plots, crops and cross-sections. Packs are baked into DIR/packs, scores and scored pictures
lie in DIR/scores and DIR/pictures. Typed again, the line goes on: what is there is kept, and so are tables that are not asked
for this time. Given the folders of several reports instead of a run, it puts their scenes side by side, with their mean.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

from baker.baking.config import Quality
from console import UserError, check_results, run_command, write_json, write_text
from console.arguments import join_negative_values, parse_size
from training.libraries import begin_libraries
from viewer.benchmark.protocols import given_distance

DESCRIPTION = "Measures the SNeRG paper's tables on a trained run, or puts the reports of several scenes side by side."
TABLES = ("quality", "storage", "performance", "resolution", "real", "sparsity")


def snerg_report(
    subjects: tuple[Path, ...],
    /,
    out: Path,
    scene: Path | None = None,
    split: str = "test",
    views: int = 0,
    tables: str | None = None,
    resolution: int | None = None,
    resolutions: str = "1000,750,500",
    bake: Literal["paper", "snerg"] = "paper",
    quality: str = "compact",
    most_macroblocks: int | None = None,
    aabb: str | None = None,
    against: Path | None = None,
    baselines: str | None = None,
    frames: int = 150,
    size: str | None = None,
    distance: str = "auto",
    power_seconds: float = 4.0,
    nominal_watts: float | None = None,
    quick: bool = False,
) -> None:
    """Measures the paper's tables on a trained run and writes them as Markdown, JSON and pictures.

    Args:
        subjects: Folder of a run, from snerg-train; or folders of several earlier reports, to put their scenes side by side.
        out: Folder for the report. Packs, scores and pictures stay in it and are reused.
        scene: Folder of the photographs, if they moved. The default is where the run read them.
        split: Which photographs to use: test, train or val.
        views: Score at most this many of them, evenly spread; 0 for all.
        tables: Tables to make, separated by commas: quality, storage, performance, resolution, real, sparsity. The default is
            all; real only for scenes that are not synthetic.
        resolution: Voxels along the longest side, for all tables but resolution. The default is the paper's: 1000 for synthetic
            scenes, 1300 for photographs.
        resolutions: Voxels along the longest side, separated by commas, for the table resolution.
        bake: Which bake the tables storage and resolution are of: paper (as the paper writes), or snerg (our default settings).
        quality: Rows of our own bake in the table quality, separated by commas: draft, compact (our default), full.
        most_macroblocks: If more would be kept, grids are made coarser. The default is that of each bake: none in the paper's.
        aabb: Box that all packs are baked of, x0,y0,z0,x1,y1,z1 in the training frame, and photographs and pictures are compared
            only where the paper's bake of it is opaque: the paper's procedure for real 360 degree scenes, which are trained
            beyond it.
        against: A second run of the same scene, trained without the sparsity loss.
        baselines: Folders of further runs of the same scene, separated by commas: of the presets jaxnerf-plus, jaxnerf, tinyview,
            deferred and diffuse. Each fills its row.
        frames: Number of frames to time.
        size: Picture size of timed frames, WIDTHxHEIGHT in pixels. The default is that of snerg-bench.
        distance: Distance of the camera of timed frames, as for snerg-bench.
        power_seconds: Seconds of drawing without a pause to measure the power of an NVIDIA card, for each row.
        nominal_watts: Nominal power of the graphics card, for frames per second per watt as the paper counts them (85 for its
            laptop), beside those that are measured.
        quick: For the table storage: measure only the default quality of each codec.
    """
    chosen = None if tables is None else _chosen(tables, TABLES, "--tables")
    qualities, sides = _chosen(quality, get_args(Quality), "--quality"), _resolutions(resolutions)
    pixels = parse_size(size) if size else None
    if nominal_watts is not None and not nominal_watts > 0:
        raise UserError("is no power", where="--nominal-watts", expected="watts, more than 0", found=nominal_watts)
    if frames < 1 or views < 0 or (resolution is not None and resolution < 1):
        raise UserError("is too small", where="--resolution, --frames or --views")
    if out.exists() and not out.is_dir():
        raise UserError("is a file", where=out, expected="a folder, or nothing yet")
    given_distance(distance)
    check_results(folder=out)
    run = next(iter(subjects), None)
    if run is None:
        raise UserError("needs a run, or the reports of several scenes", where="snerg-report")
    if len(subjects) > 1 or (run / "report.json").is_file():
        _side_by_side(subjects, out)
        return
    begin_libraries()  # JAX starts here, not for --help
    from baker.reports.performance import Drawing
    from baker.reports.report import Sources, Wanted, open_study, write_tables
    from training.scenes.scene_options import parse_box

    asked = {"most_macroblocks": most_macroblocks, "aabb": parse_box(aabb)}
    given: Mapping[str, Any] = {name: value for name, value in asked.items() if value is not None}
    folders = [Path(word.strip()) for word in (baselines or "").split(",") if word.strip()]
    study = open_study(Sources(run, out, scene, split, views, resolution, given, against, folders))
    drawing = Drawing(frames, pixels, distance, power_seconds, nominal_watts)
    suit = [name for name in TABLES if name != "real" or study.kind != "synthetic"]
    write_tables(study, suit if chosen is None else chosen, Wanted(qualities, sides, bake, drawing, quick))


def _side_by_side(folders: Sequence[Path], out: Path) -> None:
    """The reports of several scenes as one."""
    from baker.reports.pages import scenes_text
    from baker.reports.scenes import read_report, scenes_document

    if any(folder.resolve() == out.resolve() for folder in folders):
        raise UserError("is one of the reports", where=f"--out {out}", expected="a folder of its own")
    document = scenes_document([read_report(folder) for folder in folders])
    write_json(out / "report.json", document)
    write_text(out / "report.md", scenes_text(document))
    print(f"{len(folders)} scenes: in {out / 'report.md'}")


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
            "is not a list of whole numbers", where="--resolutions", expected="such as 1000,500", found=repr(text)
        )
    return sorted({int(word) for word in words})


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    words = join_negative_values(sys.argv[1:] if args is None else args, ["--aabb"])
    return run_command(snerg_report, prog="snerg-report", description=DESCRIPTION, args=words)


if __name__ == "__main__":
    sys.exit(main())
