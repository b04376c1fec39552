"""Fine-tuning of the stored voxels and the view MLP together, on exactly what the viewer shows (beyond SNeRG section 5.6).

The paper trains the view MLP on against the grid as quantising left it. Here the grid moves, too: every step takes the
viewer's own samples (baker.pack_layout) of some training rays from the voxels *as rounded to 8 bits*, and its gradient
moves the unrounded ones behind them (a straight-through estimator). What is optimised is what is shown.

Notation: R rays; S samples with support; C of them contribute, which is all that a gradient needs; latent float32
[V + 1, 8] voxels of baker.joint_rows before rounding, in units of 1/255.

    loss = mean over rays of |shown - photograph|²  +  sparsity · sum of alpha over contributing samples / R

The second term sheds fog: voxels too faint to show, of which each costs every ray that meets it a sample.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from baker.culling import in_grid_frame
from baker.pack_layout import Accumulated, PackLayout, composite
from scenepack.constants import ALPHA_CONTRIBUTES, TRANSMITTANCE_SHADED, TRANSMITTANCE_STOP, UNPREMULTIPLY_GAIN
from training.dataset import RayDataset
from training.method import ViewMlpParams
from training.view_mlp import apply_view_mlp
from training.voxels.march import MarchSizes, Samples, march, to_grid, transmittance
from training.voxels.sparse_grid import blend

BETAS = (0.9, 0.99)


class Sizes(NamedTuple):
    """Static sizes of a step: rays, lists of samples, contributing samples, and most of these a ray."""

    rays: int
    march: MarchSizes
    contributing: int
    per_ray: int


class Trained(NamedTuple):
    """latent [V + 1, 8]; head: the view MLP, None for a diffuse pack."""

    latent: jax.Array
    head: ViewMlpParams | None


class Scene(NamedTuple):
    """What stays: the layout, rows int32 [slots B³] of baker.joint_rows, training frame to grid frame."""

    layout: PackLayout
    rows: jax.Array
    grid_T_training: jax.Array


class Gathered(NamedTuple):
    """Contributing samples of R rays: samples (C), corner rows int32 [C, 8] and weights [C, 8], and their rays.

    whole bool [R]: rays of which nothing is missing. supported: samples with support.
    """

    samples: Samples
    ids: jax.Array
    weights: jax.Array
    viewdirs: jax.Array
    target: jax.Array
    whole: jax.Array
    supported: jax.Array


def gather(scene: Scene, stored: jax.Array, dataset: RayDataset, ids: jax.Array, sizes: Sizes) -> Gathered:
    """The samples of rays `ids` that contribute, given stored uint8 [V + 1, 8]. Nothing here is differentiated."""
    rays, target = dataset.rays_at(ids)
    rays = rays._replace(near=jnp.zeros_like(rays.near), far=jnp.full_like(rays.far, jnp.inf))
    marched = march(
        scene.layout, to_grid(scene.layout, in_grid_frame(rays, scene.grid_T_training)),
        jnp.full(sizes.rays, 0.5), sizes.march, 1.0,
    )  # fmt: skip
    corners, weights = scene.layout.corners(marched.g)
    rows = scene.rows[corners]
    alpha = jnp.einsum("nk,nk->n", weights, stored[rows, 3].astype(jnp.float32)) * (1 / 255)
    alpha = jnp.where(marched.valid & (alpha > ALPHA_CONTRIBUTES), alpha, 0.0)
    tau = -jnp.log1p(-jnp.minimum(alpha, 1 - 1e-6))
    before, _ = transmittance(marched, tau, sizes.rays, sizes.march.per_ray)
    taken = (alpha > 0) & (before > TRANSMITTANCE_STOP)
    (chosen,) = jnp.nonzero(taken, size=sizes.contributing, fill_value=taken.size)
    valid = chosen < taken.size
    chosen = jnp.minimum(chosen, taken.size - 1)
    ray = marched.ray[chosen]
    counts = jnp.zeros(sizes.rays, jnp.int32).at[marched.ray].add(taken.astype(jnp.int32))
    first = jnp.cumsum(counts) - counts
    whole = marched.complete & (first + counts <= sizes.contributing) & (counts <= sizes.per_ray)
    valid = valid & whole[ray]
    samples = Samples(
        ray, jnp.arange(sizes.contributing) - first[ray], marched.g[chosen], marched.t[chosen], valid, whole, counts
    )
    return Gathered(samples, rows[chosen], weights[chosen], rays.viewdirs, target, whole, marched.counts.sum())


def shown(
    sums: Accumulated, head: ViewMlpParams | None, viewdirs: jax.Array, background: tuple[float, ...], ndc: bool
) -> jax.Array:
    """[R, 3] what the viewer makes of accumulated rays (CONTRACT section 2), above 1 not yet clamped."""
    colour, features, behind = sums
    if ndc:  # forward-facing: partially un-premultiplied (appendix C.3)
        alpha = 1.0 - behind
        gain = jnp.minimum(1.0, UNPREMULTIPLY_GAIN * alpha) / jnp.maximum(alpha, 1e-6)
        colour, features, behind = colour * gain[:, None], features * gain[:, None], 1.0 - alpha * gain
    diffuse = colour + behind[:, None] * jnp.asarray(background)
    if head is None:
        return diffuse
    residual = apply_view_mlp(head, diffuse, features, viewdirs)
    return diffuse + residual * (behind <= TRANSMITTANCE_SHADED)[:, None]


def rounded(latent: jax.Array) -> jax.Array:
    """uint8 [V + 1, 8]: what is stored."""
    return jnp.round(latent).astype(jnp.uint8)


@partial(jax.jit, static_argnames=("sizes", "ndc"))
def squared_error(
    trained: Trained, scene: Scene, dataset: RayDataset, ids: jax.Array, sizes: Sizes, ndc: bool
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Sum of squared errors of the clamped picture over whole rays among `ids`, their number, and their samples."""
    stored = rounded(trained.latent)
    got = gather(scene, stored, dataset, ids, sizes)
    values = blend(stored[got.ids].astype(jnp.float32) * (1 / 255), got.weights)
    sums = composite(got.samples, values, sizes.rays, sizes.per_ray)
    rgb = shown(sums, trained.head, got.viewdirs, dataset.background, ndc)
    error = jnp.square(jnp.clip(rgb, 0, 1) - got.target).sum(-1)
    return jnp.where(got.whole, error, 0.0).sum(), got.whole.sum(), got.samples.valid.sum()


@partial(jax.jit, static_argnames=("sizes", "ndc"), donate_argnums=(0, 1, 2))
def update(
    trained: Trained, first: Trained, second: Trained, scene: Scene, dataset: RayDataset, ids: jax.Array,
    count: jax.Array, rates: jax.Array, sparsity: jax.Array, sizes: Sizes, ndc: bool,
) -> tuple[Trained, Trained, Trained, dict[str, jax.Array]]:  # fmt: skip
    """One step of Adam on the rays `ids`. rates [2]: of voxels (1/255) and of the view MLP. count: steps so far."""
    stored = rounded(trained.latent)
    got = gather(scene, stored, dataset, ids, sizes)
    values = blend(stored[got.ids].astype(jnp.float32) * (1 / 255), got.weights)
    total = jnp.maximum(got.whole.sum(), 1)

    def loss_of(values: jax.Array, head: ViewMlpParams | None) -> tuple[jax.Array, jax.Array]:
        sums = composite(got.samples, values, sizes.rays, sizes.per_ray)
        rgb = shown(sums, head, got.viewdirs, dataset.background, ndc)
        error = jnp.where(got.whole, jnp.square(jnp.minimum(rgb, 1.0) - got.target).sum(-1), 0.0).sum() / total
        fog = jnp.where(got.samples.valid, values[:, 3], 0.0).sum() / total
        return error + sparsity * fog, error

    (_, error), (slope, head_slope) = jax.value_and_grad(loss_of, argnums=(0, 1), has_aux=True)(values, trained.head)
    gradient = jnp.zeros_like(trained.latent).at[got.ids].add(got.weights[..., None] * slope[:, None])
    gradient = gradient.at[0].set(0.0)
    trained, first, second = _adam(trained, Trained(gradient, head_slope), first, second, count, rates)
    figures = {"mse": error / 3, "rays": got.whole.sum(), "samples": got.samples.valid.sum()}
    return trained, first, second, figures


def _adam(
    trained: Trained, slope: Trained, first: Trained, second: Trained, count: jax.Array, rates: jax.Array
) -> tuple[Trained, Trained, Trained]:
    """Adam; voxels that no ray of this step met are left alone, moments included. Voxels stay premultiplied bytes."""
    one, two = BETAS
    steps = count.astype(jnp.float32) + 1.0
    correction = jnp.sqrt(1 - two**steps) / (1 - one**steps)

    def move(value, slope, m, v, rate):
        m, v = one * m + (1 - one) * slope, two * v + (1 - two) * jnp.square(slope)
        return value - rate * correction * m / (jnp.sqrt(v) + 1e-12), m, v

    met = jnp.any(slope.latent != 0, axis=1, keepdims=True)
    value, m, v = move(trained.latent, slope.latent, first.latent, second.latent, rates[0])
    alpha = jnp.clip(value[:, 3:4], 0.0, 255.0)
    value = jnp.clip(value, 0.0, alpha)
    latent, m, v = (
        jnp.where(met, new, old) for new, old in ((value, trained.latent), (m, first.latent), (v, second.latent))
    )
    if trained.head is None:
        return Trained(latent, None), Trained(m, None), Trained(v, None)
    leaves, tree = jax.tree.flatten(trained.head)
    others = (jax.tree.leaves(part.head) for part in (slope, first, second))
    moved = [move(a, g, m, v, rates[1]) for a, g, m, v in zip(leaves, *others, strict=True)]
    heads = [jax.tree.unflatten(tree, [part[i] for part in moved]) for i in range(3)]
    return Trained(latent, heads[0]), Trained(m, heads[1]), Trained(v, heads[2])
