"""The loop around baker.tuning.joint_tune: which rays, how many at once, for how long, and which state is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from baker.tuning.joint_rows import cells_of_rows, rows_by_slot, voxel_rows, with_content
from baker.tuning.joint_tune import Scene, Sizes, Trained, gather, squared_error, stored, update
from baker.tuning.pack_layout import pack_layout, pack_rays, pack_sizes
from baker.view_mlp import from_params, to_params
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.marching.batches import rays_that_meet
from training.marching.march import occupied_segments
from training.marching.rays import to_grid

PROBE_RAYS = 4096  # rays whose sample counts set the list sizes
ROOM = 1.15  # of the lists over the mean
HELD_OUT_RAYS = 65_536


@dataclass(frozen=True)
class JointConfig:
    """How to fine-tune voxels and view MLP together."""

    passes: float = 1.0
    """Passes over the training rays that meet content."""
    samples: int = 393_216
    """Samples marched a step; rays are as many as fill them."""
    cell: int = 4
    """Voxels a side of the cells that move together."""
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
    checks: int = 8
    """How often the held-out views are looked at."""
    seed: int = 0


def joint_tune(
    pack: Pack, dataset: RayDataset, config: JointConfig, on_share: Callable[[float, str], None] | None = None
) -> tuple[Pack, dict[str, Any]]:
    """The pack with voxels and view MLP refined, and figures: PSNR on held-out rays and samples a ray, before and after."""
    rows = voxel_rows(pack)
    scene = Scene(
        pack_layout(pack),
        pack_rays(pack, dataset),
        jnp.asarray(rows_by_slot(pack, rows)),
        jnp.asarray(rows.content),
        jnp.asarray(cells_of_rows(pack, rows, config.cell)),
    )
    every = np.arange(dataset.count, dtype=np.int32)
    hits = every[rays_that_meet(scene.layout, scene.rays, every, pack_sizes(pack, config.samples).segments)]
    trained_on, held_out = split_by_view(hits, dataset, config.held_out, config.seed)
    trained = start(scene, pack)
    sizes = list_sizes(scene, trained, dataset, pack, trained_on, config.samples, config.seed)
    steps = max(int(config.passes * len(trained_on) / sizes.rays), 1)
    evaluate = partial(score, scene=scene, dataset=dataset, ids=held_out, sizes=sizes, ndc=pack.ndc)
    best = evaluate(trained)
    history, kept = [(0, *best)], jax.tree.map(np.asarray, trained)
    first, second = (jax.tree.map(jnp.zeros_like, trained) for _ in range(2))
    rng, order, at = np.random.default_rng(config.seed), trained_on[:0], 0
    colour = config.rate / 255
    rates = np.array([*[colour] * 3, config.density_rate, *[colour] * 4, config.head_rate], np.float32)
    check_every = max(steps // config.checks, 1)
    for step in range(steps):
        if at + sizes.rays > len(order):
            order, at = np.resize(rng.permutation(trained_on), max(len(trained_on), sizes.rays)), 0
        decay = config.final_rate_factor ** (step / steps)
        trained, first, second, _ = update(
            trained, first, second, scene, dataset, jnp.asarray(order[at : at + sizes.rays]), jnp.int32(step),
            rates * np.float32(decay), sizes, pack.ndc,
        )  # fmt: skip
        at += sizes.rays
        if (step + 1) % check_every == 0 or step + 1 == steps:
            now = evaluate(trained)
            history.append((step + 1, *now))
            if now[0] >= best[0] or not config.held_out:
                best, kept = now, jax.tree.map(np.asarray, trained)
        if on_share:
            on_share((step + 1) / steps, f"step {step + 1} of {steps}, held-out {history[-1][1]:.2f} dB")
    tuned = with_content(pack, rows, np.asarray(stored(jnp.asarray(kept.delta), scene)))
    if kept.head is not None:
        tuned = replace(tuned, view_mlp=from_params(kept.head))
    (_, first_psnr, first_samples), (last_psnr, last_samples) = history[0], best
    return tuned, {
        "passes": config.passes, "held_out_psnr_before": round(float(first_psnr), 3),
        "held_out_psnr_after": round(float(last_psnr), 3), "samples_a_ray_before": round(float(first_samples), 2),
        "samples_a_ray_after": round(float(last_samples), 2),
    }  # fmt: skip


def start(scene: Scene, pack: Pack) -> Trained:
    """Cells that change nothing, and the pack's view MLP."""
    return Trained(jnp.zeros((int(scene.cells.max()) + 1, 8)), pack.view_mlp and to_params(pack.view_mlp))


def split_by_view(ids: np.ndarray, dataset: RayDataset, one_in: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Ray ids to train on, and a random HELD_OUT_RAYS of the views held out (of all views where one_in is 0)."""
    view = np.searchsorted(np.asarray(dataset.first), ids, side="right") - 1
    away = view % one_in == one_in // 2 if one_in and dataset.views >= one_in else np.zeros(len(ids), bool)
    held_out = ids[away] if away.any() else ids
    return ids[~away], np.random.default_rng(seed).permutation(held_out)[:HELD_OUT_RAYS]


def list_sizes(
    scene: Scene, trained: Trained, dataset: RayDataset, pack: Pack, ids: np.ndarray, samples: int, seed: int
) -> Sizes:
    """Sizes of a step's lists: `samples` in all, and room for what a probe of rays shows."""
    probe = np.resize(np.random.default_rng(seed).permutation(ids)[:PROBE_RAYS], PROBE_RAYS)
    wide = pack_sizes(pack, 4 * samples)._replace(coarse=4 * samples)
    sizes = Sizes(PROBE_RAYS, wide, 2 * samples, wide.per_ray)
    coarse, supported, contributing, most = (
        int(n) for n in _probe(scene, stored(trained.delta, scene), dataset, jnp.asarray(probe), sizes)
    )
    share = supported / PROBE_RAYS
    rays = max(int(samples / ROOM / max(share, 1)) // 256 * 256, 256)
    room = int(ROOM * rays * contributing / PROBE_RAYS) + 4096
    marched = pack_sizes(pack, samples)._replace(coarse=int(ROOM * rays * coarse / PROBE_RAYS) + 4096)
    return Sizes(rays, marched, room, int(1.3 * most) + 8)


@partial(jax.jit, static_argnames="sizes")
def _probe(scene: Scene, voxels: jax.Array, dataset: RayDataset, ids: jax.Array, sizes: Sizes):
    """Samples with support, contributing ones, and the most contributing ones of a ray."""
    got = gather(scene, voxels, dataset, ids, sizes)
    rays = to_grid(scene.layout, scene.rays.geometry_at(ids))
    coarse = occupied_segments(scene.layout, rays, jnp.full(ids.shape[0], 0.5), sizes.march.segments, 1.0).sum()
    return coarse, got.supported, got.samples.valid.sum(), got.samples.counts.max()


def score(trained: Trained, *, scene: Scene, dataset: RayDataset, ids: np.ndarray, sizes: Sizes, ndc: bool):
    """(PSNR, contributing samples a ray) over the rays `ids`."""
    error = rays = samples = 0.0
    ids = np.resize(ids, -(-len(ids) // sizes.rays) * sizes.rays)  # whole batches: another size would be compiled anew
    for first in range(0, len(ids), sizes.rays):
        part = ids[first : first + sizes.rays]
        e, n, s = squared_error(trained, scene, dataset, jnp.asarray(part), sizes, ndc)
        error, rays, samples = error + float(e), rays + float(n), samples + float(s)
    return -10 * np.log10(max(error, 1e-12) / max(3 * rays, 1.0)), samples / max(rays, 1.0)
