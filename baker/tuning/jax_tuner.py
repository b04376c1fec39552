"""baker.tuning.tuner.Tuner by XLA: for cards, and the reference for other tuners.

Notation: R rays; S samples with support; C of them contribute, which is all that a gradient needs; V voxels with alpha,
K cells, row 0 of either stands for what is empty.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from baker.tuning.joint_rows import VoxelRows, cells_of_rows, odd_of_rows, rows_by_slot, voxel_rows, with_content
from baker.tuning.pack_layout import MAX_ALPHA, PackLayout, composite, pack_layout, pack_rays, pack_sizes
from baker.tuning.tuner import (
    BETAS,
    DITHER,
    PROBE_RAYS,
    ROOM,
    TINY,
    TOP,
    Look,
    Trained,
    adam_head,
    bias_correction,
    psnr_of,
    squared_error,
)
from baker.view_mlp import from_params, to_params
from scenepack.codecs.steps import EXACT, Steps
from scenepack.constants import ALPHA_CONTRIBUTES, TRANSMITTANCE_STOP
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.marching.layout import blend
from training.marching.march import MarchSizes, Samples, march, occupied_segments, transmittance
from training.marching.rays import GridFrameRays, to_grid
from training.method import ViewMlpParams


class Sizes(NamedTuple):
    """Static sizes of a step: rays, lists of samples, contributing samples, and most of these a ray."""

    rays: int
    march: MarchSizes
    contributing: int
    per_ray: int


class Scene(NamedTuple):
    """What stays: the layout, the training rays in its frame, rows int32 [slots B³] of baker.tuning.joint_rows.

    content uint8 [V + 1, 8]: the voxels as they were; cells int32 [V + 1]: the cell of each; dither float32 [V + 1, 8]: what
    is added before rounding down. steps float32 [8]: of what is stored.
    """

    layout: PackLayout
    rays: GridFrameRays
    rows: jax.Array
    content: jax.Array
    cells: jax.Array
    dither: jax.Array
    steps: jax.Array


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


@jax.jit
def stored(delta: jax.Array, scene: Scene) -> jax.Array:
    """uint8 [V + 1, 8]: the voxels as they are stored, premultiplied."""
    content = scene.content.astype(jnp.float32)
    moved = delta[scene.cells]
    before = content[:, 3:4]
    depth = -jnp.log1p(-jnp.minimum(before, TOP) / 255)
    alpha = jnp.minimum(-jnp.expm1(-depth * jnp.exp(moved[:, 3:4])) * 255, TOP)
    alpha = jnp.maximum(_rounded(alpha, scene.steps[3], 0.5, 255.0), scene.steps[3])
    alpha = jnp.where(before > 0, alpha, 0.0)
    values = jnp.clip(content / jnp.maximum(before, 1.0) + moved, 0.0, 1.0) * alpha
    values = _rounded(values, scene.steps, scene.dither, alpha)
    return values.at[:, 3:4].set(alpha).astype(jnp.uint8)


def _rounded(values: jax.Array, steps: jax.Array, up: jax.Array | float, most: jax.Array | float) -> jax.Array:
    """Values in units, or as one of the two levels beside each: multiples of `steps`, and `most`. up: what is added, in levels,
    before they are rounded down."""
    low = jnp.floor(values / steps) * steps
    high = jnp.minimum(low + steps, most)
    return jnp.where(
        steps == 1, jnp.round(values), jnp.where(values - low + up * (high - low) >= high - low, high, low)
    )


@partial(jax.jit, static_argnames=("sizes", "look"))
def score_some(
    trained: Trained, scene: Scene, dataset: RayDataset, ids: jax.Array, sizes: Sizes, look: Look
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Sum of squared errors of the clamped picture over whole rays among `ids`, their weight, their number, and their samples."""
    voxels = stored(trained.delta, scene)
    got = gather(scene, voxels, dataset, ids, sizes)
    values = blend(voxels[got.ids].astype(jnp.float32) * (1 / 255), got.weights)
    sums = composite(got.samples, values, sizes.rays, sizes.per_ray)
    error, weight = squared_error(
        sums, trained.head, got.viewdirs, got.target, got.whole, dataset.background, look, clamped=True
    )
    return error, weight, got.whole.sum(), got.samples.valid.sum()


@partial(jax.jit, static_argnames=("sizes", "look"), donate_argnums=(0, 1, 2))
def update(
    trained: Trained, first: Trained, second: Trained, scene: Scene, dataset: RayDataset, ids: jax.Array,
    count: jax.Array, rates: jax.Array, sizes: Sizes, look: Look,
) -> tuple[Trained, Trained, Trained, dict[str, jax.Array]]:  # fmt: skip
    """One step of Adam on the rays `ids`. rates [9]: of the 8 parts of delta, and of the view MLP. count: steps so far."""
    voxels = stored(trained.delta, scene)
    got = gather(scene, voxels, dataset, ids, sizes)
    corners = voxels[got.ids].astype(jnp.float32) * (1 / 255)
    values = blend(corners, got.weights)

    def loss_of(values: jax.Array, head: ViewMlpParams | None) -> jax.Array:
        sums = composite(got.samples, values, sizes.rays, sizes.per_ray)
        error, weight = squared_error(
            sums, head, got.viewdirs, got.target, got.whole, dataset.background, look, clamped=False
        )
        return error / jnp.maximum(weight, 1.0)

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
    m = one * first.delta + (1 - one) * slope.delta
    v = two * second.delta + (1 - two) * jnp.square(slope.delta)
    met = jnp.any(slope.delta != 0, axis=1, keepdims=True)
    floor = jnp.sqrt(v.sum(0) / jnp.maximum((v > 0).sum(0), 1))
    value = trained.delta - rates[:8] * bias_correction(count) * m / (jnp.sqrt(v) + floor + TINY)
    delta, m, v = (
        jnp.where(met, new, old) for new, old in ((value, trained.delta), (m, first.delta), (v, second.delta))
    )
    if trained.head is None:
        return Trained(delta, None), Trained(m, None), Trained(v, None)
    heads = adam_head(trained.head, slope.head, first.head, second.head, rates[8], count)  # type: ignore[arg-type]
    return tuple(Trained(*parts) for parts in zip((delta, m, v), heads, strict=True))  # type: ignore[return-value]


class JaxTuner:
    """See baker.tuning.tuner.Tuner."""

    def __init__(self, pack: Pack, dataset: RayDataset, cell: int, look: Look, steps: Steps) -> None:
        self.look, self.pack, self.dataset, self.rows = look, pack, dataset, voxel_rows(pack)
        self.scene = scene_of(pack, self.rows, dataset, cell, steps)
        self.trained = start(self.scene, pack)
        self.first, self.second = (jax.tree.map(jnp.zeros_like, self.trained) for _ in range(2))
        self.rays, self.sizes = 0, Sizes(0, pack_sizes(pack, 0), 0, 0)

    def fill(self, ids: np.ndarray, samples: int, seed: int) -> None:
        self.sizes = list_sizes(self.scene, self.trained, self.dataset, self.pack, ids, samples, seed)
        self.rays = self.sizes.rays

    def update(self, ids: np.ndarray, rates: np.ndarray, count: int) -> None:
        self.trained, self.first, self.second, _ = update(
            self.trained, self.first, self.second, self.scene, self.dataset, jnp.asarray(ids), jnp.int32(count), rates,
            self.sizes, self.look,
        )  # fmt: skip

    def score(self, ids: np.ndarray) -> tuple[float, float]:
        totals = np.zeros(4)
        ids = np.resize(ids, -(-len(ids) // self.rays) * self.rays)  # whole batches: another size is compiled anew
        for part in ids.reshape(-1, self.rays):
            some = score_some(self.trained, self.scene, self.dataset, jnp.asarray(part), self.sizes, self.look)
            totals += [float(n) for n in some]
        error, weight, rays, samples = totals
        return psnr_of(error, weight), samples / max(rays, 1.0)

    def snapshot(self) -> Trained:
        return jax.tree.map(np.asarray, self.trained)

    def tuned(self, snapshot: Trained) -> Pack:
        pack = with_content(self.pack, self.rows, np.asarray(stored(jnp.asarray(snapshot.delta), self.scene)))
        return pack if snapshot.head is None else replace(pack, view_mlp=from_params(snapshot.head))


def tuner_of(pack: Pack, dataset: RayDataset, cell: int, look: Look, steps: Steps) -> JaxTuner:
    """The tuner of a pack."""
    return JaxTuner(pack, dataset, cell, look, steps)


def scene_of(pack: Pack, rows: VoxelRows, dataset: RayDataset, cell: int, steps: Steps = EXACT) -> Scene:
    """What stays of a pack while it is tuned."""
    cells = jnp.asarray(cells_of_rows(pack, rows, cell))
    by_slot, content = jnp.asarray(rows_by_slot(pack, rows)), jnp.asarray(rows.content)
    dither = jnp.full(content.shape, 0.5).at[:, :3].set(DITHER[odd_of_rows(pack, rows), None])
    multiples = jnp.asarray(steps.channels)
    return Scene(pack_layout(pack), pack_rays(pack, dataset), by_slot, content, cells, dither, multiples)


def start(scene: Scene, pack: Pack) -> Trained:
    """Cells that change nothing, and the pack's view MLP."""
    return Trained(jnp.zeros((int(scene.cells.max()) + 1, 8)), pack.view_mlp and to_params(pack.view_mlp))


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
