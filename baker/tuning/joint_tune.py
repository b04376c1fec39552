"""Fine-tuning of the stored voxels and the view MLP together, on exactly what the viewer shows (beyond SNeRG section 5.6).

The paper trains the view MLP on against the grid as quantising left it. Here the grid moves, too: every step takes the
viewer's own samples (baker.tuning.pack_layout) of some training rays from the voxels *as rounded to 8 bits*, and its gradient
moves what is behind them (a straight-through estimator). What is optimised is what is shown.

A voxel of a fine grid is met by a handful of rays, and learns their noise by heart. So the voxels of a cell of a few
voxels a side move together: each cell adds to the straight colours and features of its voxels, and scales their density.
For the same reason Adam's denominator has a floor, the mean over all cells: what has hardly any gradient hardly moves.

Notation: R rays; S samples with support; C of them contribute, which is all that a gradient needs; V voxels with alpha,
K cells, row 0 of either stands for what is empty; delta float32 [K + 1, 8]: of rgb, log density, and features.

    loss = mean over rays of |shown - photograph|²
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from baker.tuning.marcher import Accumulated
from baker.tuning.pack_layout import MAX_ALPHA, PackLayout, composite, over_background
from scenepack.constants import ALPHA_CONTRIBUTES, TRANSMITTANCE_SHADED, TRANSMITTANCE_STOP
from training.dataset import RayDataset
from training.marching.layout import blend
from training.marching.march import MarchSizes, Samples, march, transmittance
from training.marching.rays import GridFrameRays, to_grid
from training.method import ViewMlpParams
from training.view_mlp import apply_view_mlp

BETAS = (0.9, 0.99)
TOP = 254.75  # stands for an alpha of 255, whose optical depth would be infinite


class Sizes(NamedTuple):
    """Static sizes of a step: rays, lists of samples, contributing samples, and most of these a ray."""

    rays: int
    march: MarchSizes
    contributing: int
    per_ray: int


class Trained(NamedTuple):
    """delta [K + 1, 8]; head: the view MLP, None for a diffuse pack."""

    delta: jax.Array
    head: ViewMlpParams | None


class Scene(NamedTuple):
    """What stays: the layout, the training rays in its frame, rows int32 [slots B³] of baker.tuning.joint_rows.

    content uint8 [V + 1, 8]: the voxels as they were; cells int32 [V + 1]: the cell of each.
    """

    layout: PackLayout
    rays: GridFrameRays
    rows: jax.Array
    content: jax.Array
    cells: jax.Array


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


def gather(scene: Scene, voxels: jax.Array, dataset: RayDataset, ids: jax.Array, sizes: Sizes) -> Gathered:
    """The samples of rays `ids` that contribute, given voxels uint8 [V + 1, 8]. Nothing here is differentiated."""
    rays, target = scene.rays.geometry_at(ids), dataset.colours_at(ids)
    marched = march(scene.layout, to_grid(scene.layout, rays), jnp.full(sizes.rays, 0.5), sizes.march, 1.0)
    corners, weights = scene.layout.corners(marched.g)
    rows = scene.rows[corners]
    alpha = jnp.einsum("nk,nk->n", weights, voxels[rows, 3].astype(jnp.float32)) * (1 / 255)
    alpha = jnp.where(marched.valid & (alpha > ALPHA_CONTRIBUTES), alpha, 0.0)
    tau = -jnp.log1p(-jnp.minimum(alpha, MAX_ALPHA))
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
    """[R, 3] what the viewer makes of accumulated rays (docs/rendering.md, "Shading"), above 1 not yet clamped."""
    diffuse, features, behind = over_background(sums, background, ndc)
    if head is None:
        return diffuse
    residual = apply_view_mlp(head, diffuse, features, viewdirs)
    return diffuse + residual * (behind <= TRANSMITTANCE_SHADED)[:, None]


@jax.jit
def stored(delta: jax.Array, scene: Scene) -> jax.Array:
    """uint8 [V + 1, 8]: the voxels as they are stored, premultiplied."""
    content = scene.content.astype(jnp.float32)
    moved = delta[scene.cells]
    before = content[:, 3:4]
    depth = -jnp.log1p(-jnp.minimum(before, TOP) / 255)
    alpha = jnp.minimum(-jnp.expm1(-depth * jnp.exp(moved[:, 3:4])) * 255, TOP)
    alpha = jnp.where(before > 0, jnp.maximum(jnp.round(alpha), 1.0), 0.0)
    values = jnp.clip(content / jnp.maximum(before, 1.0) + moved, 0.0, 1.0) * alpha
    return jnp.round(values.at[:, 3:4].set(alpha)).astype(jnp.uint8)


@partial(jax.jit, static_argnames=("sizes", "ndc"))
def squared_error(
    trained: Trained, scene: Scene, dataset: RayDataset, ids: jax.Array, sizes: Sizes, ndc: bool
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Sum of squared errors of the clamped picture over whole rays among `ids`, their number, and their samples."""
    voxels = stored(trained.delta, scene)
    got = gather(scene, voxels, dataset, ids, sizes)
    values = blend(voxels[got.ids].astype(jnp.float32) * (1 / 255), got.weights)
    sums = composite(got.samples, values, sizes.rays, sizes.per_ray)
    rgb = shown(sums, trained.head, got.viewdirs, dataset.background, ndc)
    error = jnp.square(jnp.clip(rgb, 0, 1) - got.target).sum(-1)
    return jnp.where(got.whole, error, 0.0).sum(), got.whole.sum(), got.samples.valid.sum()


@partial(jax.jit, static_argnames=("sizes", "ndc"), donate_argnums=(0, 1, 2))
def update(
    trained: Trained, first: Trained, second: Trained, scene: Scene, dataset: RayDataset, ids: jax.Array,
    count: jax.Array, rates: jax.Array, sizes: Sizes, ndc: bool,
) -> tuple[Trained, Trained, Trained, dict[str, jax.Array]]:  # fmt: skip
    """One step of Adam on the rays `ids`. rates [9]: of the 8 parts of delta, and of the view MLP. count: steps so far."""
    voxels = stored(trained.delta, scene)
    got = gather(scene, voxels, dataset, ids, sizes)
    corners = voxels[got.ids].astype(jnp.float32) * (1 / 255)
    values = blend(corners, got.weights)
    total = jnp.maximum(got.whole.sum(), 1)

    def loss_of(values: jax.Array, head: ViewMlpParams | None) -> jax.Array:
        sums = composite(got.samples, values, sizes.rays, sizes.per_ray)
        rgb = shown(sums, head, got.viewdirs, dataset.background, ndc)
        return jnp.where(got.whole, jnp.square(jnp.minimum(rgb, 1.0) - got.target).sum(-1), 0.0).sum() / total

    error, (slope, head_slope) = jax.value_and_grad(loss_of, argnums=(0, 1))(values, trained.head)
    of_corners = got.weights[..., None] * slope[:, None]
    alpha = corners[..., 3]
    # A voxel is alpha (colour, 1, features) with alpha = 1 - exp(-depth): d alpha / d log depth = depth exp(-depth).
    log_density = (-jnp.log1p(-jnp.minimum(alpha, MAX_ALPHA)) * (1 - alpha) / jnp.maximum(alpha, 1e-6)) * (
        of_corners * corners
    ).sum(-1)
    gradient = (of_corners * alpha[..., None]).at[..., 3].set(log_density)
    gradient = jnp.zeros_like(trained.delta).at[scene.cells[got.ids]].add(gradient).at[0].set(0.0)
    trained, first, second = _adam(trained, Trained(gradient, head_slope), first, second, count, rates)
    return trained, first, second, error / 3


def _adam(
    trained: Trained, slope: Trained, first: Trained, second: Trained, count: jax.Array, rates: jax.Array
) -> tuple[Trained, Trained, Trained]:
    """Adam; cells that no ray of this step met are left alone, moments included."""
    one, two = BETAS
    steps = count.astype(jnp.float32) + 1.0
    correction = jnp.sqrt(1 - two**steps) / (1 - one**steps)

    def moments(slope, m, v):
        return one * m + (1 - one) * slope, two * v + (1 - two) * jnp.square(slope)

    met = jnp.any(slope.delta != 0, axis=1, keepdims=True)
    m, v = moments(slope.delta, first.delta, second.delta)
    ever = jnp.maximum((v > 0).sum(0), 1)
    floor = jnp.sqrt(v.sum(0) / ever)
    value = trained.delta - rates[:8] * correction * m / (jnp.sqrt(v) + floor + 1e-12)
    delta, m, v = (
        jnp.where(met, new, old) for new, old in ((value, trained.delta), (m, first.delta), (v, second.delta))
    )
    if trained.head is None:
        return Trained(delta, None), Trained(m, None), Trained(v, None)
    leaves, tree = jax.tree.flatten(trained.head)
    heads = []
    for a, g, *old in zip(leaves, *(jax.tree.leaves(part.head) for part in (slope, first, second)), strict=True):
        m_head, v_head = moments(g, *old)
        heads.append((a - rates[8] * correction * m_head / (jnp.sqrt(v_head) + 1e-12), m_head, v_head))
    new, m_head, v_head = (jax.tree.unflatten(tree, part) for part in zip(*heads, strict=True))
    return Trained(delta, new), Trained(m, m_head), Trained(v, v_head)
