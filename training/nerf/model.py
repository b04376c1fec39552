"""The paper's models: MLP_Theta, which maps a point in space to density, diffuse colour and features (SNeRG equation 4, sections
4.2 and 6), the heads of the baselines, and a batch of rays through a coarse and a fine one (section 4.1; NeRF section 5.2).

Notation: p [..., 3] points of the training frame; gamma(p) [..., 63] their encoding; D layers of W channels with ReLU. The
encoding is concatenated again behind layer `skip_after`. One linear head follows the trunk, of as many of these as
NerfConfig.view asks for: density (1, ReLU), diffuse (3, sigmoid), features (4, sigmoid).

The hidden layers' products may be of bfloat16 numbers; sums are float32, and so are the encoding's own weights (2^9 p needs
more than 8 bits) and the head.

N rays, K coarse and F fine samples. Each of the two models has a field and a view-dependent head of its own (as in the release),
and the fine field is asked at all K + F positions. Per ray: t [N, K] sorted positions in [near, far]; weight [N, K] of the coarse
samples; u in [0, 1) quantiles; jitter in [0, 1). Without jitter, as rendering samples, nothing is random.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from scenepack.constants import FEATURES, VIEW_FREQUENCIES
from training import rendering
from training.config import NerfConfig
from training.dataset import SceneFacts
from training.method import FieldOutput, Rays, RenderOutput, ViewMlpParams

POINT_DEGREES = 10  # of gamma: sin(2^0 p) ... sin(2^9 p)
CONDITION_WIDTH = 128  # channels of JAXNeRF's layer behind the viewing direction
HEAD_OUTPUTS = {"deferred": 1 + 3 + FEATURES, "tiny": 1 + 3 + FEATURES, "none": 1 + 3, "nerf": 1}
EMPTY_BIN = 1e-5  # least weight of a bin


class Dense(NamedTuple):
    """x @ weight + bias; weight [in, out]."""

    weight: jax.Array
    bias: jax.Array


class FieldParams(NamedTuple):
    trunk: tuple[Dense, ...]  # D hidden layers
    head: Dense  # the linear layer of HEAD_OUTPUTS


class NerfHead(NamedTuple):
    """JAXNeRF's colour."""

    bottleneck: Dense  # linear, W channels; the encoded viewing direction beside it
    hidden: Dense  # CONDITION_WIDTH with ReLU
    rgb: Dense  # 3 with sigmoid


def init_field(key: jax.Array, config: NerfConfig) -> FieldParams:
    """Glorot-uniform weights and zero biases (JAXNeRF)."""
    encoded = 3 * (1 + 2 * POINT_DEGREES)
    keys = jax.random.split(key, config.depth + 1)
    layers, width = [], encoded
    for layer in range(config.depth):
        layers.append(init_dense(keys[layer], width, config.width))
        width = config.width + (encoded if layer == config.skip_after else 0)
    return FieldParams(tuple(layers), init_dense(keys[-1], width, HEAD_OUTPUTS[config.view]))


def init_nerf_head(key: jax.Array, width: int) -> NerfHead:
    """A head for a trunk of `width` channels."""
    inputs = (width, width + 3 * (1 + 2 * VIEW_FREQUENCIES), CONDITION_WIDTH)
    sizes = zip(jax.random.split(key, 3), inputs, (width, CONDITION_WIDTH, 3), strict=True)
    return NerfHead(*(init_dense(*size) for size in sizes))


def init_dense(key: jax.Array, inputs: int, outputs: int) -> Dense:
    return Dense(jax.nn.initializers.glorot_uniform()(key, (inputs, outputs)), jnp.zeros(outputs))


def apply_trunk(params: FieldParams, points: jax.Array, config: NerfConfig) -> jax.Array:
    """The last hidden layer [..., W] (and the encoding behind it, where the skip comes last) at points [..., 3]."""
    encoded = rendering.encode(points, POINT_DEGREES)
    x = jax.nn.relu(encoded @ params.trunk[0].weight + params.trunk[0].bias)
    joined = config.skip_after == 0  # whether the encoding stands beside x
    for layer, (weight, bias) in enumerate(params.trunk[1:], start=1):
        product = _product(x, weight[: x.shape[-1]], config)
        if joined:
            product += encoded @ weight[x.shape[-1] :]
        x = jax.nn.relu(product + bias)
        joined = layer == config.skip_after
    return jnp.concatenate([x, encoded], axis=-1) if joined else x


def field_of(params: FieldParams, trunk: jax.Array, density_noise: jax.Array | float = 0.0) -> FieldOutput:
    """The field from its last hidden layer, 0 where the head lacks an output; density_noise [...] is added before the ReLU."""
    raw = trunk @ params.head.weight + params.head.bias
    outputs = raw.shape[-1]
    none = jnp.zeros((*raw.shape[:-1], FEATURES), raw.dtype)
    return FieldOutput(
        density=jax.nn.relu(raw[..., 0] + density_noise),
        diffuse=jax.nn.sigmoid(raw[..., 1:4]) if outputs >= 4 else none[..., :3],
        features=jax.nn.sigmoid(raw[..., 4:]) if outputs > 4 else none,
    )


def apply_nerf_head(head: NerfHead, trunk: jax.Array, viewdirs: jax.Array, config: NerfConfig) -> jax.Array:
    """Colours [N, S, 3] of samples with hidden layer trunk [N, S, W] seen along viewdirs [N, 3]."""
    bottleneck = _product(trunk, head.bottleneck.weight, config) + head.bottleneck.bias
    width = bottleneck.shape[-1]
    seen = rendering.encode(viewdirs, VIEW_FREQUENCIES) @ head.hidden.weight[width:]  # once a ray
    x = jax.nn.relu(_product(bottleneck, head.hidden.weight[:width], config) + seen[:, None] + head.hidden.bias)
    return jax.nn.sigmoid(x @ head.rgb.weight + head.rgb.bias)


def _product(x: jax.Array, weight: jax.Array, config: NerfConfig) -> jax.Array:
    """x @ weight in NerfConfig.matmul ("auto" is settled by then), summed in float32."""
    if config.matmul != "bfloat16":
        return x @ weight
    return jnp.matmul(x.astype(jnp.bfloat16), weight.astype(jnp.bfloat16), preferred_element_type=jnp.float32)


# --- rays through both models ------------------------------------------------------------------------------------------


class ModelParams(NamedTuple):
    """One field and what depends on direction: a view MLP (deferred, tiny), JAXNeRF's head (nerf), None (none)."""

    field: FieldParams
    view: ViewMlpParams | NerfHead | None


class NerfParams(NamedTuple):
    """The two models of hierarchical sampling; the fine one is what gets baked."""

    coarse: ModelParams
    fine: ModelParams


class Rendered(NamedTuple):
    """What the loss needs: both pictures, and the densities of both fields at the coarse samples, without noise."""

    coarse: RenderOutput
    fine: RenderOutput
    coarse_sigma: jax.Array  # [N, K]
    fine_sigma: jax.Array  # [N, K + F], 0 at the fine samples, which the sparsity loss must not see


class Perturbation(NamedTuple):
    """How N rays are perturbed while training. Drawn for a whole batch, so that no result depends on how it is cut or spread."""

    coarse: jax.Array  # [N, K] jitter of positions
    fine: jax.Array  # [N, F]
    coarse_noise: jax.Array | None  # [N, K] on raw density
    fine_noise: jax.Array | None  # [N, K + F]


def draw_perturbation(key: jax.Array, count: int, config: NerfConfig) -> Perturbation:
    keys = jax.random.split(key, 4)
    coarse, fine, scale = config.coarse_samples, config.fine_samples, config.density_noise
    noise = [
        scale * jax.random.normal(k, (count, samples)) if scale > 0 else None
        for k, samples in ((keys[2], coarse), (keys[3], coarse + fine))
    ]
    jitter = [jax.random.uniform(k, (count, samples)) for k, samples in ((keys[0], coarse), (keys[1], fine))]
    return Perturbation(*jitter, *noise)


def init_nerf(key: jax.Array, config: NerfConfig) -> NerfParams:
    def model(k_field: jax.Array, k_view: jax.Array) -> ModelParams:
        view = None
        if config.view != "none":
            view = init_nerf_head(k_view, config.width) if config.view == "nerf" else rendering.init_view_mlp(k_view)
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
    both = jnp.concatenate([t, fine_t], axis=-1)
    order = jnp.argsort(both, axis=-1)
    t, is_coarse = jnp.take_along_axis(both, order, axis=-1), order < t.shape[-1]
    fine, fine_sigma, _ = _render_model(params.fine, rays, t, config, facts, fine_noise)
    return Rendered(coarse, fine, coarse_sigma, jnp.where(is_coarse, fine_sigma, 0.0))


def _render_model(
    model: ModelParams, rays: Rays, t: jax.Array, config: NerfConfig, facts: SceneFacts, noise: jax.Array | None
) -> tuple[RenderOutput, jax.Array, jax.Array]:
    """One model at positions t [N, S]: its picture, densities without noise [N, S] and weights [N, S]."""
    points = rays.origins[:, None] + t[..., None] * rays.directions[:, None]
    trunk = apply_trunk(model.field, points, config)
    field = field_of(model.field, trunk)
    density = field.density if noise is None else field_of(model.field, trunk, noise).density
    weights = rendering.weights_of(
        density, rendering.intervals(t, rays.directions, last_interval(t, rays, config, facts))
    )
    opacity = jnp.sum(weights, -1)
    if config.view in ("deferred", "none"):
        assert not isinstance(model.view, NerfHead)
        diffuse, features = rendering.composite(weights, field.diffuse), rendering.composite(weights, field.features)
        picture = rendering.shade(model.view, diffuse, features, opacity, rays.viewdirs, facts.background)
        return picture, field.density, weights
    # the baselines: a colour that depends on direction at every sample
    if isinstance(model.view, NerfHead):
        colours = apply_nerf_head(model.view, trunk, rays.viewdirs, config)
    else:
        assert model.view is not None
        viewdirs = jnp.broadcast_to(rays.viewdirs[:, None], points.shape)
        colours = field.diffuse + rendering.apply_view_mlp(model.view, field.diffuse, field.features, viewdirs)
    rgb = rendering.over_background(rendering.composite(weights, colours), opacity, facts.background)
    return RenderOutput(rgb, opacity), field.density, weights


def last_interval(t: jax.Array, rays: Rays, config: NerfConfig, facts: SceneFacts) -> jax.Array | float:
    """What the last of the samples t [N, S] stands for, in units of t: see NerfConfig.last_interval."""
    if config.last_interval is not None:
        return config.last_interval
    return rendering.LAST_INTERVAL if facts.ndc_camera is None else rays.far[:, None] - t[:, -1:]


# --- where along a ray a field is asked (NeRF 5.2) ---------------------------------------------------------------------


def coarse_samples(
    jitter: jax.Array | None, near: jax.Array, far: jax.Array, count: int, disparity: bool = False
) -> jax.Array:
    """t [N, count], evenly spread over [near, far] (in 1/t with disparity), moved within its interval by jitter [N, count]."""
    share = jnp.linspace(0.0, 1.0, count)
    near, far = near[:, None], far[:, None]
    t = 1.0 / ((1.0 - share) / near + share / far) if disparity else near * (1.0 - share) + far * share
    if jitter is None:
        return t
    middle = 0.5 * (t[:, 1:] + t[:, :-1])
    low = jnp.concatenate([t[:, :1], middle], axis=-1)
    high = jnp.concatenate([middle, t[:, -1:]], axis=-1)
    return low + (high - low) * jitter


def fine_samples(jitter: jax.Array | None, t: jax.Array, weights: jax.Array, count: int) -> jax.Array:
    """t [N, count], sorted, drawn from the piecewise-constant density that the coarse weights [N, K] describe, without gradient.

    The inner weights stand for the intervals between the middles of the coarse t [N, K]. One sample to each of `count` equal
    intervals of quantiles.
    """
    edges, weights = 0.5 * (t[:, 1:] + t[:, :-1]), weights[:, 1:-1]
    # An even trifle everywhere (NeRF's): empty rays sample evenly instead of dividing by 0, and a quantile crosses an empty
    # bin over many floats, so that the last bit of a sum, which differs between devices, moves no sample far.
    weights = weights + EMPTY_BIN
    cdf = jnp.cumsum(weights / jnp.sum(weights, axis=-1, keepdims=True), axis=-1)
    cdf = jnp.concatenate([jnp.zeros_like(cdf[:, :1]), jnp.minimum(cdf[:, :-1], 1.0), jnp.ones_like(cdf[:, :1])], -1)
    within_interval = 0.5 if jitter is None else jitter
    u = jnp.broadcast_to((jnp.arange(count) + within_interval) / count, (weights.shape[0], count))
    return jax.lax.stop_gradient(jax.vmap(jnp.interp)(u, cdf, edges))
