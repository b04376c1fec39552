"""From a trained run to a pack (SNeRG sections 5.3 to 5.5), pass by pass:

    box, opacity, visibility, supersampling      the field becomes voxels of 8 bits      this module
    padding, sharpening, pruning,
    feature scale, tuning, hidden voxels         the voxels become the pack              baker.baking.passes

It works macroblock by macroblock, and keeps on disk what is done: no array of N³ × channels is ever made, and a bake that
was killed goes on where it was (baker.baking.work_folder).
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from baker.baking.config import BLOCK_SIZE, BakeConfig
from baker.baking.culling import Culling, content_box, opaque_macroblocks, seen_macroblocks
from baker.baking.field_query import FieldQuery, field_query, within
from baker.baking.grid import BakeGrid, FloatGrid, assemble, box_in_grid_frame, make_grid
from baker.baking.passes import Voxels, passes_of
from baker.baking.supersample import Sampler, supersample, supersample_floats
from baker.baking.work_folder import Arrays, WorkFolder, once
from baker.tuning.shading import from_params
from console import Notice, Progress, UserError, notify, progress
from scenepack.blocks import fill_atlas
from scenepack.pack import Pack
from training.checkpoints import checksum
from training.libraries import keep_freed_memory, release_freed_memory
from training.run import Run, require_bakeable
from training.scenes.scene import Box, cameras_of
from training.scenes.scene_options import AABB, box_text, with_box

BYTES = 32**3 * 8  # of a macroblock, with padding: colour, opacity, features
COARSER = 0.95  # than a surface's share of the macroblocks asks for, since haze is thicker than a surface
STAGE = "baking"  # in what programs that started us read of our progress
FORMAT = 5  # of a work folder: raised whenever the same key would give other pieces


class Stages:
    """Seconds spent in each stage of a bake, by name, in order. quiet: without a progress line."""

    def __init__(self, *, quiet: bool = False) -> None:
        self.seconds, self.quiet = dict[str, float](), quiet

    @contextmanager
    def __call__(self, name: str, total: float = 1.0) -> Iterator[Progress]:
        started = time.monotonic()
        with progress(name, total, self.quiet, stage=STAGE) as bar:
            yield bar
            bar.update(total)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - started


@dataclass(frozen=True)
class Bake:
    """A bake: the run, how to bake it, and where its parts are kept."""

    run: Run
    config: BakeConfig
    work: WorkFolder | None = None  # finished parts, which the caller removes when the pack is saved
    stages: Stages = field(default_factory=Stages)

    @property
    def query(self) -> FieldQuery:
        """The field; empty outside of a box that was asked for: grids are whole macroblocks and reach further."""
        query, box = field_query(self.run), self.config.aabb
        return query if box is None else within(query, _box_to_bake(self.run, box))

    def sampler(self, grid: BakeGrid, culling: Culling) -> Sampler:
        grain, as_paper = self.run.method.grain(self.run.state), self.config.preset == "paper"
        return Sampler(self.query, grid, culling, grain, self.config.seed, as_paper)


def bake(
    run: Run, config: BakeConfig, work: WorkFolder | None = None, stages: Stages | None = None, *, last: bool = False
) -> Pack:
    """Bakes the run's field. UserError where the field holds nothing that a training camera sees.

    work, stages: see Bake. last: frees the run's state once the voxels are made, which saves a gigabyte.
    """
    check_bake(run, config)
    job = Bake(run, config, work, stages or Stages())
    grid, culling = culled_grid(job)
    pack = supersampled(job, grid, culling)
    photographs = run.dataset.in_average_look(run.method.gains(run.state))  # as the field shows them
    if last:
        run.state = None
    voxels = Voxels(pack, photographs, config)
    del pack  # what pruning leaves takes its place
    for name, improve in passes_of(config):
        with job.stages(name) as bar:
            voxels = improve(voxels, bar)
            release_freed_memory()  # which is in pieces, so that large arrays would not fit into it
    counts = culling.counts()
    if (pruned := voxels.pruned) is not None:
        counts |= {"below_tau_weight": pruned.macroblocks, "kept": counts["kept"] - pruned.macroblocks}
    provenance: dict[str, Any] = {  # no times here: a resumed bake must give the same bytes
        "scene": str(run.scene.path), "run": str(run.path), "steps": run.step, "method": run.config.method,
        **vars(run.options), "aabb": config.aabb or run.options.aabb, "resolution": grid.resolution,
        "preset": config.preset, "quality": config.quality, "macroblocks": counts, **voxels.notes,
    }  # fmt: skip
    return voxels.pack.with_metadata(provenance=provenance, cameras=cameras_of(run.scene), near=float(run.scene.near))


def bake_floats(run: Run, config: BakeConfig) -> FloatGrid:
    """The grid in floats, before quantisation: neither pruned nor tuned, not kept on disk. Raises what `bake` raises."""
    check_bake(run, config)
    job = Bake(run, config)
    grid, culling = culled_grid(job)
    with job.stages("supersampling, in floats") as bar:
        parts = supersample_floats(job.sampler(grid, culling), bar.update)
        indices, rows, values = assemble(parts, culling.kept, BLOCK_SIZE)
    support = np.zeros((*rows.shape, 4), np.uint8)
    support[..., 3] = (rows > 0) * np.uint8(255)
    return FloatGrid(assembled(run, grid, (indices, support, None)), rows, values)


def check_bake(run: Run, config: BakeConfig) -> None:
    """UserError where this run cannot be baked so; before anything is written."""
    require_bakeable(run)
    config.check()
    if config.aabb is not None:
        _box_to_bake(run, config.aabb)
    keep_freed_memory()


def work_key(run: Run, config: BakeConfig) -> dict[str, Any]:
    """Identifies the contents of a work folder: the run's state, and the options that decide voxels before pruning."""
    return {
        "format": FORMAT, "run": str(run.path.resolve()), "step": run.step, "state": checksum(run.method.save(run.state)),
        "scene": str(run.scene.path), "downscale": run.options.downscale, "block_size": BLOCK_SIZE, "seed": config.seed,
        "resolution": config.resolution_of(run), "preset": config.preset, "most_macroblocks": config.block_limit,
        "aabb": config.aabb, "keeps_hidden": config.keeps_hidden,
    }  # fmt: skip


def culled_grid(job: Bake) -> tuple[BakeGrid, Culling]:
    """The grid around the content, as fine as the limit of macroblocks allows, and which of them are kept."""
    run, config, frame = job.run, job.config, job.run.scene.worldspace_T_opengl
    with job.stages("box"):
        box = once(job.work, "box", lambda: _find_box(job))
    contraction = run.dataset.facts.contraction if config.aabb is None else None
    resolution = config.resolution_of(run)
    while True:
        grid = make_grid(box["low"], box["high"], resolution, BLOCK_SIZE, frame, contraction)
        with job.stages("opacity") as bar:
            opacity = opaque_macroblocks(job.query, grid, partial(run.method.may_hold, run.state), bar.update, job.work)
        with job.stages("visibility") as bar:
            if config.keeps_hidden:
                culling = opacity.culling(grid, opacity.opaque)
            else:
                culling = seen_macroblocks(opacity, grid, run.dataset, bar.update, job.work)
        kept = int(culling.kept.sum())
        if not kept:
            raise NothingThere(run)
        if kept <= config.block_limit or resolution == BLOCK_SIZE:
            return grid, culling
        coarser = max(int(COARSER * resolution * (config.block_limit / kept) ** 0.5), BLOCK_SIZE)
        notify(Notice(f"a grid of {resolution} voxels would keep {kept} macroblocks, {kept * BYTES / 1e9:.1f} GB on the graphics "
                      f"card: {coarser} voxels instead; for larger packs: --most-macroblocks {kept}"))  # fmt: skip
        resolution = coarser


def _find_box(job: Bake) -> Arrays:
    """low, high: of the box that is baked, grid frame."""
    run, config, frame = job.run, job.config, job.run.scene.worldspace_T_opengl
    if config.aabb is not None:
        found = box_in_grid_frame(_box_to_bake(run, config.aabb), frame)
    else:
        whole = box_in_grid_frame(run.dataset.aabb, frame)
        found = content_box(job.query, *whole, config.resolution_of(run), frame)
    if found is None:
        raise NothingThere(run)
    return {"low": found[0], "high": found[1]}


def supersampled(job: Bake, grid: BakeGrid, culling: Culling) -> Pack:
    """The kept macroblocks, 8 bits a value; their borders are still empty."""
    return assembled(job.run, grid, fill_atlas(content_of(job, grid, culling), culling.kept, BLOCK_SIZE))


def assembled(run: Run, grid: BakeGrid, atlas: tuple[np.ndarray, np.ndarray, np.ndarray | None]) -> Pack:
    """A pack of what fill_atlas gives of a run's grid, without metadata but for what rays must know."""
    camera = run.scene.splits["train"][0].camera
    head = None if atlas[2] is None else run.method.view_mlp(run.state)
    pack = Pack(
        voxel_size=grid.voxel_size, min_xyz=grid.min_xyz, grid_size=grid.size, block_size=BLOCK_SIZE,
        atlas_indices=atlas[0], atlas_rgba=atlas[1], atlas_features=atlas[2], view_mlp=head and from_params(head),
        worldspace_T_opengl=grid.worldspace_T_opengl, ndc=run.scene.ndc,
        input_width=camera.width, input_height=camera.height, input_focal=float(camera.fx),
    )  # fmt: skip
    return pack if grid.contraction is None else pack.with_metadata(contraction=grid.contraction)


def content_of(job: Bake, grid: BakeGrid, culling: Culling) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """The kept macroblocks' voxels, as baker.baking.supersample.supersample gives them, with a progress line."""
    count = int(culling.kept.sum())
    with job.stages("supersampling", count) as bar:
        yield from supersample(job.sampler(grid, culling), lambda share: bar.update(count * share), job.work)


def _box_to_bake(run: Run, box: Box) -> np.ndarray:
    """What of a box [2, 3] was trained, and is not contracted. UserError where that is nothing, or a scene has no box."""
    asked, trained = with_box(run.scene, box).aabb, np.asarray(run.dataset.aabb, np.float64)
    if run.dataset.facts.contraction is not None:
        trained = np.array([[-1.0], [1.0]]) * run.dataset.facts.contraction * np.ones(3)
    both = np.stack([np.maximum(asked[0], trained[0]), np.minimum(asked[1], trained[1])])
    if not (both[0] < both[1]).all():
        raise UserError("nothing was trained in this box", where=AABB, expected=f"a part of {box_text(trained)}",
                        found=box_text(asked))  # fmt: skip
    return both


class NothingThere(UserError):
    """A bake that can come to no pack, however often it is begun."""

    def __init__(self, run: Run) -> None:
        super().__init__("the trained field contains nothing that its cameras see", where=run.path,
                         remedy="train for more steps, then bake again")  # fmt: skip
