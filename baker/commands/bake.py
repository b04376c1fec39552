"""`snerg-bake RUN --out PACK`: a trained run becomes a pack (docs/commands.md)."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import inspect
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

from baker.baking.presets import FineTune
from console import UserError, run_command
from console.arguments import join_negative_values
from scenepack.constants import CodecName
from training.libraries import begin_libraries

DESCRIPTION = "Bakes a trained run into a pack: a sparse voxel grid that the viewer renders in real time."


def snerg_bake(
    run: Path,
    /,
    out: Path,
    scene: Path | None = None,
    preset: Literal["snerg", "paper"] = "snerg",
    resolution: int | None = 512,
    codec: CodecName = "png",
    tau_alpha: float = 0.005,
    tau_vis: float = 0.01,
    tau_weight: float = 0.0085,
    fine_tune: FineTune = "auto",
    fine_tune_epochs: int = 100,
    fine_tune_pixels: int = 1_000_000,
    supersampling: Literal["grain", "paper"] = "grain",
    thin: float = 0.0,
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
        scene: Folder of the photographs, if they moved. The default is where the run read them.
        preset: Named settings: snerg (our defaults), paper (what the SNeRG paper writes). The defaults below are those of the
            chosen preset.
        resolution: Voxels along the longest side of the content. The preset paper takes 1000 for synthetic scenes (Blender) and
            1300 for photographs, unless you give another.
        codec: Codec of the atlas: png (the published layout), webp (lossless, smaller), or jpeg, h264, avif (lossy).
        tau_alpha: Drop macroblocks whose largest opacity is below this, 0 ... 1.
        tau_vis: Drop macroblocks that no training camera sees with at least this transmittance, 0 ... 1.
        tau_weight: Empty voxels that would make up less than this of any pixel of any training photograph, 0 ... 1; by less
            where the photographs lose 0.05 dB. 0 keeps all.
        fine_tune: What to tune after baking: none; view-mlp (as in the paper); all: the view MLP, then voxels and view
            MLP together (sharper, takes minutes); compact: as all, in coarser steps of what is stored (half the bytes, a
            little less sharp); or auto: compact where the codec is lossless and tuning makes up for it, otherwise all.
        fine_tune_epochs: Passes over the training pixels while the view MLP is tuned. Not used if nothing is tuned.
        fine_tune_pixels: Number of training pixels that tune the view MLP, an even random share; 0 for all (the paper).
        supersampling: How the content of a voxel is averaged: grain (as far as the field varies within a voxel), or paper (16
            Gaussian samples, plain averages).
        thin: Give up so many dB of the training photographs for a faster, smaller scene, 0 ... 3: voxels are emptied and
            closed, by at most 0.2 dB more before they are tuned for the last time, and by at most this at the end.
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
    begin_libraries()  # JAX starts here, not for --help
    from baker.baking.config import BakeConfig
    from baker.baking.presets import SYNTHETIC_RESOLUTION, paper_resolution
    from baker.baking.to_pack import bake_to, help_with, share_of
    from scenepack import check_target
    from scenepack.pictures import LARGEST_SIDE
    from training.run import load_run
    from training.scenes.scene_options import parse_box

    share = share_of(processes, process_id)
    check_target(out)  # now, not after the work is done
    config = BakeConfig(
        SYNTHETIC_RESOLUTION if resolution is None else resolution, tau_alpha, tau_vis, tau_weight, fine_tune,
        fine_tune_epochs, fine_tune_pixels, supersampling, thin, seed, most_macroblocks,
        parse_box(aabb),
    )  # fmt: skip
    config.check()
    if not 0 <= pictures <= LARGEST_SIDE:
        raise UserError("is out of range", where="--pictures", expected=f"0 to {LARGEST_SIDE}", found=pictures)
    loaded = load_run(run, scene_path=scene)
    if resolution is None:
        config = dataclasses.replace(config, resolution=paper_resolution(loaded.scene))
    if share.helps:
        help_with(loaded, config, out, share)
    else:
        bake_to(loaded, config, out, codec, share, pictures, last=True)


def command_for(words: Sequence[str]) -> Callable[..., None]:
    """snerg_bake, with the defaults of the preset that is named in `words`, so that other options change single settings."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--preset")
    try:
        preset = parser.parse_known_args(list(words))[0].preset
    except (argparse.ArgumentError, SystemExit):
        preset = None  # the command's own parser meets it again, and tells
    if preset != "paper":
        return snerg_bake
    from baker.baking.presets import CHANGES

    changed = {"resolution": None, **CHANGES["paper"]}
    signature = inspect.signature(snerg_bake)

    @functools.wraps(snerg_bake)
    def bake_as_the_paper(*args: Any, **options: Any) -> None:
        snerg_bake(*args, **options)

    of_the_paper = [p.replace(default=changed.get(name, p.default)) for name, p in signature.parameters.items()]
    bake_as_the_paper.__signature__ = signature.replace(parameters=of_the_paper)  # type: ignore[attr-defined]
    return bake_as_the_paper


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    words = join_negative_values(sys.argv[1:] if args is None else args, ["--aabb"])
    return run_command(command_for(words), prog="snerg-bake", description=DESCRIPTION, args=words)


if __name__ == "__main__":
    sys.exit(main())
