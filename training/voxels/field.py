"""The field that raw voxel values stand for, and what a ray sees of it.

Per ray i, sample k: raw r(g) interpolated; sigma = softplus(r_0 + shift) / reference; colours and features sigmoid(r_1..7).
Activated after interpolation, as DVGO (Sun et al. 2022). The head and the background rule are SNeRG's (section 4.2).
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from scenepack.constants import TRANSMITTANCE_SHADED
from training.marching.march import MarchSizes, Samples, transmittance
from training.method import FieldOutput, RenderOutput, ViewMlpParams
from training.view_mlp import apply_view_mlp
from training.volume import alpha_of
from training.voxels.settings import Settings
from training.voxels.sparse_grid import GridLayout, cell_means, interpolate, with_depths


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


@partial(jax.jit, static_argnames="settings")
def query(rows: jax.Array, layout: GridLayout, points: jax.Array, settings: Settings) -> FieldOutput:
    """The field at world points [N, 3]; density 0 outside the box and where no voxel is present."""
    g = (points - layout.origin) / layout.voxel
    inside = jnp.all((g >= 0) & (g <= layout.dims), axis=-1)
    field = activate(interpolate(rows, layout, g), settings)
    return field._replace(density=jnp.where(inside & layout.has_support(g), field.density, 0.0))


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
    gathered = jnp.concatenate([sums[:, :7], behind[:, None], sums[:, 7:]], axis=-1)
    return shade(gathered, head, viewdirs, settings, background), field, weights


@partial(jax.jit, static_argnames="settings")
def shade(
    gathered: jax.Array, head: ViewMlpParams | None, viewdirs: jax.Array, settings: Settings,
    background: jax.Array | None = None,
) -> RenderOutput:  # fmt: skip
    """Colours of N rays that have gathered [N, 9]: colours and features (7), T behind all, weights times t (their depth)."""
    behind = gathered[:, 7]
    behind_all = jnp.asarray(settings.background) if background is None else background
    diffuse = gathered[:, :3] + behind[:, None] * behind_all
    rgb = diffuse
    if head is not None:
        residual = apply_view_mlp(head, diffuse, gathered[:, 3:7], viewdirs)
        rgb = diffuse + residual * (behind <= TRANSMITTANCE_SHADED)[:, None]
    return RenderOutput(rgb, diffuse, gathered[:, 3:7], 1.0 - behind, gathered[:, 8])


def finished(output: RenderOutput, scale: jax.Array | np.ndarray) -> RenderOutput:
    """What `shade` returns as a picture: colours in [0, 1], and the mean t of what each ray meets. scale [N]: voxels per t."""
    depth = output.depth / jnp.maximum(output.alpha, 1e-6) / scale
    return output._replace(rgb=jnp.clip(output.rgb, 0, 1), depth=depth)
