"""From a trained run to a pack (SNeRG section 5.4): box, culling, supersampling, quantisation, pruning, fine-tuning.

Works macroblock by macroblock, and keeps on disk what is done: no array of N³ × channels is ever made, and a bake that
was killed goes on where it was (baker.baking.work_folder).
"""

from __future__ import annotations

import time
import warnings
import zlib
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

from baker.baking.config import BLOCK_SIZE, BakeConfig
from baker.baking.culling import Culling, content_box, cull
from baker.baking.field_query import FieldQuery, field_query, occupied_query, within
from baker.baking.float_grid import FloatGrid, assemble
from baker.baking.grid import BakeGrid, box_in_grid_frame, make_grid
from baker.baking.stages import STAGE, Stages
from baker.baking.supersample import Sampler, supersample, supersample_floats
from baker.baking.tuned_voxels import pruned, thinned, with_tuned_voxels
from baker.baking.work_folder import Arrays, BakeEnded, WorkFolder, once
from baker.tuning.fine_tune import fine_tune
from baker.tuning.pruning import Pruned
from baker.view_mlp import from_params
from console import Notice, UserError, progress
from console.progress import Progress
from scenepack.blocks import fill_atlas
from scenepack.pack import Pack
from scenepack.padding import restore_padding
from training.memory import keep_freed_memory
from training.method import ViewMlpParams
from training.run import Run, require_bakeable
from training.scenes.scene import Box, cameras_of
from training.scenes.scene_options import AABB, box_text, with_box

BYTES = 32**3 * 8  # of a macroblock, with padding: colour, opacity, features
COARSER = 0.95  # than a surface's share of the macroblocks asks for, since haze is thicker than a surface
FORMAT = 2  # of a work folder: raised whenever the same key would give other pieces


def work_key(run: Run, config: BakeConfig) -> dict[str, Any]:
    """What the voxels of a bake depend on, for its work folder: the run as it is now, and the options before fine-tuning."""
    crc = 0
    for name, array in sorted(run.method.save(run.state).items()):
        crc = zlib.crc32(np.ascontiguousarray(array).data, zlib.crc32(name.encode(), crc))
    return {
        "format": FORMAT, "run": str(run.path.resolve()), "step": run.step, "state": f"{crc:08x}",
        "scene": str(run.scene.path), "downscale": run.downscale, "block_size": BLOCK_SIZE, "seed": config.seed,
        "resolution": config.resolution, "tau_alpha": config.tau_alpha, "tau_vis": config.tau_vis,
        "most_macroblocks": config.most_macroblocks, "aabb": config.aabb, "supersampling": config.supersampling,
    }  # fmt: skip


def bake(
    run: Run, config: BakeConfig, work: WorkFolder | None = None, stages: Stages | None = None, *, last: bool = False
) -> Pack:
    """Bakes the run's field. UserError where the field holds nothing that a training camera sees.

    work: where a broken-off bake with the same work_key goes on, and where other processes help (its share); the caller
    removes it when the pack is saved. last: nobody needs the run's state after this; it is given up once the voxels are made,
    which leaves a gigabyte to what follows.
    """
    check_bake(run, config)
    stages = stages or Stages()
    grid, culling = _culled(run, config, work, stages)
    with stages("supersampling"):
        atlas = fill_atlas(_content(run, config, work, grid, culling), culling.kept, BLOCK_SIZE)
    head = run.method.view_mlp(run.state)
    photographs = run.dataset.in_average_look(run.method.gains(run.state))  # as the field shows them
    if last:
        run.state = None
    pack = assembled(run, grid, atlas, head)
    with stages("padding"), progress("filling the borders of macroblocks", len(atlas) - 1, stage=STAGE) as bar:
        for part in atlas[1:]:
            restore_padding(part, atlas[0], BLOCK_SIZE)
            bar.advance()
    del atlas, part  # what pruning leaves takes their place
    counts, removed = culling.counts(), None
    by_opacity = config.aabb is not None  # photographs also show what lies outside of the box that is baked
    if config.tau_weight > 0:
        with stages("pruning"), progress("emptying faint voxels", 1.0, stage=STAGE) as bar:
            pack, removed = pruned(pack, photographs, config, by_opacity, bar)
            bar.update(1.0)
    tuned: dict[str, Any] = {}
    if config.fine_tune != "none":
        with stages("view MLP"), progress("fine-tuning the view MLP", 1.0, stage=STAGE) as bar:
            pack, before, after = fine_tune(
                pack, photographs, epochs=config.fine_tune_epochs, most_pixels=config.fine_tune_pixels, seed=config.seed,
                on_share=bar.update, by_opacity=by_opacity,
            )  # fmt: skip
        if np.isfinite(after):
            tuned = {
                "epochs": config.fine_tune_epochs,
                "train_psnr_before": round(float(before), 3), "train_psnr_after": round(float(after), 3),
            }  # fmt: skip
    if config.fine_tune in ("auto", "all", "compact"):
        handed_over = [pack]
        del pack  # nobody else holds it, so that what pruning leaves takes its place
        pack, figures, again = with_tuned_voxels(handed_over.pop(), photographs, config, stages, by_opacity)
        tuned |= figures
        if removed and again:
            removed = removed.then(again)
    thin: Pruned | None = None
    if config.thin > 0:
        with stages("thinning"), progress("thinning", 1.0, stage=STAGE) as bar:
            compact = tuned.get("of") == "compact"
            pack, thin = thinned(pack, photographs, config, by_opacity, compact, bar)
            bar.update(1.0)
        if thin:
            removed = removed.then(thin) if removed else thin
    if removed:
        counts |= {"below_tau_weight": removed.macroblocks, "kept": counts["kept"] - removed.macroblocks}
    provenance: dict[str, Any] = {  # no times here: a resumed bake must give the same bytes
        "scene": str(run.scene.path), "run": str(run.path), "steps": run.step, "method": run.config.method,
        **vars(run.options), "aabb": config.aabb or run.options.aabb, "resolution": grid.resolution,
        "tau_weight": config.tau_weight, "supersampling": config.supersampling, "macroblocks": counts,
    }  # fmt: skip
    if removed:
        provenance["voxels"] = {
            "before": removed.voxels_before, "after": removed.voxels_after, "tau_weight": removed.tau_weight,
        }  # fmt: skip
    if thin:
        provenance["thin"] = {
            "most_lost": config.thin, "tau_weight": thin.tau_weight, "before": thin.voxels_before, "after": thin.voxels_after,
        }  # fmt: skip
    if tuned:
        provenance["fine_tuning"] = {"of": config.fine_tune, **tuned}  # of auto, tuning tells what it came to
    return pack.with_metadata(provenance=provenance, cameras=cameras_of(run.scene), near=float(run.scene.near))


def assembled(
    run: Run, grid: BakeGrid, atlas: tuple[np.ndarray, np.ndarray, np.ndarray], head: ViewMlpParams | None
) -> Pack:
    """A pack of what fill_atlas gives of a run's grid, without metadata but for what rays must know."""
    camera = run.scene.splits["train"][0].camera
    pack = Pack(
        voxel_size=grid.voxel_size, min_xyz=grid.min_xyz, grid_size=grid.size, block_size=BLOCK_SIZE,
        atlas_indices=atlas[0], atlas_rgba=atlas[1], atlas_features=atlas[2], view_mlp=head and from_params(head),
        worldspace_T_opengl=grid.worldspace_T_opengl, ndc=run.scene.ndc,
        input_width=camera.width, input_height=camera.height, input_focal=float(camera.fx),
    )  # fmt: skip
    return pack if grid.contraction is None else pack.with_metadata(contraction=grid.contraction)


def bake_floats(run: Run, config: BakeConfig) -> FloatGrid:
    """What `bake` quantises, as it is: neither pruned nor fine-tuned, and not kept on disk. UserError as there."""
    check_bake(run, config)
    grid, culling = _culled(run, config, None, Stages())
    grain = run.method.grain(run.state)
    sampler = Sampler.of(_query(run, config), grid, culling, grain, config.supersampling, config.seed)
    count = int(culling.kept.sum())
    with progress("supersampling, in floats", count, stage=STAGE) as bar:
        return assemble(supersample_floats(sampler, _Rate(bar, count)), culling.kept, grid)


def help_bake(run: Run, config: BakeConfig, work: WorkFolder) -> None:
    """Makes pieces of a bake that another process ends, until none is missing: density and content of macroblocks.

    What comes after (pruning, fine-tuning) is not shared.
    """
    check_bake(run, config)
    with suppress(BakeEnded):
        grid, culling = _culled(run, config, work, Stages())
        next(_content(run, config, work, grid, culling), None)  # the first is there once none is missing


def check_bake(run: Run, config: BakeConfig) -> None:
    """UserError where this run cannot be baked so; before anything is written."""
    require_bakeable(run)
    config.check()
    if config.aabb is not None:
        _box_to_bake(run, config.aabb)
    keep_freed_memory()


def _culled(run: Run, config: BakeConfig, work: WorkFolder | None, stages: Stages) -> tuple[BakeGrid, Culling]:
    """The grid, as fine as config.most_macroblocks allows, and which of its macroblocks are kept."""
    query = _query(run, config)
    frame = np.asarray(run.scene.worldspace_T_opengl, np.float64)

    def find_box() -> Arrays:
        if config.aabb is not None:
            low, high = box_in_grid_frame(_box_to_bake(run, config.aabb), frame)
            return {"low": low, "high": high}
        found = content_box(
            query, *box_in_grid_frame(run.dataset.aabb, frame), config.resolution, frame, config.tau_alpha
        )
        if found is None:
            raise _nothing_there(run)
        return {"low": found[0], "high": found[1]}

    with stages("box"), progress("looking for content", 1.0, stage=STAGE) as bar:
        box = once(work, "box", find_box)
        bar.update(1.0)
    contraction = run.dataset.facts.contraction if config.aabb is None else None
    grid = make_grid(box["low"], box["high"], config.resolution, BLOCK_SIZE, frame, contraction)
    while True:
        with progress("culling", 1.0, stage=STAGE) as bar:
            culling = cull(
                query, grid, run.dataset, occupied=occupied_query(run), tau_alpha=config.tau_alpha,
                tau_vis=config.tau_vis, on_blocks=lambda share, bar=bar: bar.update(0.75 * share, "opacity"),
                on_rays=lambda share, bar=bar: bar.update(0.75 + 0.25 * share, "visibility"), work=work, stages=stages,
            )  # fmt: skip
        kept = int(culling.kept.sum())
        if not kept:
            raise _nothing_there(run)
        if kept <= config.most_macroblocks or grid.resolution == BLOCK_SIZE:
            return grid, culling
        coarser = max(int(COARSER * grid.resolution * (config.most_macroblocks / kept) ** 0.5), BLOCK_SIZE)
        warnings.warn(
            Notice(f"a grid of {grid.resolution} voxels would keep {kept} macroblocks, {kept * BYTES / 1e9:.1f} GB on the "
                   f"graphics card: {coarser} voxels instead; for larger packs: --most-macroblocks {kept}"),
            stacklevel=2,
        )  # fmt: skip
        grid = make_grid(box["low"], box["high"], coarser, BLOCK_SIZE, frame, contraction)


def _query(run: Run, config: BakeConfig) -> FieldQuery:
    """The field; empty outside of the box that is baked, where there is one: grids are whole macroblocks and reach further."""
    query = field_query(run)
    return query if config.aabb is None else within(query, _box_to_bake(run, config.aabb))


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


def _content(
    run: Run, config: BakeConfig, work: WorkFolder | None, grid: BakeGrid, culling: Culling
) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """The kept macroblocks' voxels, as baker.baking.supersample.supersample gives them, with a progress line."""
    count = int(culling.kept.sum())
    with progress("supersampling", count, stage=STAGE) as bar:
        yield from supersample(
            _query(run, config), grid, culling,
            grain=run.method.grain(run.state), how=config.supersampling, seed=config.seed,
            on_blocks=_Rate(bar, count), work=work,
        )  # fmt: skip


class _Rate:
    """Tells a bar how many macroblocks are done, and how many samples a second were taken since it was made.

    What is there before any sample was taken was made by an earlier bake that this one goes on with.
    """

    def __init__(self, bar: Progress, count: int) -> None:
        self.bar, self.count, self.samples, self.started = bar, count, 0, time.monotonic()

    def __call__(self, blocks: int, samples: int) -> None:
        if self.samples == samples == 0 and blocks < self.count:
            self.bar.resume_at(blocks)
        self.samples += samples
        rate = self.samples / max(time.monotonic() - self.started, 1e-3) / 1e6
        self.bar.update(blocks, f"macroblock {blocks} of {self.count}, {rate:.1f} M samples/s")


class NothingThere(UserError):
    """A bake that can come to no pack, however often it is begun."""


def _nothing_there(run: Run) -> UserError:
    return NothingThere(
        "the trained field contains nothing that its cameras see",
        where=run.path,
        remedy="train for more steps, then bake again",
    )
