"""The paper's method (training.method.Method): the loss of section 4.3, the optimiser of section 6.

    L = (|C_coarse - C|^2 + |C_fine - C|^2 + lambda_s (S(sigma_coarse) + S(sigma_fine))) / 3,  S at the coarse samples

Gradients are clipped by value, then by norm, and go to Adam. Compiled once: shapes never change between steps. Rays are spread
over the devices of the dataset's mesh (training.devices), parameters are whole on each.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import NamedSharding

from console import UserError
from training.checkpoints import from_arrays, to_arrays
from training.config import REAL_BATCH, SYNTHETIC_BATCH, NerfConfig, TrainConfig
from training.dataset import RayDataset
from training.devices import WHOLE, here, put_whole, split
from training.method import FieldOutput, Method, Rays, RenderOutput, ViewMlpParams
from training.nerf import model
from training.rendering import CHANNELS, cauchy_sparsity, mean_squared_error, psnr_of, squared_error


class NerfState(NamedTuple):
    """Everything that a step changes."""

    params: model.NerfParams
    optimizer: Any


Update = tuple[NerfState, dict[str, jax.Array]]  # and the step's metrics


class NerfMethod(Method):
    """The paper's deferred NeRF, or one of its baselines, on the rays of a dataset."""

    def __init__(self, config: TrainConfig, dataset: RayDataset) -> None:
        if config.nerf.matmul == "auto":
            matmul = "float32" if jax.default_backend() == "cpu" else "bfloat16"
            config = dataclasses.replace(config, nerf=dataclasses.replace(config.nerf, matmul=matmul))
        nerf, mesh = config.nerf, dataset.mesh
        self.config, self.dataset, self.mesh = config, dataset, mesh
        self.batch_size = config.batch_size or (SYNTHETIC_BATCH if dataset.facts.rendered else REAL_BATCH)
        self._slices = batch_slices(self.batch_size, nerf.gradient_rays, mesh.size)
        self._optimizer: Any = make_optimizer(nerf, config.steps)
        self._update = jax.jit(self._update_traced, out_shardings=NamedSharding(mesh, WHOLE), donate_argnums=1)
        self._render = jax.jit(lambda params, rays: model.render_rays(params, rays, nerf, dataset.facts).fine)
        self._query = jax.jit(lambda field, points: model.field_of(field, model.apply_trunk(field, points, nerf)))

    def start(self, key: jax.Array) -> NerfState:
        return put_whole(self._fresh(key), self.mesh)

    def step(self, state: NerfState, step: int, progress: float | None = None) -> Update:
        """One update on a batch that depends on seed and step alone; the old state's buffers are given away."""
        by_steps = min(step / max(self.config.steps, 1), 1.0)
        ahead = 0.0 if progress is None else progress - by_steps
        return self._update(self.dataset, state, np.int32(step), np.float32(ahead))

    def render(self, state: NerfState, rays: Rays) -> RenderOutput:
        """Renders rays with the fine model; colours are clamped to [0, 1]."""
        params = here(state.params)
        out = in_slices(lambda part: self._render(params, part), rays, self.config.nerf.render_rays)
        return out._replace(rgb=jnp.clip(out.rgb, 0.0, 1.0))

    def query(self, state: NerfState, points: jax.Array) -> FieldOutput:
        field = here(state.params.fine.field)
        return in_slices(lambda part: self._query(field, part), points, self.config.nerf.query_points)

    def view_mlp(self, state: NerfState) -> ViewMlpParams | None:
        """The fine model's deferred head; None for a diffuse model, and for the baselines, which have none a ray."""
        view = here(state.params.fine.view)
        return view if self.config.nerf.view == "deferred" and isinstance(view, ViewMlpParams) else None

    def save(self, state: NerfState) -> dict[str, np.ndarray]:
        return to_arrays(here(state))

    def restore(self, arrays: dict[str, np.ndarray]) -> NerfState:
        """The inverse of save; UserError where the arrays are of another configuration."""
        template = jax.eval_shape(self._fresh, jax.random.PRNGKey(0))
        return put_whole(from_arrays(template, arrays), self.mesh)

    def _fresh(self, key: jax.Array) -> NerfState:
        params = model.init_nerf(key, self.config.nerf)
        return NerfState(params, self._optimizer.init(params))

    def _update_traced(self, dataset: RayDataset, state: NerfState, step: jax.Array, ahead: jax.Array) -> Update:
        """One update. ahead: how much further down the rate is than it would be by steps alone."""
        key = jax.random.fold_in(jax.random.PRNGKey(self.config.seed), step)
        key_batch, key_render = jax.random.split(key)
        ids = jax.random.randint(key_batch, (self.batch_size,), 0, dataset.count)
        rays, target = dataset.geometry_at(ids), dataset.colours_at(ids)
        perturbation = model.draw_perturbation(key_render, self.batch_size, self.config.nerf)
        gradient, metrics = self._gradient(state.params, *split((rays, target, perturbation), self.mesh))
        updates, optimizer = self._optimizer.update(gradient, state.optimizer, state.params)
        further = (self.config.nerf.last_rate / self.config.nerf.first_rate) ** ahead  # the decay is log-linear
        updates = jax.tree.map(lambda change: further * change, updates)
        mse = metrics.pop("mse")
        metrics |= {"psnr": psnr_of(mse), "gradient_norm": optax.tree.norm(gradient)}
        metrics["rays"] = jnp.float32(self.batch_size)
        metrics["learning_rate"] = further * learning_rate(self.config.nerf, self.config.steps, step)
        params: Any = optax.apply_updates(state.params, updates)  # type: ignore[arg-type]
        return NerfState(params, optimizer), metrics

    def _gradient(self, params: model.NerfParams, rays: Rays, target: jax.Array, perturbation: model.Perturbation):
        """The batch's gradient and metrics, slice by slice where memory asks for it."""
        gradient_of = jax.grad(self._loss, has_aux=True)
        if self._slices == 1:
            return gradient_of(params, rays, target, perturbation)

        def add_slice(total, part):
            return jax.tree.map(jnp.add, total, gradient_of(params, *split(part, self.mesh))), None

        # slice s takes rays s, s + slices, ...: of each device's share equally many
        batch = rays, target, perturbation
        parts = jax.tree.map(lambda v: v.reshape(-1, self._slices, *v.shape[1:]).swapaxes(0, 1), batch)
        shapes = jax.eval_shape(gradient_of, params, *jax.tree.map(lambda v: v[0], parts))
        zeros = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), shapes)
        total, _ = jax.lax.scan(add_slice, zeros, parts)
        return jax.tree.map(lambda v: v / self._slices, total)

    def _loss(
        self, params: model.NerfParams, rays: Rays, target: jax.Array, perturbation: model.Perturbation
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        config = self.config
        out = model.render_rays(params, rays, config.nerf, self.dataset.facts, perturbation)
        photometric = squared_error(out.coarse.rgb, target) + squared_error(out.fine.rgb, target)
        sparsity = sparsity_of(out.coarse_sigma, out.fine_sigma, config)
        # as large as JAXNeRF's, which counts where gradients are clipped
        loss = (photometric + config.sparsity_weight * sparsity) / CHANNELS
        return loss, {"loss": loss, "sparsity": sparsity, "mse": mean_squared_error(out.fine.rgb, target)}


def sparsity_of(coarse_sigma: jax.Array, fine_sigma: jax.Array, config: TrainConfig) -> jax.Array:
    """S of both fields at the coarse samples, beside errors that are sums over channels (TrainConfig.sparsity_over_samples).

    coarse_sigma [N, K]; fine_sigma [N, K + F], 0 at the fine samples.
    """
    coarse, fine = (cauchy_sparsity(sigma, config.sparsity_scale) for sigma in (coarse_sigma, fine_sigma))
    factor = 1.0 if config.sparsity_over_samples == "paper" else CHANNELS / coarse_sigma.shape[-1]
    return factor * (coarse + fine)


def learning_rate(config: NerfConfig, steps: int, step: jax.Array | int) -> jax.Array:
    """The rate at a step of so many, float32, jittable in `step`: log-linear decay, times a warm-up that eases in along a sine.

    With s the step, S steps in all, W those of the warm-up and m its factor (paper section 6; JAXNeRF):

        rate(s) = exp((1 - s/S) log first + (s/S) log last)  *  (m + (1 - m) sin(pi/2 min(1, s/W)))
    """
    now = jnp.asarray(step, jnp.float32)
    progress = jnp.clip(now / steps, 0.0, 1.0)
    decayed = jnp.exp((1.0 - progress) * jnp.log(config.first_rate) + progress * jnp.log(config.last_rate))
    if config.warmup_steps <= 0:
        return decayed
    warmed = jnp.sin(0.5 * jnp.pi * jnp.clip(now / config.warmup_steps, 0.0, 1.0))
    return decayed * (config.warmup_factor + (1.0 - config.warmup_factor) * warmed)


def make_optimizer(config: NerfConfig, steps: int) -> optax.GradientTransformation:
    """Clipping by value, clipping by norm, Adam, schedule: in this order (paper section 6)."""
    chain = []
    if config.clip_value > 0:
        chain.append(optax.clip(config.clip_value))
    if config.clip_norm > 0:
        chain.append(optax.clip_by_global_norm(config.clip_norm))
    return optax.chain(*chain, optax.adam(lambda count: learning_rate(config, steps, jnp.asarray(count))))


def batch_slices(batch_size: int, gradient_rays: int, devices: int = 1) -> int:
    """Into how many equal slices of at most gradient_rays a device a batch is cut. UserError where that leaves a remainder."""
    if batch_size % devices:
        raise UserError("the batch cannot be spread evenly over the devices", where="--batch-size",
                        expected=f"a multiple of {devices}", found=batch_size)  # fmt: skip
    share = batch_size // devices
    if gradient_rays <= 0 or gradient_rays >= share:
        return 1
    if share % gradient_rays:
        raise UserError("the batch cannot be split evenly", where="--nerf.gradient-rays",
                        expected=f"a divisor of {share}", found=gradient_rays)  # fmt: skip
    return share // gradient_rays


def in_slices(function, values: Any, size: int) -> Any:
    """function(values) for a tree of [N, ...] arrays, `size` rows at a time; the last slice is padded, so one compile."""
    count = jax.tree.leaves(values)[0].shape[0]
    parts = []
    for start in range(0, max(count, 1), size):
        part = jax.tree.map(lambda v, s=start: v[s : s + size], values)
        missing = size - jax.tree.leaves(part)[0].shape[0]
        padded = jax.tree.map(lambda v, m=missing: jnp.pad(v, [(0, m)] + [(0, 0)] * (v.ndim - 1)), part)
        parts.append(jax.tree.map(lambda v, m=missing: v[: size - m], function(padded)))
    return jax.tree.map(lambda *p: jnp.concatenate(p), *parts) if len(parts) > 1 else parts[0]
