"""`python -m baker.commands.codec_report PACK --scene SCENE`: the storage table, codec by codec (SNeRG paper, section 7).

Writes Markdown to stdout and to --out, and JSON beside it.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from baker.reports.codec_report import LADDER, as_markdown, measured
from console import check_results, run_command, write_json, write_text
from training.scenes import load_scene

DESCRIPTION = "Size, quality and time of every codec on one pack, as a table."


def codec_report(
    pack: Path, /, scene: Path, downscale: int = 1, split: str = "test", out: Path | None = None, quick: bool = False
) -> None:
    """Writes a pack with every codec and tabulates size, quality through OpenGL, and time.

    Args:
        pack: A lossless pack (png or webp), a folder or a .zip.
        scene: Folder of the photographs.
        downscale: Divide width and height of the photographs by this whole number.
        split: Which photographs to use: test, train or val.
        out: Also write the table to this Markdown file, and the figures to a .json next to it.
        quick: Measure only the default quality of each codec.
    """
    figures = None if out is None else out.with_suffix(".json")
    check_results(out, figures)
    photographs = load_scene(scene, downscale=downscale)
    rows = []
    ladder = [step for step in LADDER if not (quick and step[1] is not None)]
    with tempfile.TemporaryDirectory(prefix="snerg-codecs-") as folder:
        for row in measured(pack, photographs, split, ladder, Path(folder)):
            print(f"{row['codec']} {row['quality'] or ''}: {row['bytes'] / 1e6:.2f} MB", file=sys.stderr, flush=True)
            rows.append(row)
    table = as_markdown(rows)
    print(table)
    write_text(out, table + "\n")
    write_json(figures, rows)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(codec_report, prog="python -m baker.commands.codec_report", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
