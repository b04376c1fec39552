"""`snerg-bake RUN --out PACK`: a trained run becomes a pack (docs/commands.md)."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from console import UserError, run_command
from console.arguments import join_negative_values

DESCRIPTION = "Bakes a trained run into a pack: a sparse voxel grid that the viewer renders in real time."


def snerg_bake(
    run: Path,
    /,
    out: Path,
    resolution: int = 512,
    codec: Literal["png", "webp", "jpeg", "h264", "avif"] = "png",
    tau_alpha: float = 0.005,
    tau_vis: float = 0.01,
    tau_weight: float = 0.0085,
    fine_tune: Literal["none", "view-mlp", "all"] = "all",
    fine_tune_epochs: int = 100,
    seed: int = 0,
    most_macroblocks: int = 6000,
    aabb: str | None = None,
    processes: int | None = None,
    process_id: int | None = None,
    pictures: int = 0,
) -> None:
    """Bakes a trained run into a pack.

    Args:
        run: Folder of the run, from snerg-train.
        out: Folder of the pack, or a file name that ends in .zip. A new pack replaces an old one when it is complete.
        resolution: Voxels along the longest side of the content.
        codec: Codec of the atlas: png (the published layout), webp (lossless, smaller), or jpeg, h264, avif (lossy).
        tau_alpha: Drop macroblocks whose largest opacity is below this, 0 ... 1.
        tau_vis: Drop macroblocks that no training camera sees with at least this transmittance, 0 ... 1.
        tau_weight: Empty voxels that would make up less than this of any pixel of any training photograph, 0 ... 1; by less
            where the photographs lose 0.1 dB. 0 keeps all.
        fine_tune: What to tune after baking: none; view-mlp (as in the paper); or all: the view MLP, then voxels and view
            MLP together (sharper, takes minutes).
        fine_tune_epochs: Passes over the training pixels while the view MLP is tuned. Not used if nothing is tuned.
        seed: Random seed of the samples inside voxels and of fine-tuning.
        most_macroblocks: If more would be kept, the grid is made coarser. A macroblock takes 0.26 MB on the graphics card.
        aabb: Box that is baked, x0,y0,z0,x1,y1,z1 in the training frame. The default is the box around the content. Not for
            forward-facing scenes, which are in NDC.
        processes: Number of processes that bake this pack together. Each runs the same command on a host that shares the
            folders of run and pack. Slurm and MPI set it. See docs/distributed.md.
        process_id: Number of this process, from 0. Process 0 writes the pack.
        pictures: Put copies of the photographs into the pack, at most this many pixels a side, for viewers on other
            computers. 0 puts in none.
    """
    from baker.baking.bake import BakeConfig  # JAX starts here, not for --help
    from baker.baking.to_pack import bake_to, help_with, share_of
    from scenepack import check_target
    from scenepack.pictures import LARGEST_SIDE
    from training.run import load_run
    from training.scenes.box import parse_box

    share = share_of(processes, process_id)
    check_target(out)  # now, not after the work is done
    box = None if aabb is None else parse_box(aabb)
    config = BakeConfig(
        resolution, tau_alpha, tau_vis, tau_weight, fine_tune, fine_tune_epochs, seed, most_macroblocks, box
    )
    config.check()
    if not 0 <= pictures <= LARGEST_SIDE:
        raise UserError("is out of range", where="--pictures", expected=f"0 to {LARGEST_SIDE}", found=pictures)
    if share.helps:
        help_with(load_run(run), config, out, share)
    else:
        bake_to(load_run(run), config, out, codec, share, pictures, last=True)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    words = join_negative_values(sys.argv[1:] if args is None else args, ["--aabb"])
    return run_command(snerg_bake, prog="snerg-bake", description=DESCRIPTION, args=words)


if __name__ == "__main__":
    sys.exit(main())
