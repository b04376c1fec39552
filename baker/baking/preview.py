"""What a run has so far as a small pack, now and then while it trains: to fly around in before it is done.

A field is asked at a grid of few voxels, without visibility, pruning and tuning. The pack is one file, so that whoever reads the
one before still can while the next takes its place.
"""

import time
from functools import partial
from pathlib import Path

import numpy as np

from baker.baking.bake import assembled
from baker.baking.config import BLOCK_SIZE
from baker.baking.culling import content_box, opaque_macroblocks
from baker.baking.field_query import field_query
from baker.baking.grid import box_in_grid_frame, make_grid
from baker.baking.supersample import Sampler, supersample
from console import UserError
from scenepack import save_pack
from scenepack.blocks import fill_atlas, restore_pack_padding
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
    query, frame = field_query(run), np.asarray(run.scene.worldspace_T_opengl, np.float64)
    found = content_box(query, *box_in_grid_frame(run.dataset.aabb, frame), resolution, frame)
    if found is None:
        return None
    grid = make_grid(*found, resolution, BLOCK_SIZE, frame, run.dataset.facts.contraction)
    opacity = opaque_macroblocks(query, grid, partial(run.method.may_hold, run.state))
    culling = opacity.culling(grid, opacity.opaque)  # what no camera sees stays
    if not culling.kept.any():
        return None
    macroblocks = supersample(Sampler(query, grid, culling, run.method.grain(run.state), run.config.seed))
    provenance = {
        "scene": str(run.scene.path), "run": str(run.path), "steps": run.step, "of_steps": run.config.steps,
        "preview": True, **vars(run.options),
    }  # fmt: skip
    pack = assembled(run, grid, fill_atlas(macroblocks, culling.kept, BLOCK_SIZE))
    restore_pack_padding(pack)
    return pack.with_metadata(provenance=provenance, cameras=cameras_of(run.scene), near=float(run.scene.near))


class Previews:
    """Keeps the file `out` up to date while a run trains. every: seconds between two, at least."""

    def __init__(self, out: Path, every: float) -> None:
        self.out, self.every = out, every
        self._due = time.monotonic() + every

    def update(self, run: Run) -> None:
        """Writes another where it is time; for training.loop.train, after each step."""
        if run.config.method == "multires" and run.step >= FIRST_STEP and time.monotonic() >= self._due:
            self.write(run)

    def write(self, run: Run) -> None:
        """Writes one. What it fails at is no reason to stop the training: the next may be written."""
        began = time.monotonic()
        try:
            pack = preview_pack(run)
            if pack is not None:
                save_pack(pack, self.out, png_level=PNG_LEVEL)
        except (UserError, OSError, MemoryError):  # a full disk, say, of which the training's own files will tell
            pass
        ended = time.monotonic()
        self._due = ended + max(self.every, (ended - began) / MOST_OF_TIME)

    def remove(self) -> None:
        """There is something better now."""
        self.out.unlink(missing_ok=True)
