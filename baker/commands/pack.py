"""`snerg-pack info|check|convert|compare`: all about packs (docs/commands.md).

The first three are scenepack's; `compare` draws, and scenepack may not import the renderer. Nothing here needs JAX, so
all four work in the viewer-only install.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from console import UserError, run_command, write_json
from scenepack.commands import COMMANDS

DESCRIPTION = (
    "Look into, validate, convert and compare baked scenes (packs): a folder with scene_params.json, or one .zip."
)


def compare(a: Path, b: Path, /, views: int = 8, size: str = "400x400", json: Path | None = None) -> None:
    """Draws two packs from the same cameras and tells how much the pictures differ.

    Args:
        a: The pack to compare with, a folder or a .zip.
        b: The other pack.
        views: How many pictures, once around the content.
        size: Width x height of each, in pixels.
        json: Also write the figures to this file; "-" prints them instead.
    """
    from baker.reports.pack_compare import compare_packs  # OpenGL starts here, not for info
    from console.arguments import parse_size

    if not 1 <= views <= 1000:
        raise UserError("is out of range", where="--views", expected="1 to 1000", found=views)
    result = compare_packs(a, b, views, parse_size(size))
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
        print(f"{view['name']}: {same}")


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command({**COMMANDS, "compare": compare}, prog="snerg-pack", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
