"""`python -m baker.reports.codec_report PACK --scene SCENE`: the storage table, codec by codec (SNeRG paper, section 6).

Each codec writes the pack anew, reads it back and is drawn by the OpenGL renderer: megabytes (10⁶ bytes) on disk,
PSNR, SSIM and LPIPS against the photographs, PSNR against the pictures of the pack as it was, seconds to encode and to
decode. Writes Markdown to stdout and to --out, and JSON beside it.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from console import UserError, run_command
from console.atomic import write_file

DESCRIPTION = "Size, quality and time of every codec on one pack, as a table."
# Each codec as it comes, and what places them on one curve.
LADDER: tuple[tuple[str, int | None], ...] = (
    ("png", None),
    ("webp", None),
    ("jpeg", 98),
    ("jpeg", None),
    ("jpeg", 90),
    ("h264", 92),
    ("h264", None),
    ("h264", 70),
    ("avif", 90),
    ("avif", None),
    ("avif", 70),
    ("avif", 60),
)
VIEWS, SIZE = 8, (400, 400)


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
    from training.scenes import load_scene

    photographs = load_scene(scene, downscale=downscale)
    rows = []
    ladder = [step for step in LADDER if not (quick and step[1] is not None)]
    with tempfile.TemporaryDirectory(prefix="snerg-codecs-") as folder:
        for row in measured(pack, photographs, split, ladder, Path(folder)):
            print(f"{row['codec']} {row['quality'] or ''}: {row['bytes'] / 1e6:.2f} MB", file=sys.stderr, flush=True)
            rows.append(row)
    table = as_markdown(rows)
    print(table)
    if out is not None:
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            write_file(out, table + "\n")
            write_file(out.with_suffix(".json"), json.dumps(rows, indent=2) + "\n")
        except OSError as error:
            raise UserError(f"cannot be written: {error.strerror or error}", where=out) from error


def measured(
    path: Path, scene: Any, split: str, ladder: Sequence[tuple[str, int | None]], folder: Path
) -> Iterator[dict[str, Any]]:
    """A row for each (codec, quality) of the ladder, written below `folder` and removed again.

    Codecs whose library is missing are left out with a line on stderr.
    """
    from baker.reports.evaluation import evaluate
    from baker.reports.pack_compare import compare_packs, stored_bytes
    from scenepack import load_pack, save_pack
    from scenepack.codecs import chosen_quality, codec_named

    pack = load_pack(path)
    for name, asked in ladder:
        try:
            quality = chosen_quality(codec_named(name, "codec"), asked)
        except UserError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
            continue
        target = folder / "pack"
        encoding = time.perf_counter()
        save_pack(pack, target, codec=name, quality=quality)
        decoding = time.perf_counter()
        load_pack(target)
        done = time.perf_counter()
        shown = evaluate(target, scene, split)
        against = compare_packs(path, target, VIEWS, SIZE)
        yield {
            "codec": name,
            "quality": quality,
            "default": asked is None,
            "bytes": stored_bytes(target),
            "psnr": shown["psnr"],
            "ssim": shown["ssim"],
            "lpips": shown["lpips"],
            "psnr_against_pack": against["psnr"],
            "encode_s": decoding - encoding,
            "decode_s": done - decoding,
        }


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


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(codec_report, prog="python -m baker.reports.codec_report", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
