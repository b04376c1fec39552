"""`snerg-bake RUN --out PACK`: a trained run becomes a pack (docs/commands.md)."""

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
    tau_weight: float | None = None,
    fine_tune: Literal["none", "view-mlp", "all"] = "view-mlp",
    fine_tune_epochs: int = 100,
    seed: int = 0,
    processes: int | None = None,
    process_id: int | None = None,
) -> None:
    """Bakes a trained run into a pack.

    Args:
        run: Folder of the run, from snerg-train.
        out: Folder of the pack to write, or a file that ends in .zip; an old pack there is replaced when the new is done.
        resolution: Voxels along the longest side of the content.
        codec: How the atlas is compressed: png (the published layout), webp (lossless, smaller), jpeg, h264, avif (lossy).
        tau_alpha: Macroblocks whose largest opacity is below this are dropped.
        tau_vis: Macroblocks that no training camera sees with at least this transmittance are dropped.
        tau_weight: Voxels that no training photograph shows with at least this weight are emptied; 0 leaves all. By default
            0.02, and 0 at resolutions above 512.
        fine_tune: none; view-mlp, the paper's; or all: then the stored voxels, too, with it (minutes more, sharper).
        fine_tune_epochs: Passes over the training pixels that refine the view MLP; not with --fine-tune none.
        seed: Seed of the samples within voxels and of fine-tuning.
        processes: How many processes bake this pack together, each with the same line, on hosts that share the folders of
            run and pack (docs/distributed.md; Slurm and MPI tell it themselves).
        process_id: Which of them this one is, from 0, which writes the pack.
    """
    from baker.baking.bake import BakeConfig  # JAX starts here, not for --help
    from baker.baking.to_pack import bake_to, help_with, share_of
    from scenepack import check_target
    from training.run import load_run

    share = share_of(processes, process_id)
    check_target(out)  # now, not after the work is done
    config = BakeConfig(resolution, tau_alpha, tau_vis, tau_weight, fine_tune, fine_tune_epochs, seed)
    if share.helps:
        help_with(load_run(run), config, out, share)
    else:
        bake_to(load_run(run), config, out, codec, share)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(snerg_bake, prog="snerg-bake", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
