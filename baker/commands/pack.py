"""`snerg-pack info|check|convert|export|compare`: all about packs (docs/commands.md).

The first three are scenepack's; `compare` draws, and scenepack may not import the renderer. Nothing here needs JAX, so
all work in the viewer-only install.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from baker.commands.export import export
from console import UserError, check_results, run_command, write_json
from console.streams import one_line
from scenepack.commands import COMMANDS

DESCRIPTION = (
    "Inspects, checks, converts, exports and compares packs "
    "(baked scenes: a folder with scene_params.json, or one .zip)."
)


def compare(a: Path, b: Path, /, views: int = 8, size: str = "400x400", json: Path | None = None) -> None:
    """Renders two packs from the same cameras and measures the difference: PSNR (dB), SSIM.

    Args:
        a: The reference pack, a folder or a .zip.
        b: The other pack.
        views: Number of views on an orbit around the content, 1 ... 1000.
        size: Size of each picture, WIDTHxHEIGHT in pixels.
        json: Also write the figures to this file; "-" prints them instead of the text.
    """
    from baker.reports.pack_compare import compare_packs  # OpenGL starts here, not for info
    from console.arguments import parse_size

    if not 1 <= views <= 1000:
        raise UserError("is out of range", where="--views", expected="1 to 1000", found=views)
    pixels = parse_size(size)
    check_results(json)
    result = compare_packs(a, b, views, pixels)
    if write_json(json, result):
        return
    for pack in (result["a"], result["b"]):
        print(f"{pack['path']}: {pack['codec']}, {pack['bytes'] / 1e6:.2f} MB")
    for view in (*result["views"], {"name": f"mean of {views} views", **result}):
        ssim = "" if view["ssim"] is None else f", SSIM {view['ssim']:.4f}"
        same = (
            "identical"
            if view["worst"] == 0
            else f"PSNR {view['psnr']:.2f} dB{ssim}, at most {view['worst']}/255 apart"
        )
        print(one_line(f"{view['name']}: {same}"))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(
        {**COMMANDS, "export": export, "compare": compare}, prog="snerg-pack", description=DESCRIPTION, args=args
    )


if __name__ == "__main__":
    sys.exit(main())
