"""From a trained run to a pack (SNeRG section 5.4): box, culling, supersampling, quantisation, fine-tuning.

Works macroblock by macroblock: no array of N³ × channels is ever made.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from baker.culling import TAU_ALPHA, TAU_VIS, content_box, cull
from baker.field_query import field_query, occupied_query
from baker.fine_tune import EPOCHS, fine_tune
from baker.grid import box_in_grid_frame, make_grid
from baker.supersample import supersample
from console import UserError, progress
from scenepack.blocks import atlas_from_volume
from scenepack.pack import Pack, ViewMlp
from training.allocator import keep_freed_memory
from training.run import Run, require_bakeable

BLOCK_SIZE = 30  # data voxels; 32 with padding, aligned with the blocks of image codecs (section 5.5)


@dataclass(frozen=True)
class BakeConfig:
    """How to bake."""

    resolution: int = 512
    """Voxels along the longest side of the content's box."""
    tau_alpha: float = TAU_ALPHA
    """Macroblocks whose largest opacity is below this are dropped."""
    tau_vis: float = TAU_VIS
    """Macroblocks that no training camera sees with at least this transmittance are dropped."""
    fine_tune_epochs: int = EPOCHS
    """Passes over the training pixels that refine the view MLP; 0 for none."""
    seed: int = 0
    """Seed of the Gaussian samples within voxels and of fine-tuning."""


def bake(run: Run, config: BakeConfig) -> Pack:
    """Bakes the run's field. UserError where the field holds nothing that a training camera sees."""
    require_bakeable(run)
    if config.resolution < BLOCK_SIZE:
        raise UserError("too coarse", where="--resolution", expected=f"at least {BLOCK_SIZE}", found=config.resolution)
    keep_freed_memory()
    started = time.monotonic()
    query = field_query(run)
    frame = np.asarray(run.scene.worldspace_T_opengl, np.float64)
    with progress("baking", 1.0) as bar:
        bar.update(0.0, "looking for content")
        found = content_box(
            query, *box_in_grid_frame(run.dataset.aabb, frame), config.resolution, frame, config.tau_alpha
        )
        if found is None:
            raise _nothing_there(run)
        grid = make_grid(*found, config.resolution, BLOCK_SIZE, frame)
        culling = cull(
            query, grid, run.dataset, occupied=occupied_query(run), tau_alpha=config.tau_alpha, tau_vis=config.tau_vis,
            on_blocks=lambda share: bar.update(0.3 * share, "opacity"),
            on_rays=lambda share: bar.update(0.3 + 0.1 * share, "visibility"),
        )  # fmt: skip
        count = int(culling.kept.sum())
        if count == 0:
            raise _nothing_there(run)
        store = supersample(
            query, grid, culling, tau_alpha=config.tau_alpha, seed=config.seed,
            on_block=lambda n: bar.update(0.4 + 0.6 * n / count, f"macroblock {n} of {count}"),
        )  # fmt: skip
    indices, rgba, features = atlas_from_volume(store.read_box, grid.size, BLOCK_SIZE, culling.kept)
    head = run.method.view_mlp(run.state)
    view_mlp = head and ViewMlp(
        tuple(np.asarray(w, np.float32) for w in head.weights),  # type: ignore[arg-type]
        tuple(np.asarray(b, np.float32) for b in head.biases),  # type: ignore[arg-type]
    )
    camera = run.scene.splits["train"][0].camera
    pack = Pack(
        voxel_size=grid.voxel_size, min_xyz=grid.min_xyz, grid_size=grid.size, block_size=BLOCK_SIZE,
        atlas_indices=indices, atlas_rgba=rgba, atlas_features=features, view_mlp=view_mlp,
        worldspace_T_opengl=frame, ndc=run.scene.ndc,
        input_width=camera.width, input_height=camera.height, input_focal=float(camera.fx),
    )  # fmt: skip
    with progress("fine-tuning the view MLP", 1.0) as bar:
        pack, before, after = fine_tune(
            pack, run.dataset, epochs=config.fine_tune_epochs, seed=config.seed, on_share=bar.update
        )
    provenance = {
        "scene": str(run.scene.path), "run": str(run.path), "steps": run.step, "method": run.config.method,
        "downscale": run.downscale, "resolution": config.resolution, "seconds": round(time.monotonic() - started, 1),
        "macroblocks": {"with_opacity": culling.opaque, "hidden": culling.hidden, "kept": count},
    }  # fmt: skip
    if np.isfinite(after):
        provenance["fine_tuning"] = {
            "epochs": config.fine_tune_epochs,
            "train_psnr_before": round(float(before), 3), "train_psnr_after": round(float(after), 3),
        }  # fmt: skip
    return pack.with_metadata(provenance=provenance, cameras=cameras_of(run))


def cameras_of(run: Run) -> list[dict]:
    """The scene's cameras for the pack: pose (training frame), intrinsics in pixels, split and photograph name."""
    return [
        {
            "name": photograph.name, "split": split,
            "world_T_camera": np.asarray(photograph.camera.world_T_camera, float).tolist(),
            **{key: getattr(photograph.camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")},
            "distortion": list(photograph.camera.distortion),
        }
        for split, photographs in run.scene.splits.items()
        for photograph in photographs
    ]  # fmt: skip


def _nothing_there(run: Run) -> UserError:
    return UserError(
        "the trained field holds nothing that its cameras see",
        where=run.path,
        remedy="train for more steps, then bake again",
    )
