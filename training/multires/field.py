"""The field's definition in JAX: features of several resolutions, one small decoder, compositing, and the loss.

Per point u of the unit cube: x = trilinear features of all levels, 4 each, concatenated and padded to I, a multiple of 8;
raw = relu(x w0 + b0) w1 + b1. Density is e^min(raw_0, LARGEST_RAW) per side of the cube; colours and features are
sigmoid(raw_1..7). Levels as in instant-ngp (Müller et al. 2022); the head and the background rule are SNeRG's (section 4.2).

Parameters are one flat array: w0 [I, 64], b0, w1 [64, 8], b1, then weights and biases of the view MLP layer by layer.
Notation: N rays, S samples in ray order (training.marching).
"""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from scenepack.constants import TRANSMITTANCE_SHADED, TRANSMITTANCE_STOP, VIEW_FREQUENCIES, VIEW_MLP_WIDTHS
from training.marching import MarchSizes, Samples, sums_along_rays, transmittance
from training.method import RenderOutput, ViewMlpParams
from training.multires.levels import FEATURES, Level, rows_at
from training.multires.settings import LARGEST_RAW, Settings
from training.rendering import alpha_of, apply_view_mlp

HIDDEN, OUTPUTS = 64, 8
VIEW_PARAMETERS = sum(inputs * outputs + outputs for inputs, outputs in pairwise(VIEW_MLP_WIDTHS))


def inputs_of(levels: int) -> int:
    """I: inputs of the decoder."""
    return -(-levels * FEATURES // 8) * 8


def decoder_size(inputs: int) -> int:
    return inputs * HIDDEN + HIDDEN + HIDDEN * OUTPUTS + OUTPUTS


def initial_parameters(levels: int, view_mlp: ViewMlpParams, random: np.random.Generator, octaves: int) -> np.ndarray:
    """Parameters float32 [P]: He-uniform decoder without biases; rows of inputs that do not exist are zero."""
    w0 = random.uniform(-1, 1, (inputs_of(levels), HIDDEN)) * np.sqrt(6 / (levels * FEATURES))
    w0[levels * FEATURES :] = 0
    w1 = random.uniform(-1, 1, (HIDDEN, OUTPUTS)) * np.sqrt(6 / (HIDDEN + OUTPUTS))
    decoder = [w0, np.zeros(HIDDEN), w1, np.zeros(OUTPUTS)]
    layers = [np.asarray(part) for pair in zip(view_mlp.weights, view_mlp.biases, strict=True) for part in pair]
    layers[0] = layers[0] * seen_inputs(octaves)[:, None]
    return np.concatenate([part.ravel() for part in (*decoder, *layers)]).astype(np.float32)


def seen_inputs(octaves: int) -> np.ndarray:
    """bool [34]: which inputs of the view MLP are used, where it sees so many octaves of the direction."""
    seen = np.ones(VIEW_MLP_WIDTHS[0], bool)
    for start in (3, 3 + 3 * VIEW_FREQUENCIES):  # sines, then cosines, three for each octave
        seen[start + 3 * octaves : start + 3 * VIEW_FREQUENCIES] = False
    return seen


def split_parameters(flat: jax.Array, inputs: int) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array, ViewMlpParams]:
    """w0, b0, w1, b1 and the view MLP that lie in a flat array of NumPy or JAX."""
    shapes = [(inputs, HIDDEN), (HIDDEN,), (HIDDEN, OUTPUTS), (OUTPUTS,)]
    for wide, narrow in pairwise(VIEW_MLP_WIDTHS):
        shapes += [(wide, narrow), (narrow,)]
    parts, start = [], 0
    for shape in shapes:
        size = int(np.prod(shape))
        parts.append(flat[start : start + size].reshape(shape))
        start += size
    w0, b0, w1, b1, *layers = parts
    return w0, b0, w1, b1, ViewMlpParams(tuple(layers[::2]), tuple(layers[1::2]))  # type: ignore[arg-type]


def view_mlp_of(parameters: jax.Array, settings: Settings) -> ViewMlpParams | None:
    """The view MLP that lies in parameters [P]; None for a diffuse model."""
    inputs = inputs_of(len(settings.resolutions))
    return split_parameters(parameters, inputs)[-1] if settings.own.view_dependence else None


def corners(level: Level, maps: jax.Array, points: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Rows int32 [N, 8] of the vertices around points [N, 3] of the unit cube, and their weights [N, 8]."""
    place = points * level.resolution
    cell = jnp.clip(place.astype(jnp.int32), 0, level.resolution - 1)
    ahead = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)], np.int32)
    x, y, z = jnp.moveaxis(cell[:, None] + ahead, -1, 0)
    fraction = place - cell
    shares = jnp.stack([1.0 - fraction, fraction], axis=-1)  # [N, 3, 2]
    weights = shares[:, 2, :, None, None] * shares[:, 1, None, :, None] * shares[:, 0, None, None, :]
    return rows_at(level, maps, x, y, z), weights.reshape(-1, 8)


def encode(table: jax.Array, levels: tuple[Level, ...], maps: jax.Array, points: jax.Array) -> jax.Array:
    """x [N, I] at points [N, 3] of the unit cube; zero for a level that has not joined."""
    parts = []
    for level in levels:
        if level.offset < 0:
            parts.append(jnp.zeros((len(points), FEATURES)))
        else:
            ids, weights = corners(level, maps, points)
            parts.append(jnp.einsum("nk,nkc->nc", weights, table[ids], precision=jax.lax.Precision.HIGHEST))
    padding = inputs_of(len(levels)) - FEATURES * len(levels)
    return jnp.concatenate([*parts, jnp.zeros((len(points), padding))], axis=-1)


def decode(parameters: jax.Array, x: jax.Array) -> jax.Array:
    """raw [N, 8] of inputs x [N, I]."""
    w0, b0, w1, b1, _ = split_parameters(parameters, x.shape[1])
    highest = jax.lax.Precision.HIGHEST
    return jnp.matmul(jax.nn.relu(jnp.matmul(x, w0, precision=highest) + b0), w1, precision=highest) + b1


@jax.custom_vjp
def clamped(raw: jax.Array) -> jax.Array:
    """min(raw, LARGEST_RAW). Beyond, the gradient only counts where it leads back."""
    return jnp.minimum(raw, LARGEST_RAW)


def _clamped_backward(raw: jax.Array, slope: jax.Array) -> tuple[jax.Array]:
    return (jnp.where((raw < LARGEST_RAW) | (slope > 0), slope, 0.0),)


clamped.defvjp(lambda raw: (clamped(raw), raw), _clamped_backward)


def activate(raw: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Density [N] per side of the cube, and colours and features [N, 7], of raw [N, 8]."""
    return jnp.exp(clamped(raw[:, 0])), jax.nn.sigmoid(raw[:, 1:])


def composite(
    density: jax.Array, values: jax.Array, samples: Samples, lengths: jax.Array, count: int, per_ray: int
) -> tuple[jax.Array, jax.Array, jax.Array]:  # fmt: skip
    """What N rays gather [N, 8] (colours and features, T behind all), the weights [S], and which samples count.

    lengths [N]: of a step, in sides of the cube. A ray ends behind the sample at which less than TRANSMITTANCE_STOP is left.
    """
    tau = density * lengths[samples.ray]
    before, _ = transmittance(samples, tau, count, per_ray)
    counted = samples.valid & (jax.lax.stop_gradient(before) >= TRANSMITTANCE_STOP)
    tau = jnp.where(counted, tau, 0.0)
    before, behind = transmittance(samples, tau, count, per_ray)
    weights = jnp.where(samples.valid, before * alpha_of(tau, 1.0), 0.0)
    sums = jnp.zeros((count, 7)).at[samples.ray].add(weights[:, None] * values)
    return jnp.concatenate([sums, behind[:, None]], axis=-1), weights, counted


def shade(
    gathered: jax.Array, view_mlp: ViewMlpParams | None, viewdirs: jax.Array, background: jax.Array
) -> RenderOutput:  # fmt: skip
    """Colours of N rays that have gathered [N, 8], over a background [N, 3] or [3]. Nothing is clamped."""
    behind = gathered[:, 7]
    diffuse = gathered[:, :3] + behind[:, None] * background
    rgb = diffuse
    if view_mlp is not None:
        residual = apply_view_mlp(view_mlp, diffuse, gathered[:, 3:7], viewdirs)
        rgb = diffuse + residual * (behind <= TRANSMITTANCE_SHADED)[:, None]
    return RenderOutput(rgb, 1.0 - behind)


def distortion(samples: Samples, weights: jax.Array, step: jax.Array, count: int, per_ray: int) -> jax.Array:
    """Sum over rays of sum_kl w_k w_l |t_k - t_l| + sum_k w_k² step / 3 (mip-NeRF 360, equation 15); t and step alike.

    By running sums, as DVGO v2 (Sun et al. 2022).
    """

    def before(values: jax.Array) -> jax.Array:
        return sums_along_rays(samples, values, count, per_ray)[0] - values

    first = jnp.zeros(count).at[jnp.where(samples.rank == 0, samples.ray, count)].set(samples.t, mode="drop")
    t = samples.t - first[samples.ray]
    pairs = 2.0 * weights * (t * before(weights) - before(weights * t))
    return jnp.where(samples.valid, pairs + jnp.square(weights) * step / 3.0, 0.0).sum()


def roughness(
    table: jax.Array, parameters: jax.Array, levels: tuple[Level, ...], maps: jax.Array, pairs: jax.Array
) -> jax.Array:  # fmt: skip
    """Means [2] over pairs of points [M, 2, 3] of the unit cube: the squared difference of ln(1 + optical depth of a cell of the
    finest level), and those of colours and features, summed."""
    x = encode(table, levels, maps, pairs.reshape(-1, 3))
    density, values = activate(decode(parameters, x))
    depth, values = jnp.log1p(density / levels[-1].resolution).reshape(-1, 2), values.reshape(-1, 2, OUTPUTS - 1)
    of_depth, of_values = jnp.square(depth[:, 0] - depth[:, 1]), jnp.square(values[:, 0] - values[:, 1])
    return jnp.stack([of_depth.mean(), of_values.sum(-1).mean()])


class Target(NamedTuple):
    """What N rays should show."""

    viewdirs: jax.Array  # [N, 3], as the next two
    colours: jax.Array
    background: jax.Array
    step_lengths: jax.Array  # [N]: distance between a ray's samples, in sides of the cube
    side: jax.Array  # []: world units of one
    shares: jax.Array  # [S]: of its gradient that each sample keeps


def loss(
    table: jax.Array, parameters: jax.Array, levels: tuple[Level, ...], maps: jax.Array, samples: Samples, target: Target,
    pairs: jax.Array, step_cells: jax.Array, sizes: MarchSizes, settings: Settings,
) -> tuple[jax.Array, dict[str, jax.Array]]:  # fmt: skip
    """The loss of a batch's samples, and its metrics: the mean, over rays that have samples, of squared error, distortion
    and SNeRG's sparsity loss (section 4.3), the last over all that is in the way of a ray, and roughness of pairs of points."""
    count = target.colours.shape[0]
    x = encode(table, levels, maps, samples.g / settings.resolution)
    raw = decode(parameters, x)
    fixed = jax.lax.stop_gradient(raw)
    density, values = activate(fixed + target.shares[:, None] * (raw - fixed))
    gathered, weights, lit = composite(density, values, samples, target.step_lengths, count, sizes.per_ray)
    rgb = shade(gathered, view_mlp_of(parameters, settings), target.viewdirs, target.background).rgb
    counted = (samples.complete & (samples.counts > 0))[:, None]
    total = jnp.maximum(counted.sum(), 1)
    colour = jnp.where(counted, jnp.square(rgb - target.colours), 0.0).sum() / total
    clipped = jnp.square(jnp.clip(rgb, 0, 1) - target.colours)
    spread = distortion(samples, weights, step_cells, count, sizes.per_ray) / settings.resolution / total
    penalty = jnp.log1p(jnp.square(density / target.side) / settings.sparsity_scale) * target.step_lengths[samples.ray]
    sparsity = settings.sparsity * target.side * jnp.where(lit, penalty, 0.0).sum() / total
    metrics = {
        "mse": jnp.where(counted, clipped, 0.0).sum() / (3 * total),
        "distortion": settings.by_kind.distortion_weight * spread,
        "sparsity": sparsity,
    }
    total_loss = colour + settings.by_kind.distortion_weight * spread + sparsity
    if pairs.shape[0]:
        metrics["smoothness"] = roughness(table, parameters, levels, maps, pairs) @ jnp.asarray(settings.smoothness)
        total_loss += metrics["smoothness"]
    metrics |= {"rays": total, "samples": samples.valid.sum()}
    return total_loss, metrics
