"""`snerg-bake RUN --out PACK`: a trained run becomes a pack (docs/commands.md)."""

from collections.abc import Sequence
from pathlib import Path

from baker.baking.config import BakeConfig, BakePreset, Quality
from console import run_command
from console.command_line import require_in_range
from scenepack.constants import CodecName
from training.libraries import begin_libraries


def snerg_bake(
    run: Path,
    /,
    out: Path,
    scene: Path | None = None,
    preset: BakePreset = BakeConfig.preset,
    resolution: int | None = None,
    codec: CodecName = "png",
    quality: Quality = BakeConfig.quality,
    seed: int = BakeConfig.seed,
    most_macroblocks: int | None = None,
    aabb: str | None = None,
    processes: int | None = None,
    process_id: int | None = None,
    pictures: int = 0,
) -> None:
    """Bakes a trained run into a pack: a sparse voxel grid that the viewer renders in real time.

    Args:
        run: Folder of the run, from snerg-train.
        out: Folder of the pack, or a file name that ends in .zip. A new pack replaces an old one when it is complete.
        scene: Folder of the photographs, if they moved. The default is where the run read them.
        preset: How to bake: snerg (our way), paper (what the SNeRG paper writes; see docs/commands.md).
        resolution: Voxels along the longest side of the content. The default is 1.25 a pixel of the photographs, 1.5 where
            they look forward, 5 where they show everything around, from 512 to 1000; of the preset paper, 1000 for synthetic
            scenes, 1300 for photographs.
        codec: Codec of the atlas: png (the published layout), webp (lossless, smaller), or jpeg, h264, avif (lossy).
        quality: draft (nothing is tuned), full (tuned, 8 bits), or compact (tuned, and stored in coarser steps: 30 %
            fewer bytes for about 0.1 dB less). compact is full where the codec is lossy. The preset paper tunes the view MLP
            alone.
        seed: Random seed of the samples inside voxels and of tuning.
        most_macroblocks: If more would be kept, the grid is made coarser. A macroblock takes 0.26 MB on the graphics card. The
            default is 6000; of the preset paper, no limit.
        aabb: Box that is baked, x0,y0,z0,x1,y1,z1 in the training frame. The default is the box around the content. Not for
            forward-facing scenes, which are in NDC.
        processes: Number of processes that bake this pack together. Each runs the same command on a host that shares the
            folders of run and pack. Slurm and MPI set it. See docs/distributed.md.
        process_id: Number of this process, from 0. Process 0 writes the pack.
        pictures: Put copies of the photographs into the pack, at most this many pixels a side, for viewers on other
            computers. 0 puts in none.
    """
    begin_libraries()  # JAX starts here, not for --help
    from baker.baking.to_pack import bake_to, help_with, share_of
    from scenepack import check_target
    from scenepack.cameras import LARGEST_SIDE
    from training.run import load_run
    from training.scenes.scene_options import parse_box

    share = share_of(processes, process_id)
    check_target(out)  # now, not after the work is done
    config = BakeConfig(resolution, preset, quality, seed, most_macroblocks, aabb=parse_box(aabb))
    config.check()
    require_in_range("--pictures", pictures, 0, LARGEST_SIDE)
    loaded = load_run(run, scene_path=scene)
    if share.helps:
        help_with(loaded, config, out, share)
    else:
        bake_to(loaded, config, out, codec, share, pictures, last=True)


def main(args: Sequence[str] | None = None) -> int:
    return run_command(snerg_bake, prog="snerg-bake", args=args)
