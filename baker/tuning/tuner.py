"""Fine-tuning of the stored voxels and the view MLP together, on exactly what the viewer shows (beyond SNeRG section 5.6).

The paper trains the view MLP on against the grid as quantising left it. Here the grid moves, too: every step takes the
viewer's own samples of some training rays from the voxels *as rounded to 8 bits*, and its gradient moves what is behind them (a
straight-through estimator). What is optimised is what is shown.

A voxel of a fine grid is met by a handful of rays, and learns their noise by heart. So the voxels of a cell of a few
voxels a side move together: each cell adds to the straight colours and features of its voxels, and scales their density.
For the same reason Adam's denominator has a floor, the mean over all cells: what has hardly any gradient hardly moves.

    loss = mean over rays of |shown - photograph|²

Notation: K cells, numbered from 1 in the grid's order (z slowest); row 0 of any table of cells stands for what is empty.
"""

from __future__ import annotations

import importlib
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from baker.tuning.marcher import Accumulated, compiled_loops
from baker.tuning.pack_layout import over_background
from scenepack.codecs.steps import EXACT, Steps
from scenepack.constants import TRANSMITTANCE_SHADED
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.method import ViewMlpParams
from training.view_mlp import apply_view_mlp

BETAS = (0.9, 0.99)
TINY = 1e-12  # keeps Adam's denominator from zero
TOP = 254.75  # stands for an alpha of 255, whose optical depth would be infinite
PROBE_RAYS = 4096  # rays whose samples tell how many rays fill a step
ROOM = 1.15  # of lists over the mean


class Look(NamedTuple):
    """How rays are compared with photographs. ndc: a forward-facing scene. by_opacity: errors are weighted by the pack's own
    opacity, since photographs also show what lies outside of its box."""

    ndc: bool
    by_opacity: bool


# What is added to a voxel's colour, in coarse steps, before it is rounded down (ordered dithering, in three dimensions), by
# whether its place in the grid is odd: x + 2 y + 4 z. What is rounded up and down cancels along a ray: on the demo, errors of
# steps of 4 are 2.6 dB below those of plain rounding. Features, which a view MLP bends, gain nothing by that.
DITHER = ((np.array([0, 4, 6, 2, 5, 1, 3, 7]) + 0.5) / 8).astype(np.float32)


class Trained(NamedTuple):
    """delta float32 [K + 1, 8]: what each cell adds to straight colours (0 … 2) and features (4 … 7), and to log density (3).
    head: the view MLP, None for a diffuse pack. Of NumPy or of JAX."""

    delta: jax.Array
    head: ViewMlpParams | None


class Tuner(Protocol):
    """rays: how many a step takes; known once `fill` was called."""

    rays: int

    def fill(self, ids: np.ndarray, samples: int, seed: int) -> None:
        """Sets `rays`, so that a step on such rays takes about so many samples."""
        ...

    def update(self, ids: np.ndarray, rates: np.ndarray, count: int) -> None:
        """One step of Adam on the rays `ids` int32 [rays]; rates float32 [9]: of the 8 parts of delta, and of the view MLP.
        count: steps so far."""
        ...

    def score(self, ids: np.ndarray) -> tuple[float, float]:
        """(PSNR of the clamped picture, contributing samples a ray) over the rays `ids`."""
        ...

    def snapshot(self) -> Trained:
        """What is trained, as it is now; later steps leave it alone."""
        ...

    def tuned(self, snapshot: Trained) -> Pack:
        """The pack as a snapshot has it. The last that is asked of a tuner."""
        ...


def make_tuner(pack: Pack, dataset: RayDataset, cell: int, *, by_opacity: bool = False, steps: Steps = EXACT) -> Tuner:
    """By compiled loops on a processor, where Numba is, and by JAX elsewhere. cell: voxels a side of a cell.
    steps: of what is stored.

    The pack's arrays must be writable, and may be changed as the tuner goes on.
    """
    name = "fused.tuner" if compiled_loops() else "jax_tuner"
    return importlib.import_module(f"baker.tuning.{name}").tuner_of(
        pack, dataset, cell, Look(pack.ndc, by_opacity), steps
    )


def shown(
    sums: Accumulated, head: ViewMlpParams | None, viewdirs: jax.Array, background: tuple[float, ...], ndc: bool
) -> jax.Array:
    """[R, 3] what the viewer makes of accumulated rays (docs/rendering.md, "Shading"), above 1 not yet clamped."""
    diffuse, features, behind = over_background(sums, background, ndc)
    if head is None:
        return diffuse
    residual = apply_view_mlp(head, diffuse, features, viewdirs)
    return diffuse + residual * (behind <= TRANSMITTANCE_SHADED)[:, None]


def squared_error(
    sums: Accumulated, head: ViewMlpParams | None, viewdirs: jax.Array, target: jax.Array, whole: jax.Array,
    background: tuple[float, ...], look: Look, *, clamped: bool,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """Sum over the rays that are `whole` bool [R], of what they accumulated, and of their weights.

    clamped: as on a screen; else colours below 0 still have a slope.
    """
    rgb = shown(sums, head, viewdirs, background, look.ndc)
    rgb = jnp.clip(rgb, 0, 1) if clamped else jnp.minimum(rgb, 1.0)
    opacity = jax.lax.stop_gradient(1.0 - sums.transmittance) if look.by_opacity else 1.0
    weight = jnp.where(whole, opacity, 0.0)
    return jnp.square(weight[:, None] * (rgb - target)).sum(), jnp.square(weight).sum()


def adam_head(
    head: ViewMlpParams, slope: ViewMlpParams, first: ViewMlpParams, second: ViewMlpParams, rate: jax.Array, count: jax.Array
) -> tuple[ViewMlpParams, ViewMlpParams, ViewMlpParams]:  # fmt: skip
    """A step of Adam on the view MLP: itself and its moments. count: steps so far."""
    one, two = BETAS
    rate = rate * bias_correction(count)
    first = jax.tree.map(lambda m, g: one * m + (1 - one) * g, first, slope)
    second = jax.tree.map(lambda v, g: two * v + (1 - two) * jnp.square(g), second, slope)
    head = jax.tree.map(lambda a, m, v: a - rate * m / (jnp.sqrt(v) + TINY), head, first, second)
    return head, first, second


def bias_correction(count: jax.Array | int) -> jax.Array:
    """What Adam's rate is multiplied by after `count` steps."""
    steps = jnp.asarray(count, jnp.float32) + 1.0
    return jnp.sqrt(1 - BETAS[1] ** steps) / (1 - BETAS[0] ** steps)


def psnr_of(error: float, weight: float) -> float:
    """PSNR of a sum of squared errors over colours of rays of so much weight, in dB."""
    return float(-10 * np.log10(max(error, 1e-12) / max(3 * weight, 1.0)))
