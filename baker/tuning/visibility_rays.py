"""Visibility rays: the rays by which pruning learns what photographs show of a pack (baker.tuning.pruning).

Of each photograph they are a lattice, begun at a random place. Its step follows the grid, not the pixels: SPACING voxels
where the photographs see surfaces. A surface that is seen at 45 degrees is met by some ray within about `spacing` voxels of
any of its points, in the worst corner of the lattice, and a sample lights the voxels within one of it. Most are seen from
straighter ahead, or by several photographs, so light is taken to reach spacing - 2 voxels further: `reach`. Rays that meet
no content are not marched. Their number grows with the surface in view alone, and beyond MOST_RAYS the step grows instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, sqrt
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from baker.tuning.marcher import PackMarcher
from training.dataset import RayDataset
from training.marching.layout import GridBox
from training.marching.rays import GridFrameRays, grid_points, to_grid

SPACING = 3.0  # voxels between neighbouring rays
MOST_RAYS = 12_000_000  # that meet content
PILOTS = 16_384  # rays that tell how many voxels wide pixels are
FEW_WIDER = 0.9  # share of the pilots whose pixels are no wider than what is taken for the width
LOOKED_AT = 1_048_576  # places at once that are tested for content


class VisibilityRays(NamedTuple):
    """Rays: ids int32 [N] of pixels and pixel_offset float32 [N, 2], in pixels from their centres. reach: see above."""

    ids: np.ndarray
    pixel_offset: np.ndarray
    reach: int


def visibility_rays_of(marcher: PackMarcher, dataset: RayDataset, seed: int) -> VisibilityRays | None:
    """The rays; None where no photograph sees anything."""
    rng = np.random.default_rng(seed)
    pilots = rng.integers(0, dataset.count, max(8 * PILOTS, 1), np.int32)
    meets = marcher.meets(pilots)
    if not meets.any():
        return None
    width = _pixel_width(marcher, np.resize(pilots[meets], PILOTS))
    if width is None:
        return None
    step, expected = SPACING / width, meets.mean() * dataset.count * (width / SPACING) ** 2
    wider = sqrt(max(expected / MOST_RAYS, 1.0))
    ids, pixel_offset = [], []
    for places, moved in _lattices(dataset, step * wider, rng):
        chosen = marcher.meets(places, moved)
        ids.append(places[chosen])
        pixel_offset.append(moved[chosen])
    reach = ceil(SPACING * wider - 2)
    return VisibilityRays(np.concatenate(ids), np.concatenate(pixel_offset), reach)


def _pixel_width(marcher: PackMarcher, ids: np.ndarray) -> float | None:
    """How many voxels apart the rays of neighbouring pixels are where they meet surfaces, for all but the widest pixels: at
    the last sample with half of the light or more."""
    depths = marcher.half_depths(ids)
    met = depths > 0
    if not met.any():
        return None
    widths = np.asarray(_widths(marcher.box, marcher.rays, jnp.asarray(ids), jnp.asarray(depths)))[met]
    return float(np.quantile(widths, FEW_WIDER))


@jax.jit
def _widths(box: GridBox, source: GridFrameRays, ids: jax.Array, depths: jax.Array) -> jax.Array:
    """float32 [N]: voxels from a ray to those of the next column and row, the wider of both, at depths [N] in voxels."""
    centre = jnp.zeros((ids.shape[0], 2))
    t = to_grid(box, source.geometry_at(ids, centre)).times(depths)

    def point(pixel_offset: jax.Array) -> jax.Array:
        rays = source.geometry_at(ids, pixel_offset)
        return grid_points(box, rays.origins + t[:, None] * rays.directions)

    at = point(centre)
    steps = [jnp.linalg.norm(point(centre + jnp.asarray(one)) - at, axis=-1) for one in ((1.0, 0.0), (0.0, 1.0))]
    return jnp.maximum(*steps)


def _lattices(dataset: RayDataset, step: float, rng: np.random.Generator) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """ids int32 [N] and pixel_offset float32 [N, 2] of a lattice over each photograph, `step` pixels apart, some at a time."""
    width, first = np.asarray(dataset.width), np.asarray(dataset.first)
    height = np.diff(np.append(first, dataset.count)) // width
    ids, pixel_offset, held = [], [], 0
    for view in range(dataset.views):
        w, h = int(width[view]), int(height[view])
        start = rng.random(2) * (min(step, w), min(step, h))
        y, x = np.meshgrid(np.arange(start[1], h, step), np.arange(start[0], w, step), indexing="ij")
        column, row = np.minimum(x.astype(np.int32), w - 1), np.minimum(y.astype(np.int32), h - 1)
        ids.append((first[view] + row * w + column).ravel().astype(np.int32))
        pixel_offset.append(np.stack([x - column - 0.5, y - row - 0.5], -1).reshape(-1, 2).astype(np.float32))
        held += x.size
        if held >= LOOKED_AT or view + 1 == dataset.views:
            yield np.concatenate(ids), np.concatenate(pixel_offset)
            ids, pixel_offset, held = [], [], 0
