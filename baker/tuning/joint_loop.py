"""The loop around baker.tuning.tuner.Tuner: which rays, how many at once, for how long, which state is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from baker.tuning.marcher import PackMarcher
from baker.tuning.shading import Accumulated, ErrorTerms, psnr_of, squared_error
from baker.tuning.tuner import Tuner
from baker.view_mlp import to_params
from scenepack.codecs.quantisation import EXACT, Steps
from scenepack.pack import Pack
from training.dataset import RayDataset

HELD_OUT_RAYS = 65_536
# Small cells are sharper where enough rays meet each; cells of one voxel learn the training views by heart.
RAYS_PER_CELL, NARROWEST, WIDEST = 6, 2, 4
MOST_CELLS = 1 << 27  # of a grid, empty ones included: a table of all of them is kept
LEAST_STEPS, FEWEST_SAMPLES = 200, 32_768
CHOOSING = 0.15  # of the time: which rays meet content


@dataclass(frozen=True)
class JointConfig:
    """How to fine-tune voxels and view MLP together."""

    passes: float = 1.3
    """Passes over the training rays that meet content."""
    most_steps: int = 1100
    """Fewer passes where they would take more steps than this: every ray of a room meets content."""
    samples: int = 393_216
    """Samples marched a step; rays are as many as fill them."""
    cell: int | None = None
    """Voxels a side of the cells that move together. None: NARROWEST to WIDEST, such that RAYS_PER_CELL rays meet a cell."""
    rate: float = 2.0
    """Adam's learning rate of straight colours and features at the start, in units of 1/255."""
    density_rate: float = 0.03
    """Adam's learning rate of a cell's log density at the start."""
    head_rate: float = 1e-3
    """Adam's learning rate of the view MLP at the start."""
    final_rate_factor: float = 0.05
    """The rates fall log-linearly to this share."""
    held_out: int = 10
    """One training view in so many tells which state is best, and is not trained on; 0 trains on all, to the end."""
    steps: Steps = EXACT
    """What is stored in multiples of."""
    most_lost: float = np.inf
    """dB of held-out views that steps may cost before they are tuned in; else they are EXACT."""
    checks: int = 8
    """How often the held-out views are looked at."""
    seed: int = 0


def joint_tune(
    pack: Pack, dataset: RayDataset, config: JointConfig, on_share: Callable[[float, str], None] | None = None,
    by_opacity: bool = False,
) -> tuple[Pack, dict[str, Any], Steps]:  # fmt: skip
    """The pack with voxels and view MLP refined; figures, of held-out rays before and after; and what it is stored in. The arrays
    of `pack` are changed. The state is kept in which held-out views look best.

    by_opacity: see baker.tuning.shading.ErrorTerms. If no training ray meets the pack, it is returned unchanged, without figures.
    """
    report = on_share or (lambda share, text: None)
    every = np.arange(dataset.count, dtype=np.int32)
    meets = PackMarcher(pack, dataset).meets(every, on_share=lambda share: report(CHOOSING * share, "choosing rays"))
    hits = every[meets]
    trained_on, held_out = split_by_view(hits, dataset, config.held_out, config.seed)
    if not len(trained_on):
        return pack, {}, EXACT
    tuner = Tuner(pack, dataset, config.cell or cell_for(pack, len(hits)), by_opacity=by_opacity)
    tuner.fill(trained_on, config.samples, config.seed)
    steps = config.passes * len(trained_on) / tuner.rays
    if steps < LEAST_STEPS:  # of few rays there are more steps, each with fewer
        tuner.fill(trained_on, max(int(config.samples * steps / LEAST_STEPS), FEWEST_SAMPLES), config.seed)
        steps = config.passes * len(trained_on) / tuner.rays
    steps = min(max(int(steps), 1), config.most_steps)
    report(CHOOSING, "compiling")
    before = best = now = tuner.score(held_out)
    stored_in = config.steps
    if stored_in != EXACT:
        tuner.round_to(stored_in)
        best = now = tuner.score(held_out)
        if before[0] - now[0] > config.most_lost:
            stored_in = EXACT
            tuner.round_to(EXACT)
            best = now = before
    figures = {"lost_to_steps": round(before[0] - now[0], 3)} if stored_in != EXACT else {}
    kept, done = tuner.snapshot(), 0
    rng, order, at = np.random.default_rng((config.seed, 1)), trained_on[:0], 0  # not the draw of the rays to score
    colour = config.rate / 255
    rates = np.array([*[colour] * 3, config.density_rate, *[colour] * 4, config.head_rate], np.float32)
    check_every = max(steps // config.checks, 1)
    for step in range(steps):
        if at + tuner.rays > len(order):
            order, at = np.resize(rng.permutation(trained_on), max(len(trained_on), tuner.rays)), 0
        decay = config.final_rate_factor ** (step / steps)
        tuner.update(order[at : at + tuner.rays], rates * np.float32(decay), step)
        at, done = at + tuner.rays, step + 1
        if done % check_every == 0 or done == steps:
            now = tuner.score(held_out)
            if now[0] >= best[0] or not config.held_out:
                best, kept = now, tuner.snapshot()
        report(
            CHOOSING + (1 - CHOOSING) * done / steps,
            f"step {done} of {steps}, {'held-out ' if config.held_out else ''}{now[0]:.2f} dB",
        )
    return tuner.tuned(kept), {
        "passes": round(done * tuner.rays / len(trained_on), 2), **figures,
        "held_out_psnr_before": round(before[0], 3), "held_out_psnr_after": round(best[0], 3),
        "samples_a_ray_before": round(before[1], 2), "samples_a_ray_after": round(best[1], 2),
    }, stored_in  # fmt: skip


def shown_psnr(pack: Pack, dataset: RayDataset, seed: int, *, by_opacity: bool = False) -> float:
    """PSNR (dB) of what the viewer shows of the pack, over a random HELD_OUT_RAYS of the training rays."""
    ids = np.sort(np.random.default_rng(seed).permutation(dataset.count)[:HELD_OUT_RAYS]).astype(np.int32)
    marched = PackMarcher(pack, dataset).accumulate(ids)
    head, rays = pack.view_mlp and to_params(pack.view_mlp), jnp.asarray(ids)
    error, weight = squared_error(
        Accumulated(*(jnp.asarray(part) for part in marched)), head, dataset.geometry_at(rays).viewdirs,
        dataset.colours_at(rays), jnp.ones(len(ids), bool), dataset.background, ErrorTerms(pack.ndc, by_opacity), clamped=True,
    )  # fmt: skip
    return psnr_of(float(error), float(weight))


def cell_for(pack: Pack, rays: int) -> int:
    """Voxels a side of the cells that suit a pack which so many training rays meet: surfaces have a cell for cell² voxels."""
    voxels = int(np.count_nonzero(pack.atlas_rgba[..., 3]))
    cell = min(round(float(np.sqrt(RAYS_PER_CELL * voxels / max(rays, 1)))), WIDEST)
    return max(cell, NARROWEST, int(np.ceil((np.prod(pack.grid_size, dtype=float) / MOST_CELLS) ** (1 / 3))))


def split_by_view(ids: np.ndarray, dataset: RayDataset, one_in: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Ray ids to train on, and a random HELD_OUT_RAYS of the views held out (of all views where one_in is 0)."""
    view = np.searchsorted(np.asarray(dataset.first), ids, side="right") - 1
    away = view % one_in == one_in // 2 if one_in and dataset.views >= one_in else np.zeros(len(ids), bool)
    held_out = ids[away] if away.any() else ids
    return ids[~away], np.random.default_rng(seed).permutation(held_out)[:HELD_OUT_RAYS]
