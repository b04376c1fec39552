"""`snerg-bake RUN --out PACK`: a trained run becomes a pack (docs/commands.md)."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from console import UserError, progress, run_command
from console.progress import duration

if TYPE_CHECKING:
    from baker.baking.bake import BakeConfig
    from baker.baking.work_folder import Share
    from scenepack import Pack
    from training.run import Run

DESCRIPTION = "Bakes a trained run into a pack: a sparse voxel grid that the viewer renders in real time."


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
        tau_weight: Empty voxels that no training photograph shows with at least this weight, 0 ... 1. 0 keeps all. The
            default is 0.02 up to a resolution of 512, and 0 above.
        fine_tune: What to tune after baking: none; view-mlp (as in the paper); or all: the view MLP, then voxels and view
            MLP together (sharper, takes minutes more).
        fine_tune_epochs: Passes over the training pixels while the view MLP is tuned. Not used if nothing is tuned.
        seed: Random seed of the samples inside voxels and of fine-tuning.
        processes: Number of processes that bake this pack together. Each runs the same command on a host that shares the
            folders of run and pack. Slurm and MPI set it. See docs/distributed.md.
        process_id: Number of this process, from 0. Process 0 writes the pack.
        pictures: Put copies of the photographs into the pack, at most this many pixels a side, for viewers on other
            computers. 0 puts in none.
    """
    from baker.baking.bake import BakeConfig  # JAX starts here, not for --help
    from scenepack import check_target
    from training.run import load_run

    share = share_of(processes, process_id)
    check_target(out)  # now, not after the work is done
    config = BakeConfig(resolution, tau_alpha, tau_vis, tau_weight, fine_tune, fine_tune_epochs, seed)
    if share.helps:
        help_with(load_run(run), config, out, share)
    else:
        bake_to(load_run(run), config, out, codec, share, pictures)


def share_of(processes: int | None, process_id: int | None) -> Share:
    """This process's share of the work, from the options or the launcher. UserError where they do not fit together."""
    from baker.baking.work_folder import Share
    from training.devices import launched

    told = launched() if processes is None and process_id is None else (processes, process_id)
    count, index = told or (1, 0)
    if count is None or index is None or not 0 <= index < count:
        raise UserError(
            "do not fit together", where="--processes, --process-id",
            expected="the number of processes, and the number of this one, from 0", found=f"{count}, {index}",
        )  # fmt: skip
    return Share(index, count)


def help_with(run: Run, config: BakeConfig, out: Path, share: Share) -> None:
    """Helps the process that bakes `run` into the pack `out`, until its macroblocks are made."""
    from baker.baking.bake import help_bake, work_key
    from baker.baking.work_folder import WorkFolder, work_beside

    work = WorkFolder(work_beside(out), work_key(run, config), share)
    help_bake(run, config, work)
    print(f"{out}: {work.made} pieces of it made here; process 0 writes the pack")


def bake_to(
    run: Run, config: BakeConfig, out: Path, codec: str = "png", share: Share | None = None, pictures: int = 0
) -> dict[str, float]:
    """Bakes a loaded run with a BakeConfig into the pack `out`, resumably, and prints what came of it.

    Returns the seconds of each stage, in order; of a bake that was broken off, those since it went on.
    """
    from baker.baking.bake import STAGE, Stages, bake, work_key
    from baker.baking.pictures import with_pictures
    from baker.baking.work_folder import AGAIN, WorkFolder, work_beside
    from scenepack import save_pack

    if config.tau_weight is None:
        print(describe_pruning(config))
    stages = Stages()
    work = WorkFolder(work_beside(out), work_key(run, config), share)
    try:
        pack = with_pictures(bake(run, config, work, stages), run.scene, pictures)
        with stages("writing"), progress("writing the pack", 1, stage=STAGE) as bar:
            save_pack(pack, out, codec=codec, on_progress=lambda done, total: bar.update(done / total))
    except KeyboardInterrupt as interrupt:
        raise KeyboardInterrupt(AGAIN) from interrupt
    finally:
        work.close()
    work.remove()
    print(describe_pack(pack, out))
    times = ", ".join(f"{name} {duration(seconds)}" for name, seconds in stages.seconds.items())
    print(f"{times}; {duration(sum(stages.seconds.values()))} in all{peak_memory()}")
    return stages.seconds


def describe_pruning(config: BakeConfig) -> str:
    """One line about what happens to faint voxels where no --tau-weight says it."""
    from baker.baking.bake import FINEST_PRUNED

    if config.least_weight > 0:
        return f"--tau-weight {config.least_weight:g}: voxels that no photograph shows with that weight are emptied"
    return (
        f"--tau-weight 0: above {FINEST_PRUNED} voxels a side no faint voxels are emptied unless --tau-weight says so, "
        "since visible ones would go, too"
    )


def peak_memory() -> str:
    """The most memory this process has held, in words; nothing where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return ""
    unit = 1 if sys.platform == "darwin" else 1024
    return f", at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9:.1f} GB of memory"


def describe_pack(pack: Pack, out: Path) -> str:
    """One line about a pack just written."""
    x, y, z = pack.grid_size
    made = pack.metadata["provenance"]
    tuned = made.get("fine_tuning")
    gain = (
        f"; fine-tuning {tuned['held_out_psnr_before']} -> {tuned['held_out_psnr_after']} dB on held-out training views"
        if tuned and "held_out_psnr_after" in tuned
        else f"; fine-tuning {tuned['train_psnr_before']} -> {tuned['train_psnr_after']} dB on training pixels"
        if tuned
        else ""
    )
    counts, voxels = made["macroblocks"], made.get("voxels")
    thinned = (
        f", {voxels['after'] / 1e6:.1f} of {voxels['before'] / 1e6:.1f} million voxels shown with tau_weight or more"
        if voxels
        else ""
    )
    return (
        f"{out}: {x} x {y} x {z} voxels, {counts['kept']} of {counts['grid']} macroblocks ({counts['below_tau_alpha']} "
        f"fainter than tau_alpha and {counts['below_tau_vis']} seen with less than tau_vis are left out){thinned}{gain}; "
        f"fly through it: snerg-view {out}"
    )


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(snerg_bake, prog="snerg-bake", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
