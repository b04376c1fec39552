"""`python -m tools.codec_report PACK --scene SCENE`: size, quality and time of every codec on one pack.

Writes Markdown to stdout and to --out, and JSON beside it.
"""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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
    table = as_markdown(rows)
    print(table)
    write_result(out, table + "\n")
    write_json(figures, rows)


def as_markdown(rows: Sequence[dict[str, Any]]) -> str:
    """The table; percentages are of the first row, PNG."""
    lines = [
        "| codec | quality | MB | of PNG | PSNR (dB) | SSIM | LPIPS | PSNR against the pack (dB) | encode (s) | decode (s) |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        quality = "lossless" if row["quality"] is None else f"{row['quality']}{' (default)' if row['default'] else ''}"
        lpips = "–" if row["lpips"] is None else f"{row['lpips']:.4f}"
        against = "identical" if row["psnr_against_pack"] >= 119 else f"{row['psnr_against_pack']:.2f}"
        share = 100 * row["bytes"] / rows[0]["bytes"]
        cells = [row["codec"], quality, f"{row['bytes'] / 1e6:.2f}", f"{share:.0f} %", f"{row['psnr']:.2f}"]
        cells += [f"{row['ssim']:.4f}", lpips, against, f"{row['encode_s']:.1f}", f"{row['decode_s']:.1f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(run_command(codec_report, prog="python -m tools.codec_report", description=DESCRIPTION))
