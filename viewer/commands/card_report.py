"""`python -m viewer.commands.card_report --out DIR`: every figure that a graphics card owes, in one run (docs/card.md)."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from console import UserError, check_results, run_command, write_text
from console.arguments import parse_size
from viewer.benchmark.card.drawing import Look
from viewer.benchmark.card.page import page
from viewer.benchmark.card.parts import run_parts
from viewer.benchmark.card.plan import Wanted, parts_of

PROG = "python -m viewer.commands.card_report"
DESCRIPTION = "Measures everything that this repository wants to know of a graphics card, and writes a report."


def card_report(
    out: Path,
    pack: tuple[Path, ...] = (),
    only: bool = False,
    size: str = "800x800",
    frames: int = 150,
    views: int = 8,
    power_seconds: float = 4.0,
    scene: Path | None = None,
    downscale: int = 1,
    train_minutes: float = 6.0,
    curve_preset: str = "full",
    step_preset: str = "paper",
    curve_options: str = "",
    step_options: str = "",
    processor_too: bool = False,
    minutes: float = 20.0,
    keep_runs: bool = False,
) -> None:
    """Measures everything that this repository wants to know of a graphics card, and writes a report.

    Args:
        out: Folder for report.md, report.json, pictures and logs.
        pack: Packs to measure besides those that are found.
        only: Measure only the packs given with --pack, and not the demo and those found in out/, packs/ and $SNERG_DATA/packs.
        size: Picture size, WIDTHxHEIGHT in pixels.
        frames: Number of frames of the camera path, for frame times.
        views: Number of views in which exactness is checked.
        power_seconds: How long each marcher draws without a pause, to measure its power.
        scene: Scene to train on. The default is lego from $SNERG_DATA, or a scene that is rendered first.
        downscale: Divide width and height of the photographs by this whole number.
        train_minutes: Minutes of training for the curve. 0 leaves all training out.
        curve_preset: Preset whose PSNR over time is measured.
        step_preset: Preset whose step is timed.
        curve_options: Further options of snerg-train for --curve-preset, in one word.
        step_options: Further options of snerg-train for --step-preset, in one word.
        processor_too: Train even if JAX sees no graphics card.
        minutes: Begin nothing after this many minutes.
        keep_runs: Keep the runs of the training, in the folder work.
    """
    for option, value, least in (("--frames", frames, 1), ("--views", views, 1), ("--downscale", downscale, 1)):
        if value < least:
            raise UserError("is too small", where=option, expected=f"at least {least}", found=value)
    if minutes <= 0 or not 0 <= train_minutes <= minutes:
        raise UserError(
            "do not fit together", where="--minutes and --train-minutes", expected="0 <= --train-minutes <= --minutes"
        )
    look = Look(parse_size(size), frames, views, power_seconds)
    check_results(folder=out)
    for path in (*pack, *([scene] if scene is not None else [])):
        if not path.exists():
            raise UserError("there is no such file or folder", where=path)
    out = out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    runs = out / "work"
    shutil.rmtree(runs, ignore_errors=True)  # of a report that was interrupted
    wanted = Wanted(
        pack, only, look, scene, downscale, train_minutes, curve_preset, step_preset, curve_options, step_options,
        processor_too,
    )  # fmt: skip
    try:
        report = run_parts(parts_of(wanted, out), out, minutes)
    finally:
        if not keep_runs:
            shutil.rmtree(runs, ignore_errors=True)
    write_text(out / "report.md", page(report))
    print(out / "report.md")
    failed = [name for name, facts in report["parts"].items() if facts["status"] == "failed"]
    if failed:
        raise UserError(
            f"{len(failed)} of {len(report['parts'])} parts failed",
            where=", ".join(failed),
            remedy=f"see {out / 'report.md'}",
        )


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(card_report, prog=PROG, description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
