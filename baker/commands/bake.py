"""`snerg-bake RUN --out PACK`: a trained run becomes a pack (CONTRACT section 4)."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from console import run_command

DESCRIPTION = "Bakes a trained run into a pack: a sparse voxel grid that the viewer shows in real time."


def snerg_bake(
    run: Path,
    /,
    out: Path,
    resolution: int = 512,
    codec: Literal["png", "webp", "jpeg", "h264", "avif"] = "png",
    tau_alpha: float = 0.005,
    tau_vis: float = 0.01,
    fine_tune_epochs: int = 100,
    seed: int = 0,
) -> None:
    """Bakes a trained run into a pack.

    Args:
        run: Folder of the run, from snerg-train.
        out: Folder of the pack to write, or a file that ends in .zip; an old pack there is replaced when the new is done.
        resolution: Voxels along the longest side of the content.
        codec: How the atlas is compressed: png (the published layout), webp (lossless, smaller), jpeg, h264, avif (lossy).
        tau_alpha: Macroblocks whose largest opacity is below this are dropped.
        tau_vis: Macroblocks that no training camera sees with at least this transmittance are dropped.
        fine_tune_epochs: Passes over the training pixels that refine the view MLP; 0 for none.
        seed: Seed of the samples within voxels and of fine-tuning.
    """
    from baker.bake import BakeConfig, bake  # JAX starts here, not for --help
    from scenepack import check_target, save_pack
    from training.run import load_run

    check_target(out)  # now, not after the work is done
    config = BakeConfig(resolution, tau_alpha, tau_vis, fine_tune_epochs, seed)
    pack = bake(load_run(run), config)
    save_pack(pack, out, codec=codec)
    print(describe_pack(pack, out))


def describe_pack(pack, out: Path) -> str:
    """One line about a pack just written."""
    x, y, z = pack.grid_size
    made = pack.metadata["provenance"]
    tuned = made.get("fine_tuning")
    gain = (
        f"; fine-tuning {tuned['train_psnr_before']} -> {tuned['train_psnr_after']} dB on training pixels"
        if tuned
        else ""
    )
    counts = made["macroblocks"]
    return (
        f"{out}: {x} x {y} x {z} voxels, {counts['kept']} macroblocks ({counts['with_opacity']} with opacity, "
        f"{counts['hidden']} of them hidden and dropped){gain}; fly through it: snerg-view {out}"
    )


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(snerg_bake, prog="snerg-bake", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
