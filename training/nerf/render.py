"""A batch of rays through the coarse and the fine model (SNeRG sections 4.1 and 4.2; NeRF section 5.2).

Notation: N rays, K coarse and F fine samples. Each of the two models has a field and a view-dependent head of its own
(as in the release), and the fine field is asked at all K + F positions.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from training.config import NerfConfig
from training.dataset import SceneFacts
from training.method import Rays, RenderOutput, ViewMlpParams
from training.nerf.field import (
    FieldParams,
    NerfHead,
    apply_nerf_head,
    apply_trunk,
    field_of,
    init_field,
    init_nerf_head,
)
from training.nerf.sampling import coarse_samples, fine_samples, merge_samples
from training.view_mlp import apply_view_mlp, init_view_mlp
from training.volume import composite, intervals, over_background, shade, weights_of


class ModelParams(NamedTuple):
    """One field and what depends on direction: a view MLP (deferred, tiny), JAXNeRF's head (nerf), None (none)."""

    field: FieldParams
    view: ViewMlpParams | NerfHead | None


class NerfParams(NamedTuple):
    """The two models of hierarchical sampling; the fine one is what gets baked."""

    coarse: ModelParams
    fine: ModelParams


class Rendered(NamedTuple):
    """What the loss needs: both pictures [N], and the densities of both fields at the coarse samples.

    coarse_sigma [N, K]. fine_sigma [N, K + F] is 0 at the fine samples: the sparsity loss must not see them.
    """

    coarse: RenderOutput
    fine: RenderOutput
    coarse_sigma: jax.Array
    fine_sigma: jax.Array


class Perturbation(NamedTuple):
    """How N rays are perturbed while training: jitter in [0, 1) of coarse [N, K] and fine [N, F] positions, and noise on raw
    density at coarse [N, K] and at all [N, K + F] samples (None: no noise).

    Drawn for a whole batch at once, so that no result depends on how the batch is cut or spread.
    """

    coarse: jax.Array
    fine: jax.Array
    coarse_noise: jax.Array | None
    fine_noise: jax.Array | None


def draw_perturbation(key: jax.Array, count: int, config: NerfConfig) -> Perturbation:
    """Random perturbations of `count` rays."""
    keys = jax.random.split(key, 4)
    coarse, fine, scale = config.coarse_samples, config.fine_samples, config.density_noise
    noise = [
        scale * jax.random.normal(k, (count, samples)) if scale > 0 else None
        for k, samples in ((keys[2], coarse), (keys[3], coarse + fine))
    ]
    return Perturbation(
        jax.random.uniform(keys[0], (count, coarse)), jax.random.uniform(keys[1], (count, fine)), *noise
    )


def init_nerf(key: jax.Array, config: NerfConfig) -> NerfParams:
    """Fresh parameters of both models."""

    def model(k_field: jax.Array, k_view: jax.Array) -> ModelParams:
        view = None
        if config.view != "none":
            view = init_nerf_head(k_view, config.width) if config.view == "nerf" else init_view_mlp(k_view)
        return ModelParams(init_field(k_field, config), view)

    keys = jax.random.split(key, 4)
    return NerfParams(model(*keys[:2]), model(*keys[2:]))


def render_rays(
    params: NerfParams, rays: Rays, config: NerfConfig, facts: SceneFacts, perturbation: Perturbation | None = None
) -> Rendered:
    """Renders N rays. With perturbation, positions are jittered and density noise is added; without, all is deterministic."""
    jitter, fine_jitter, noise, fine_noise = (None,) * 4 if perturbation is None else perturbation
    t = coarse_samples(jitter, rays.near, rays.far, config.coarse_samples, facts.disparity)
    coarse, coarse_sigma, weights = _render_model(params.coarse, rays, t, config, facts, noise)
    fine_t = fine_samples(fine_jitter, t, weights, config.fine_samples)
    t, is_coarse = merge_samples(t, fine_t)
    fine, fine_sigma, _ = _render_model(params.fine, rays, t, config, facts, fine_noise)
    return Rendered(coarse, fine, coarse_sigma, jnp.where(is_coarse, fine_sigma, 0.0))


def _render_model(
    model: ModelParams, rays: Rays, t: jax.Array, config: NerfConfig, facts: SceneFacts, noise: jax.Array | None
) -> tuple[RenderOutput, jax.Array, jax.Array]:
    """One model at positions t [N, S]: its picture, densities [N, S] and weights [N, S]."""
    points = rays.origins[:, None] + t[..., None] * rays.directions[:, None]
    trunk = apply_trunk(model.field, points, config)
    field = field_of(model.field, trunk, 0.0 if noise is None else noise)
    weights = weights_of(field.density, intervals(t, rays.directions, config.last_interval))
    opacity = jnp.sum(weights, -1)
    depth = jnp.sum(weights * t, -1) / jnp.maximum(opacity, 1e-6)
    features = composite(weights, field.features)
    if config.view in ("deferred", "none"):
        assert not isinstance(model.view, NerfHead)
        diffuse = composite(weights, field.diffuse)
        picture = shade(model.view, diffuse, features, opacity, depth, rays.viewdirs, facts.background)
        return picture, field.density, weights
    # the baselines: a colour that depends on direction at every sample
    if isinstance(model.view, NerfHead):
        diffuse = colours = apply_nerf_head(model.view, trunk, rays.viewdirs, config)
    else:
        assert model.view is not None
        viewdirs = jnp.broadcast_to(rays.viewdirs[:, None], points.shape)
        diffuse = field.diffuse
        colours = diffuse + apply_view_mlp(model.view, diffuse, field.features, viewdirs)
    rgb, diffuse = (over_background(composite(weights, c), opacity, facts.background) for c in (colours, diffuse))
    return RenderOutput(rgb, diffuse, features, opacity, depth), field.density, weights
