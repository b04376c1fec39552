"""One step of the fast method in JAX: draw rays, march, fetch, render, differentiate, Adam.

Published parts: direct voxel optimisation with total variation (Plenoxels, Fridovich-Keil et al. 2022), an optimiser that
leaves unseen voxels alone (DVGO, Sun et al. 2022), empty space skipped by an occupancy structure (instant-ngp, Müller et al.
2022). The Cauchy sparsity term is SNeRG's (section 4.3).

`update` is the step: `draw` and `loss_and_gradient`, with which another engine must agree (training.voxels.engine), and
`adam`. The parts of a gradient are made one after another by `gradient_parts`, so that training.profile_step can stop at
each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding

from training.dataset import RayDataset
from training.devices import WHOLE, split
from training.losses import psnr_of
from training.marching.layout import blend
from training.marching.march import MarchSizes, Samples, march
from training.marching.rays import GridRays, to_grid
from training.method import Rays, ViewMlpParams
from training.voxels.field import render_samples
from training.voxels.settings import ADAM_BETAS, Settings
from training.voxels.smoothness import distortion, neighbourhood, variation, windows
from training.voxels.sparse_grid import CHANNELS
from training.voxels.state import Optimised, Stage, Trainable, ray_ids


class Batch(NamedTuple):
    """All that is random about a step: N rays, their colours [N, 3] and the background [N, 3] that these were laid over, the
    phase [N] of their samples, in steps, and the rows int32 [P] of voxels whose variation is looked at.
    """

    rays: Rays
    target: jax.Array
    background: jax.Array
    phase: jax.Array
    picked: jax.Array


class Marched(NamedTuple):
    """The rays of a batch in grid coordinates, and their samples, empty space left out."""

    rays: GridRays
    samples: Samples


class Addresses(NamedTuple):
    """Rows int32 [S, 8] and trilinear weights [S, 8] around each sample; rows [P, 4] of voxels whose variation is looked at."""

    ids: jax.Array
    weights: jax.Array
    near: jax.Array


@lru_cache
def compiled_update(mesh: Mesh) -> Callable[..., Any]:
    """`update`, jitted for the devices of a mesh; the trainable values and their moments are given away."""
    return jax.jit(
        update, static_argnames=("sizes", "rays", "settings"), donate_argnums=0, out_shardings=NamedSharding(mesh, WHOLE)
    )  # fmt: skip


def update(
    optimised: Optimised, stage: Stage, dataset: RayDataset, key: jax.Array, step: jax.Array, progress: jax.Array,
    *, sizes: MarchSizes, rays: int, settings: Settings,
) -> tuple[Optimised, dict[str, jax.Array]]:  # fmt: skip
    """One step. progress in [0, 1], of the learning rates."""
    batch = draw(stage, dataset, key, step, rays, settings)
    gradient, loss, metrics = loss_and_gradient(
        optimised.trainable, stage, batch, dataset.mesh, sizes=sizes, settings=settings
    )
    metrics |= {"loss": loss, "psnr": psnr_of(metrics["mse"])}
    return adam(optimised, gradient, progress, settings), metrics


def loss_and_gradient(
    trainable: Trainable, stage: Stage, batch: Batch, mesh: Mesh, *, sizes: MarchSizes, settings: Settings
) -> tuple[Trainable, jax.Array, dict[str, jax.Array]]:
    """The gradient of a batch's loss, the loss, and its metrics; jittable."""
    *_, (_, made) = gradient_parts(trainable, stage, batch, mesh, sizes=sizes, settings=settings)
    return made


def gradient_parts(
    trainable: Trainable, stage: Stage, batch: Batch, mesh: Mesh, *, sizes: MarchSizes, settings: Settings
) -> Iterator[tuple[str, Any]]:
    """A batch's gradient part by part, in order: after each, its name and all that the next ones take.

    The last is ("backward", (gradient, loss, metrics)).
    """
    marched = marched_batch(batch, stage, sizes, settings, mesh)
    yield "march", (batch, marched)
    addresses = addressed(stage, marched.samples, batch.picked)
    yield "look up", (batch, marched, addresses)
    values, to_rows = jax.vjp(lambda rows: fetched(rows, addresses), trainable.rows)
    yield "gather", (batch, marched, values)

    def loss_of(
        values: tuple[jax.Array, jax.Array], head: ViewMlpParams | None
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        return losses(values, head, addresses, batch, marched, stage.layout.voxel, sizes, settings)

    loss, to_values, metrics = jax.vjp(loss_of, values, trainable.head, has_aux=True)
    yield "forward", (loss, metrics)
    of_values, of_head = to_values(jnp.ones_like(loss))
    (of_rows,) = to_rows(of_values)
    yield "backward", (Trainable(of_rows, of_head), loss, metrics)


def draw(stage: Stage, dataset: RayDataset, key: jax.Array, step: jax.Array, rays: int, settings: Settings) -> Batch:
    """Random training rays among those that meet content, and whatever else of a step is random."""
    ray_key, phase_key, voxel_key, colour_key = jax.random.split(jax.random.fold_in(key, step), 4)
    ids = ray_ids(stage.hits, jax.random.randint(ray_key, (rays,), 0, stage.hit_count))
    # Before a background of any colour, gaps in opaque photographs are mistakes, and so is mist around what is cut out: before
    # the scene's own colour, mist of that colour costs nothing, and is marched through from then on.
    background = jax.random.uniform(colour_key, (rays, 3))
    seen, colours = split((dataset.geometry_at(ids), dataset.colours_over(ids, background)), dataset.mesh)
    picked = windows(voxel_key, stage.cells.shape[0] - 1, settings.variation_share)
    return Batch(seen, colours, background, jax.random.uniform(phase_key, (rays,)), picked)


def marched_batch(batch: Batch, stage: Stage, sizes: MarchSizes, settings: Settings, mesh: Mesh) -> Marched:
    """The samples of a batch."""
    rays = to_grid(stage.layout, batch.rays)
    samples = march(stage.layout, rays, batch.phase, sizes, settings.step_voxels, settings.last_depth)
    return Marched(rays, split(samples, mesh))


def addressed(stage: Stage, samples: Samples, picked: jax.Array) -> Addresses:
    """Which voxels a step reads: around its samples, and around the picked ones, for their variation."""
    return Addresses(*stage.layout.corners(samples.g), neighbourhood(stage.layout, stage.cells, picked))


def fetched(rows: jax.Array, addresses: Addresses) -> tuple[jax.Array, jax.Array]:
    """Raw values [S, 8] at the samples, and those of the neighbourhoods [P, 4, 8]."""
    # One gather for samples and neighbourhoods: its transpose is one scatter into one dense gradient.
    values = rows[jnp.concatenate([addresses.ids.ravel(), addresses.near.ravel()])]
    at_samples, nearby = values[: addresses.ids.size].reshape(-1, 8, CHANNELS), values[addresses.ids.size :]
    return blend(at_samples, addresses.weights), nearby.reshape(-1, 4, CHANNELS)


def losses(
    values: tuple[jax.Array, jax.Array], head: ViewMlpParams | None, addresses: Addresses, batch: Batch, marched: Marched,
    voxel: jax.Array, sizes: MarchSizes, settings: Settings,
) -> tuple[jax.Array, dict[str, jax.Array]]:  # fmt: skip
    """The loss of a step and its metrics, from raw values at the samples and in the neighbourhoods. voxel [3]: world units."""
    (raw, nearby), count = values, batch.target.shape[0]
    rays, samples = marched
    counted = samples.complete & (samples.counts > 0)
    total = jnp.maximum(counted.sum(), 1)
    output, field, weights = render_samples(
        raw, head, samples, rays.length, batch.rays.viewdirs, sizes, settings, batch.background
    )
    error = jnp.square(output.rgb - batch.target).sum(-1)
    colour = jnp.where(counted, error, 0.0).sum() / total
    penalty = jnp.where(samples.valid, jnp.log1p(jnp.square(field.density) / settings.sparsity_scale), 0.0).sum()
    spacing = settings.step_voxels * voxel.max() / settings.sparsity_spacing
    sparsity = settings.sparsity_weight * spacing * penalty / total
    scattered = 0.0
    if settings.distortion_weight > 0:
        spread = settings.distortion_spread / voxel.max()
        scattered = distortion(samples, weights, settings.step_voxels, spread, count, sizes.per_ray) / total
    rough_density, rough_colour = variation(nearby, addresses.near)
    smooth = settings.variation[0] * rough_density + settings.variation[1] * rough_colour
    mse = jnp.where(counted, jnp.square(jnp.clip(output.rgb, 0, 1) - batch.target).sum(-1), 0.0).sum() / (3 * total)
    scattered *= settings.distortion_weight
    metrics = {"mse": mse, "sparsity": sparsity, "variation": smooth, "distortion": jnp.float32(scattered)}
    metrics |= {"rays": total, "samples": samples.valid.sum()}
    return colour + sparsity + smooth + scattered, metrics


def adam(optimised: Optimised, gradient: Trainable, progress: jax.Array, settings: Settings) -> Optimised:
    """Adam; voxels without a gradient are left alone, moments included (DVGO's masked Adam)."""
    trainable, first, second, updates = optimised
    beta1, beta2 = ADAM_BETAS
    decay = settings.final_rate_factor**progress
    density_rate, colour_rate, head_rate = (rate * decay for rate in settings.rates)
    row_rates = jnp.concatenate([density_rate[None], jnp.full(CHANNELS - 1, colour_rate)])
    count = (updates + 1).astype(jnp.float32)
    correction = jnp.sqrt(1 - beta2**count) / (1 - beta1**count)

    def move(value, slope, one, two, rate, masked):
        # multiplied, not selected: on a CPU this is a third faster, and most of a step's memory traffic is here
        seen = (slope[:, :1] != 0).astype(jnp.float32) if masked else 1.0
        new_one = one + (1 - beta1) * seen * (slope - one)
        new_two = two + (1 - beta2) * seen * (jnp.square(slope) - two)
        return value - rate * correction * seen * new_one * jax.lax.rsqrt(new_two + 1e-20), new_one, new_two

    slope_rows = gradient.rows.at[0].set(0.0)  # row 0 stands for absent voxels and never learns
    rows = move(trainable.rows, slope_rows, first.rows, second.rows, row_rates, True)
    heads: Any = (None, None, None)
    if trainable.head is not None:
        leaves, tree = jax.tree.flatten(trainable.head)
        others = (jax.tree.leaves(part.head) for part in (gradient, first, second))
        moved = [
            move(value, slope, one, two, head_rate, False)
            for value, slope, one, two in zip(leaves, *others, strict=True)
        ]
        heads = [jax.tree.unflatten(tree, [part[i] for part in moved]) for i in range(3)]
    trainable, first, second = (Trainable(array, head) for array, head in zip(rows, heads, strict=True))
    return Optimised(trainable, first, second, updates + 1)
