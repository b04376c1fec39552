"""`python -m viewer.commands.scaling --out FOLDER`: how frame time grows with resolution, picture size and opacity."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from console import UserError, check_results, run_command, write_json
from console.arguments import parse_numbers
from console.plots import draw_plots, require_plots
from viewer.benchmark.scaling import BLOCK_SIZE, Figures, in_words, measured, plots_of

DESCRIPTION = "Plots frame time against grid resolution, picture size and opacity, on carved scenes."


def scaling(
    out: Path,
    frames: int = 12,
    resolutions: str = "256,512,750,1000",
    sizes: str = "100,200,400,800",
    redraw: bool = False,
) -> None:
    """Plots frame time against grid resolution, picture size and opacity, on carved scenes.

    Args:
        out: Folder for scaling-resolution.png, scaling-size.png, scaling-opacity.png and scaling.json.
        frames: Number of frames of the orbit that measures each point.
        resolutions: Voxels per side, separated by commas. 1000 takes about 4 GB of memory.
        sizes: Width and height of the pictures in pixels, separated by commas.
        redraw: Draw the plots from the scaling.json that is there, and measure nothing.
    """
    require_plots()
    check_results(folder=out)
    figures = out / "scaling.json"
    if redraw:
        _draw(out, _read(figures))
        return
    if frames < 1:
        raise UserError("needs at least one frame", where="--frames", found=frames)
    sides = [int(n) for n in parse_numbers(resolutions, resolutions.count(",") + 1, "--resolutions")]
    pixels = [int(n) for n in parse_numbers(sizes, sizes.count(",") + 1, "--sizes")]
    if min(sides) < BLOCK_SIZE or min(pixels) < 1:
        raise UserError("is too small", where="--resolutions" if min(sides) < BLOCK_SIZE else "--sizes")
    result = measured(sides, pixels, frames)
    write_json(figures, result)
    _draw(out, result)
    for line in in_words(result):
        print(line)


def _draw(out: Path, result: Figures) -> None:
    for what, plot in plots_of(result).items():
        draw_plots(out / f"scaling-{what}.png", [plot], (600, 340))


def _read(file: Path) -> Figures:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UserError("cannot be read", where=file, found=error, remedy="measure first, without --redraw") from error


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(scaling, prog="python -m viewer.commands.scaling", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
