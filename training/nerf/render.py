"""A batch of rays through the coarse and the fine model (SNeRG sections 4.1 and 4.2; NeRF section 5.2).

Notation: N rays, K coarse and F fine samples. Each of the two models has a field and a view MLP of its own
(as in the release), and the fine field is asked at all K + F positions.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from training.config import NerfConfig
from training.dataset import SceneFacts
from training.method import Rays, RenderOutput, ViewMlpParams
from training.nerf.field import FieldParams, apply_field, init_field
from training.nerf.sampling import coarse_samples, fine_samples, merge_samples
from training.view_mlp import init_view_mlp
from training.volume import composite, intervals, shade, weights_of


class ModelParams(NamedTuple):
    """One field and its view MLP (None in the diffuse ablation)."""

    field: FieldParams
    view: ViewMlpParams | None


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


def init_nerf(key: jax.Array, config: NerfConfig) -> NerfParams:
    """Fresh parameters of both models."""
    keys = jax.random.split(key, 4)
    models = [
        ModelParams(init_field(k_field, config), init_view_mlp(k_view) if config.view_dependence else None)
        for k_field, k_view in (keys[:2], keys[2:])
    ]
    return NerfParams(*models)


def render_rays(
    params: NerfParams, rays: Rays, config: NerfConfig, facts: SceneFacts, key: jax.Array | None = None
) -> Rendered:
    """Renders N rays. With a key, positions are jittered and density noise is added; without, all is deterministic."""
    keys = (None,) * 4 if key is None else tuple(jax.random.split(key, 4))
    t = coarse_samples(keys[0], rays.near, rays.far, config.coarse_samples, facts.disparity)
    coarse, coarse_sigma, weights = _render_model(params.coarse, rays, t, config, facts, keys[1])
    fine_t = fine_samples(keys[2], t, weights, config.fine_samples)
    t, is_coarse = merge_samples(t, fine_t)
    fine, fine_sigma, _ = _render_model(params.fine, rays, t, config, facts, keys[3])
    return Rendered(coarse, fine, coarse_sigma, jnp.where(is_coarse, fine_sigma, 0.0))


def _render_model(
    model: ModelParams, rays: Rays, t: jax.Array, config: NerfConfig, facts: SceneFacts, key: jax.Array | None
) -> tuple[RenderOutput, jax.Array, jax.Array]:
    """One model at positions t [N, S]: its picture, densities [N, S] and weights [N, S]."""
    points = rays.origins[:, None] + t[..., None] * rays.directions[:, None]
    noise: jax.Array | float = 0.0
    if key is not None and config.density_noise > 0:
        noise = config.density_noise * jax.random.normal(key, t.shape)
    field = apply_field(model.field, points, config.skip_after, noise)
    weights = weights_of(field.density, intervals(t, rays.directions))
    opacity = jnp.sum(weights, -1)
    picture = shade(
        model.view,
        composite(weights, field.diffuse),
        composite(weights, field.features),
        opacity,
        jnp.sum(weights * t, -1) / jnp.maximum(opacity, 1e-6),
        rays.viewdirs,
        facts.background,
    )
    return picture, field.density, weights
