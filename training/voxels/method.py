"""The fast method: a sparse voxel grid optimised directly, coarse to fine, behind the same deferred head as the paper's.

Published parts: direct voxel optimisation with total variation and pruning by visible weight (Plenoxels, Fridovich-Keil
et al. 2022), raw values activated after interpolation and an optimiser that leaves unseen voxels alone (DVGO, Sun et al.
2022), empty space skipped by an occupancy structure (instant-ngp, Müller et al. 2022). The head, the Cauchy sparsity term
and the background rule are SNeRG's (sections 4.2 and 4.3).

Per ray i, sample k: raw r(g) interpolated; sigma = softplus(r_0 + shift) / reference; colours and features sigmoid(r_1..7).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding

from scenepack.constants import TRANSMITTANCE_SHADED
from training.config import TrainConfig
from training.dataset import RayDataset
from training.devices import WHOLE, here, put_whole, split
from training.losses import psnr_of
from training.method import FieldOutput, Rays, RenderOutput, ViewMlpParams
from training.view_mlp import apply_view_mlp, init_view_mlp
from training.volume import alpha_of
from training.voxels import stages
from training.voxels.config import settings_for
from training.voxels.march import GridRays, MarchSizes, Samples, march, to_grid, transmittance
from training.voxels.smoothness import distortion, neighbourhood, variation, windows
from training.voxels.sparse_grid import CHANNELS, DEPTH_UNITS, GridLayout, blend, cell_means, interpolate, with_depths

ADAM_BETAS = (0.9, 0.99)
SPARSITY_SAMPLES = 192  # the paper's coarse samples a ray: the spacing that lambda_s was set for
REMEMBER_EVERY = 50  # steps between looks at how deep, optically, cells are
NDC_DEPTH = 2.0  # length of NDC space along a ray, from the near plane to infinity
HEAD_BIAS = -3.0  # the view MLP starts near zero, so that diffuse colour settles first


class Trainable(NamedTuple):
    """rows [V + 1, 8] raw values, and the view MLP (None: diffuse)."""

    rows: jax.Array
    head: ViewMlpParams | None


class VoxelState(NamedTuple):
    """All that changes between steps. first, second: Adam's moments. cells int32 [V + 1]: padded voxel of each row.

    hits int32 [rays]: ids of the training rays that meet content, of which the first hit_count hold. sizes, rays: static.
    The layout remembers optical depths of some steps ago (remember_depths).
    """

    trainable: Trainable
    first: Trainable
    second: Trainable
    updates: jax.Array
    layout: GridLayout
    cells: jax.Array
    hits: jax.Array
    hit_count: jax.Array
    sizes: MarchSizes
    rays: int


class Settings(NamedTuple):
    """Numbers that the compiled step treats as constants."""

    steps: int
    step_voxels: float
    shift: float
    reference: float
    background: tuple[float, float, float]
    any_background: bool
    sparsity_weight: float
    sparsity_scale: float
    sparsity_spacing: float
    rates: tuple[float, float, float]
    final_rate_factor: float
    variation: tuple[float, float]
    variation_share: float
    distortion_weight: float
    distortion_spread: float
    horizon: int


def activate(raw: jax.Array, settings: Settings) -> FieldOutput:
    """Density, diffuse colour and features of raw values [N, 8]."""
    density = jax.nn.softplus(raw[:, 0] + settings.shift) / settings.reference
    colours = jax.nn.sigmoid(raw[:, 1:])
    return FieldOutput(density, colours[:, :3], colours[:, 3:])


@partial(jax.jit, static_argnames="settings")
def remember_depths(rows: jax.Array, layout: GridLayout, settings: Settings) -> GridLayout:
    """The layout with its cells' optical depths as they are now."""
    density = activate(cell_means(layout, rows[:, 0])[:, None], settings).density
    return with_depths(layout, density * (settings.step_voxels * layout.voxel.max()))


def render_samples(
    raw: jax.Array, head: ViewMlpParams | None, samples: Samples, lengths: jax.Array, viewdirs: jax.Array,
    sizes: MarchSizes, settings: Settings, background: jax.Array | None = None,
) -> tuple[RenderOutput, FieldOutput, jax.Array]:  # fmt: skip
    """Composites and shades N rays from raw values [S, 8] at their samples; also the field there, and the weights [S].

    lengths [N]: world units per voxel along each ray. background [N, 3]: another than the scene's. Nothing is clamped.
    """
    count = viewdirs.shape[0]
    field = activate(raw, settings)
    tau = field.density * (settings.step_voxels * lengths)[samples.ray]
    before, behind = transmittance(samples, tau, count, sizes.per_ray)
    weights = jnp.where(samples.valid, before * alpha_of(tau, 1.0), 0.0)
    values = jnp.concatenate([field.diffuse, field.features, samples.t[:, None]], axis=-1)
    sums = jnp.zeros((count, 8)).at[samples.ray].add(weights[:, None] * values)
    behind_all = jnp.asarray(settings.background) if background is None else background
    diffuse = sums[:, :3] + behind[:, None] * behind_all
    rgb = diffuse
    if head is not None:
        residual = apply_view_mlp(head, diffuse, sums[:, 3:7], viewdirs)
        rgb = diffuse + residual * (behind <= TRANSMITTANCE_SHADED)[:, None]
    output = RenderOutput(rgb=rgb, diffuse=diffuse, features=sums[:, 3:7], alpha=1.0 - behind, depth=sums[:, 7])
    return output, field, weights


@lru_cache
def compiled_remembering(mesh: Mesh) -> Callable[..., Any]:
    """`remember_depths`, jitted to return what the step's compilation expects: a layout whole on every device."""
    return jax.jit(remember_depths, static_argnums=2, out_shardings=NamedSharding(mesh, WHOLE))


@lru_cache
def compiled_update(mesh: Mesh) -> Callable[..., Any]:
    """`update`, jitted for the devices of a mesh; the trainable values and their moments are given away."""
    return jax.jit(
        update, static_argnames=("sizes", "rays", "settings"), donate_argnums=(0, 1, 2),
        out_shardings=NamedSharding(mesh, WHOLE),
    )  # fmt: skip


def update(
    trainable: Trainable, first: Trainable, second: Trainable, updates: jax.Array, layout: GridLayout, cells: jax.Array,
    hits: jax.Array, hit_count: jax.Array, dataset: RayDataset, key: jax.Array, step: jax.Array, progress: jax.Array,
    *, sizes: MarchSizes, rays: int, settings: Settings,
) -> tuple[Trainable, Trainable, Trainable, jax.Array, dict[str, jax.Array]]:  # fmt: skip
    """One step: draw rays, march, render, differentiate, Adam. Samples are spread over the devices of the dataset's mesh.

    Its parts are functions of their own, so that training.profile_step can time what is run here.
    """
    ray_key, phase_key, voxel_key, colour_key = jax.random.split(jax.random.fold_in(key, step), 4)
    batch = draw(hits, hit_count, dataset, ray_key, colour_key, rays, settings)
    grid_rays, samples = marched(batch, layout, phase_key, sizes, settings, dataset.mesh)
    rows = addressed(trainable, layout, cells, samples, voxel_key, settings)

    def loss_of(trainable: Trainable) -> tuple[jax.Array, dict[str, jax.Array]]:
        values = fetched(trainable, rows)
        return losses(trainable, values, rows, batch, grid_rays, samples, layout, sizes, settings)

    (loss, metrics), gradient = jax.value_and_grad(loss_of, has_aux=True)(trainable)
    trainable, first, second = adam(trainable, gradient, first, second, updates, progress, settings)
    metrics |= {"loss": loss, "psnr": psnr_of(metrics["mse"])}
    return trainable, first, second, updates + 1, metrics


class Batch(NamedTuple):
    """The rays of a step, their colours [N, 3] and the background [N, 3] that these were laid over."""

    rays: Rays
    target: jax.Array
    background: jax.Array


class Addresses(NamedTuple):
    """Rows int32 [S, 8] and trilinear weights [S, 8] around each sample; rows [P, 4] of voxels whose variation is looked at."""

    ids: jax.Array
    weights: jax.Array
    near: jax.Array


def draw(
    hits: jax.Array, hit_count: jax.Array, dataset: RayDataset, ray_key: jax.Array, colour_key: jax.Array, rays: int,
    settings: Settings,
) -> Batch:  # fmt: skip
    """Random training rays among those that meet content, and their pixels."""
    ids = hits[jax.random.randint(ray_key, (rays,), 0, hit_count)]
    # Before a background of any colour, gaps in opaque photographs are mistakes, and so is white mist around what masks
    # cut out. Rendered pictures are seen before their own colour, and keep it.
    background = jax.random.uniform(colour_key, (rays, 3))
    if not settings.any_background:
        background = jnp.broadcast_to(jnp.asarray(settings.background), (rays, 3))
    return Batch(*split((dataset.geometry_at(ids), dataset.colours_over(ids, background)), dataset.mesh), background)


def marched(
    batch: Batch, layout: GridLayout, phase_key: jax.Array, sizes: MarchSizes, settings: Settings, mesh: Mesh
) -> tuple[GridRays, Samples]:
    """The samples of a batch, empty space left out, at a random phase of each ray."""
    grid_rays = to_grid(layout, batch.rays)
    phase = jax.random.uniform(phase_key, batch.rays.near.shape)
    samples = march(layout, grid_rays, phase, sizes, settings.step_voxels, settings.horizon)
    return grid_rays, split(samples, mesh)


def addressed(
    trainable: Trainable, layout: GridLayout, cells: jax.Array, samples: Samples, voxel_key: jax.Array,
    settings: Settings,
) -> Addresses:  # fmt: skip
    """Which voxels a step reads: around its samples, and in random windows, for their variation."""
    ids, weights = layout.corners(samples.g)
    picked = windows(voxel_key, trainable.rows.shape[0] - 1, settings.variation_share)
    return Addresses(ids, weights, neighbourhood(layout, cells, picked))


def fetched(trainable: Trainable, rows: Addresses) -> tuple[jax.Array, jax.Array]:
    """Raw values [S, 8] at the samples, and those of the neighbourhoods [P, 4, 8]."""
    # One gather for samples and neighbourhoods: its transpose is one scatter into one dense gradient.
    values = trainable.rows[jnp.concatenate([rows.ids.ravel(), rows.near.ravel()])]
    at_samples, nearby = values[: rows.ids.size].reshape(-1, 8, CHANNELS), values[rows.ids.size :]
    return blend(at_samples, rows.weights), nearby.reshape(-1, 4, CHANNELS)


def losses(
    trainable: Trainable, values: tuple[jax.Array, jax.Array], rows: Addresses, batch: Batch, grid_rays: GridRays,
    samples: Samples, layout: GridLayout, sizes: MarchSizes, settings: Settings,
) -> tuple[jax.Array, dict[str, jax.Array]]:  # fmt: skip
    """The loss of a step and its metrics, from raw values at the samples and in the neighbourhoods."""
    (raw, nearby), count = values, batch.target.shape[0]
    counted = samples.complete & (samples.counts > 0)
    total = jnp.maximum(counted.sum(), 1)
    output, field, weights = render_samples(
        raw, trainable.head, samples, grid_rays.length, batch.rays.viewdirs, sizes, settings, batch.background
    )
    error = jnp.square(output.rgb - batch.target).sum(-1)
    colour = jnp.where(counted, error, 0.0).sum() / total
    penalty = jnp.where(samples.valid, jnp.log1p(jnp.square(field.density) / settings.sparsity_scale), 0.0).sum()
    spacing = settings.step_voxels * layout.voxel.max() / settings.sparsity_spacing
    sparsity = settings.sparsity_weight * spacing * penalty / total
    scattered = 0.0
    if settings.distortion_weight > 0:
        spread = settings.distortion_spread / (layout.voxel.max() * settings.step_voxels)
        scattered = distortion(samples, weights, spread, count, sizes.per_ray) / total
    rough_density, rough_colour = variation(nearby, rows.near)
    smooth = settings.variation[0] * rough_density + settings.variation[1] * rough_colour
    mse = jnp.where(counted, jnp.square(jnp.clip(output.rgb, 0, 1) - batch.target).sum(-1), 0.0).sum() / (3 * total)
    scattered *= settings.distortion_weight
    metrics = {"mse": mse, "sparsity": sparsity, "variation": smooth, "distortion": jnp.float32(scattered)}
    metrics |= {"rays": total, "samples": samples.valid.sum()}
    return colour + sparsity + smooth + scattered, metrics


def adam(
    trainable: Trainable, gradient: Trainable, first: Trainable, second: Trainable, updates: jax.Array,
    progress: jax.Array, settings: Settings,
) -> tuple[Trainable, Trainable, Trainable]:  # fmt: skip
    """Adam; voxels without a gradient are left alone, moments included (DVGO's masked Adam)."""
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
    if trainable.head is None:
        return tuple(Trainable(array, None) for array in rows)  # type: ignore[return-value]
    leaves, tree = jax.tree.flatten(trainable.head)
    others = (jax.tree.leaves(t.head) for t in (gradient, first, second))
    parts = [
        move(value, slope, one, two, head_rate, False) for value, slope, one, two in zip(leaves, *others, strict=True)
    ]
    heads = [jax.tree.unflatten(tree, [part[i] for part in parts]) for i in range(3)]
    return tuple(Trainable(array, head) for array, head in zip(rows, heads, strict=True))  # type: ignore[return-value]


class VoxelMethod:
    """The fast field behind training.method.Method."""

    def __init__(self, config: TrainConfig, dataset: RayDataset) -> None:
        self.config, self.dataset = config, dataset
        self.voxels, self.by_kind = config.voxels, settings_for(config.voxels, dataset.kind)
        self.geometry = dataset.local()  # what happens between steps needs no pixels, and each process does it alike
        self.box = np.asarray(dataset.aabb, np.float64)
        self.resolutions = self.voxels.ndc_resolutions if dataset.ndc else self.voxels.resolutions
        self.shape = np.array([1.0, 1.0, self.voxels.ndc_depth if dataset.ndc else 1.0])  # of a voxel, in widths
        extent = (self.box[1] - self.box[0]).max()
        coarse, fine = extent / self.resolutions[0], extent / self.resolutions[-1]
        optical_depth = -np.log1p(-self.voxels.initial_alpha) * fine / coarse
        # the paper's samples are this far apart; where they are even in 1/t, at distance 1 (the cameras', by the readers)
        length = (
            1.0 / dataset.near if dataset.facts.disparity else NDC_DEPTH if dataset.ndc else dataset.far - dataset.near
        )
        spacing = length / SPARSITY_SAMPLES
        self.settings = Settings(
            steps=config.steps,
            step_voxels=self.voxels.step_voxels,
            shift=float(np.log(np.expm1(optical_depth))),
            reference=float(fine),
            background=dataset.background,
            any_background=dataset.kind != "object" or dataset.facts.cut_out,
            sparsity_weight=config.sparsity_weight * self.by_kind.sparsity_factor,
            sparsity_scale=config.sparsity_scale,
            sparsity_spacing=float(spacing),
            rates=(self.voxels.density_rate, self.voxels.colour_rate, self.voxels.head_rate),
            final_rate_factor=self.voxels.final_rate_factor,
            variation=(self.by_kind.density_variation, self.by_kind.colour_variation),
            variation_share=self.voxels.variation_share,
            distortion_weight=self.by_kind.distortion_weight,
            distortion_spread=float(extent),
            horizon=int(-np.log(self.voxels.horizon) * DEPTH_UNITS),
        )
        self.key = jax.random.key(config.seed)
        self.schedule = stages.schedule(self.by_kind, config.steps, self.resolutions)

    def start(self, key: jax.Array) -> VoxelState:
        head = None
        if self.voxels.view_dependence:
            head = init_view_mlp(key)
            head = head._replace(biases=(*head.biases[:2], head.biases[2] + HEAD_BIAS))
        return put_whole(stages.dense_start(self, head), self.dataset.mesh)

    def step(self, state: VoxelState, step: int) -> tuple[VoxelState, dict[str, jax.Array]]:
        if step in self.schedule and step > 0:
            state = put_whole(stages.refine(self, here(state), self.schedule[step]), self.dataset.mesh)
        if step % REMEMBER_EVERY == 0 or step in self.schedule:  # at a new stage, too: compiled then, not later
            remember = compiled_remembering(self.dataset.mesh)
            state = state._replace(layout=remember(state.trainable.rows, state.layout, self.settings))
        *new, metrics = compiled_update(self.dataset.mesh)(
            state.trainable, state.first, state.second, state.updates, state.layout, state.cells, state.hits,
            state.hit_count, self.dataset, self.key, np.int32(step), np.float32(step / max(self.config.steps, 1)),
            sizes=state.sizes, rays=state.rays, settings=self.settings,
        )  # fmt: skip
        return state._replace(trainable=new[0], first=new[1], second=new[2], updates=new[3]), metrics

    def render(self, state: VoxelState, rays: Rays) -> RenderOutput:
        return stages.render_all(self, here(state), rays)

    def query(self, state: VoxelState, points: jax.Array) -> FieldOutput:
        return query(*here((state.trainable.rows, state.layout)), points, self.settings)

    def may_hold(self, state: VoxelState, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """bool [N]: whether boxes from low to high [N, 3], training frame, meet any present voxel's support."""
        return stages.boxes_with_voxels(here(state.layout), low, high)

    def view_mlp(self, state: VoxelState) -> ViewMlpParams | None:
        return here(state.trainable.head)

    def save(self, state: VoxelState) -> dict[str, np.ndarray]:
        return stages.save(here(state))

    def restore(self, arrays: Mapping[str, np.ndarray]) -> Any:
        return put_whole(stages.restore(self, arrays), self.dataset.mesh)


@partial(jax.jit, static_argnames="settings")
def query(rows: jax.Array, layout: GridLayout, points: jax.Array, settings: Settings) -> FieldOutput:
    """The field at world points [N, 3]; density 0 outside the box and where no voxel is present."""
    g = (points - layout.origin) / layout.voxel
    inside = jnp.all((g >= 0) & (g <= layout.dims), axis=-1)
    field = activate(interpolate(rows, layout, g), settings)
    return field._replace(density=jnp.where(inside & layout.has_support(g), field.density, 0.0))
