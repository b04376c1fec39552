"""`python -m tools.codec_report PACK --scene SCENE`: size, quality and time of every codec on one pack.

Writes Markdown to stdout and to --out, and JSON beside it.
"""

import sys
import tempfile
from pathlib import Path

from baker.reports.pages import codec_columns, table_of
from baker.reports.report import LADDER, measured
from console import check_results, run_command, write_json, write_result
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
    table = table_of(rows, ("codec", lambda row: row["codec"]), *codec_columns(rows[0]["bytes"]))
    print(table)
    write_result(out, table + "\n")
    write_json(figures, rows)


if __name__ == "__main__":
    sys.exit(run_command(codec_report, prog="python -m tools.codec_report", description=DESCRIPTION))
