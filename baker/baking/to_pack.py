"""A run baked into a pack on disk: resumable, alone or with other processes; or as a small preview, now and then while it trains.

For a preview, the field is asked at a grid of few voxels, without visibility, pruning and tuning. It is one file, so that
whoever reads the one before still can while the next takes its place.
"""

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from baker.baking.bake import (
    Bake,
    NothingThere,
    Stages,
    bake,
    check_bake,
    content_of,
    culled_grid,
    supersampled,
    work_key,
)
from baker.baking.config import BakeConfig
from baker.baking.work_folder import AGAIN, BakeEnded, Share, WorkFolder, work_beside
from console import UserError
from console.progress import duration
from scenepack import Pack, save_pack
from scenepack.blocks import restore_pack_padding
from scenepack.cameras import PICTURE, picture_uri
from scenepack.codecs import chosen_quality, codec_named
from training.devices import launched
from training.run import Run
from training.scenes.pictures import over_background
from training.scenes.scene import Scene, cameras_of


def with_pictures(pack: Pack, scene: Scene, side: int) -> Pack:
    """The pack with its photographs brought along, at most `side` pixels a side (scenepack.cameras); 0 for none."""
    if side <= 0:
        return pack
    photographs = [photograph for of_split in scene.splits.values() for photograph in of_split]
    cameras = []
    for entry, photograph in zip(pack.metadata["cameras"], photographs, strict=True):
        pixels = np.rint(255 * over_background(photograph.load(), scene.background)).astype(np.uint8)
        cameras.append({**entry, PICTURE: picture_uri(pixels, side)})
    return pack.with_metadata(cameras=cameras)


def share_of(processes: int | None, process_id: int | None) -> Share:
    """This process's share of the work, from the options or the launcher. UserError where they do not fit together."""
    launch = launched() if processes is None and process_id is None else (processes, process_id)
    count, index = launch or (1, 0)
    if count is None or index is None or not 0 <= index < count:
        raise UserError(
            "do not fit together", where="--processes, --process-id",
            expected="the number of processes, and the number of this one, from 0", found=f"{count}, {index}",
        )  # fmt: skip
    return Share(index, count)


def help_with(run: Run, config: BakeConfig, out: Path, share: Share) -> None:
    """Helps the process that bakes `run` into the pack `out`, until none of its macroblocks' density and content is missing.

    What comes after (pruning, tuning) is not shared.
    """
    check_bake(run, config)
    work = WorkFolder(work_beside(out), work_key(run, config), share)
    job = Bake(run, config, work)
    with suppress(BakeEnded):
        next(content_of(job, *culled_grid(job)), None)  # the first is there once none is missing
    print(f"{out}: {work.made} pieces of it made here; process 0 writes the pack")


def bake_to(
    run: Run,
    config: BakeConfig,
    out: Path,
    codec: str = "png",
    share: Share | None = None,
    pictures: int = 0,
    *,
    last: bool = False,
    say: Callable[[str], object] = print,
) -> dict[str, float]:
    """Bakes a loaded run with a BakeConfig into the pack `out`, resumably, and says what came of it. last: see bake.

    For a lossy codec, quality compact is full: it rounds by itself, and spends bytes on coarse steps, which are dithered.

    Returns the seconds of each stage, in order; of a bake that was broken off, those since it went on.
    """
    if config.quality == "compact" and chosen_quality(codec_named(codec, "--codec"), None) is not None:
        config = replace(config, quality="full")
    check_bake(run, config)
    stages = Stages()
    work = WorkFolder(work_beside(out), work_key(run, config), share)
    try:
        pack = with_pictures(bake(run, config, work, stages, last=last), run.scene, pictures)
        with stages("writing") as bar:
            save_pack(pack, out, codec=codec, on_progress=lambda done, total: bar.update(done / total))
    except NothingThere:
        work.remove()
        raise
    except KeyboardInterrupt as interrupt:
        raise KeyboardInterrupt(AGAIN) from interrupt
    finally:
        work.close()
    work.remove()
    say(describe_pack(pack, out))
    times = ", ".join(f"{name} {duration(seconds)}" for name, seconds in stages.seconds.items())
    say(f"{times}; {duration(sum(stages.seconds.values()))} in all{peak_memory()}")
    return stages.seconds


def peak_memory() -> str:
    """The most memory this process has held, in words; nothing where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return ""
    unit = 1 if sys.platform == "darwin" else 1024
    return f", at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9:.1f} GB of memory"


def describe_pack(pack: Pack, out: Path) -> str:
    x, y, z = pack.grid_size
    made, gain, thinned = pack.metadata["provenance"], "", ""
    counts = made["macroblocks"]
    if tuned := made.get("fine_tuning"):
        gain = f"; tuning {tuned['train_psnr_before']} -> {tuned['train_psnr_after']} dB on training pixels"
    if voxels := made.get("voxels"):
        millions = f"{voxels['after'] / 1e6:.1f} of {voxels['before'] / 1e6:.1f} million"
        thinned = f", {millions} voxels shown with tau_weight or more"
    return (
        f"{out}: {x} x {y} x {z} voxels, {counts['kept']} of {counts['grid']} macroblocks ({counts['below_tau_alpha']} "
        f"fainter than tau_alpha and {counts['below_tau_vis']} seen with less than tau_vis are left out){thinned}{gain}; "
        f"fly through it: snerg-view {out}"
    )


# --- Previews of a run that trains ---

PREVIEW_FILE = "preview.zip"  # beside run and pack
PREVIEW_RESOLUTION = 150  # voxels along the longest side: five macroblocks
FIRST_STEP = 100  # before, nothing is to be seen
MOST_OF_TIME = 0.1  # of a run's time that its previews take


def preview_pack(run: Run, resolution: int = PREVIEW_RESOLUTION) -> Pack | None:
    """A small pack of the run's field at its latest step; None while the field is empty."""
    config = BakeConfig(resolution, seed=run.config.seed, keeps_hidden=True)
    job = Bake(run, config, stages=Stages(quiet=True))
    try:
        pack = supersampled(job, *culled_grid(job))
    except NothingThere:
        return None
    restore_pack_padding(pack)
    provenance = {
        "scene": str(run.scene.path), "run": str(run.path), "steps": run.step, "of_steps": run.config.steps,
        "preview": True, **vars(run.options),
    }  # fmt: skip
    return pack.with_metadata(provenance=provenance, cameras=cameras_of(run.scene), near=float(run.scene.near))


class Previews:
    """Keeps the file `out` up to date while a run trains. every: seconds between two, at least."""

    def __init__(self, out: Path, every: float) -> None:
        self.out, self.every = out, every
        self._due = time.monotonic() + every

    def update(self, run: Run) -> None:
        """Writes another where it is time; for training.loop.train, after each step."""
        if self.due(run):
            self.write(run)

    def due(self, run: Run) -> bool:
        """Whether it is time for another."""
        return run.config.method == "multires" and run.step >= FIRST_STEP and time.monotonic() >= self._due

    def write(self, run: Run) -> None:
        """Writes one. What it fails at is no reason to stop the training: the next may be written."""
        began = time.monotonic()
        with suppress(UserError, OSError, MemoryError):  # a full disk, say, of which the training's own files will tell
            if (pack := preview_pack(run)) is not None:
                save_pack(pack, self.out)
        ended = time.monotonic()
        self._due = ended + max(self.every, (ended - began) / MOST_OF_TIME)

    def remove(self) -> None:
        """There is something better now."""
        self.out.unlink(missing_ok=True)
