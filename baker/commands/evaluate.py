"""`snerg-eval (RUN|PACK) --scene SCENE`: image quality against photographs (CONTRACT section 4)."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from console import UserError, run_command

DESCRIPTION = "Compares a trained run, or a pack drawn by the OpenGL renderer, with the photographs of a scene."


def snerg_eval(
    subject: Path,
    /,
    scene: Path,
    split: str = "test",
    downscale: int = 1,
    json: Path | None = None,
    images: Path | None = None,
) -> None:
    """Scores views against photographs: PSNR (dB), SSIM, LPIPS.

    Args:
        subject: Folder of a run, or a pack (folder or .zip).
        scene: Folder of the photographs.
        split: Which photographs: test, train or val.
        downscale: Divide width and height of the photographs by this whole number.
        json: Write the scores to this file, too.
        images: Folder for pictures: ours, the photograph, and five times their difference.
    """
    from baker.evaluation import evaluate
    from training.scenes import load_scene

    if not subject.exists():
        raise UserError("no such run or pack", where=subject)
    result = evaluate(subject, load_scene(scene, downscale=downscale), split, images)
    lpips = "-" if result["lpips"] is None else f"{result['lpips']:.4f}"
    for view in result["views"]:
        print(f"{view['name']}: {view['psnr']:.2f} dB, SSIM {view['ssim']:.4f}")
    print(
        f"mean of {len(result['views'])} views at {result['width']} x {result['height']}: PSNR {result['psnr']:.2f} dB, "
        f"SSIM {result['ssim']:.4f}, LPIPS {lpips}"
    )
    if json is not None:
        _write_json(json, result)


def _write_json(path: Path, result: dict) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(snerg_eval, prog="snerg-eval", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
