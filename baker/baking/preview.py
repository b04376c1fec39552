"""What a run has so far as a small pack, now and then while it trains: to fly around in before it is done.

A field is asked at a grid of few voxels, without visibility, pruning and tuning. The pack is one file, so that whoever reads the
one before still can while the next takes its place.
"""

import time
from contextlib import suppress
from pathlib import Path

from baker.baking.bake import Bake, NothingThere, Stages, culled_grid, supersampled
from baker.baking.config import BakeConfig
from console import UserError
from scenepack import save_pack
from scenepack.blocks import restore_pack_padding
from scenepack.pack import Pack
from training.run import Run
from training.scenes.scene import cameras_of

NAME = "preview.zip"  # beside run and pack
RESOLUTION = 150  # voxels along the longest side: five macroblocks
FIRST_STEP = 100  # before, nothing is to be seen
MOST_OF_TIME = 0.1  # of a run's time that its previews take
PNG_LEVEL = 1  # fast: it lives for a minute


def preview_pack(run: Run, resolution: int = RESOLUTION) -> Pack | None:
    """The run's field as it is now; None where it holds nothing yet."""
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
                save_pack(pack, self.out, png_level=PNG_LEVEL)
        ended = time.monotonic()
        self._due = ended + max(self.every, (ended - began) / MOST_OF_TIME)

    def remove(self) -> None:
        """There is something better now."""
        self.out.unlink(missing_ok=True)
