"""Rays through a grid, and their samples without empty space.

The grid is the occupancy grid of training.multires, or that of a bake that is culled (baker.baking.culling).

One rule for all that is compared with photographs, of fields and of packs alike (docs/rendering.md): a ray begins `near` from
its camera and ends where it leaves the grid's box. `far` is for the paper's method, which has no grid; boxes lie before it, but
for the outermost corners of a Blender scene's, where only mist of fields is cut off.

Frames: a grid's own (a pack's grid frame, say) and the training frame, in which a dataset makes its rays; they differ by
the rigid grid_T_training [4, 4]. Of the trainer's own voxels the two are one.
Where a grid is contracted (scenepack.contraction), a ray is a path of several straight pieces, as long as all of space.
Products of geometry ask for the highest precision: TF32, an NVIDIA GPU's default, moves a ray by 0.2 pixels of 800.

The march lists the samples of a batch of rays, with fixed length, in two passes: first one test per COARSE steps against the
dilated coarse occupancy, then one test per step against exact support. Both compact into lists of fixed size, so nothing
recompiles. Nothing is dropped silently: rays are taken in order until the list is full, and `complete` says which rays have all
their samples.

Notation: a grid of dims (Dx, Dy, Dz) voxels; voxel i covers [i, i+1) in grid coordinates g and its value sits at its centre,
i + 0.5. Its coarse occupancy has one byte for each COARSE³ voxels, 1 where a sample within COARSE/2 voxels of these could
have support.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from scenepack.contraction import Path, contract, path_of, time_at
from training.dataset import RayDataset
from training.method import Rays


class GridBox(NamedTuple):
    """Where a grid is, and no more."""

    origin: jax.Array  # [3] in world units
    voxel: jax.Array  # [] or [3] in world units
    dims: jax.Array  # int32 [3] = (x, y, z) voxels
    # []: of a contracted grid, half the side of its inner cube in world units (scenepack.contraction); None of others
    contraction: jax.Array | float | None = None


class GridFrameRays(NamedTuple):
    """The training rays in another grid's frame, without an end of their own."""

    source: RayDataset
    grid_T_training: jax.Array

    def geometry_at(self, ids: jax.Array, away: jax.Array | None = None) -> Rays:
        """Rays of int32 ids [N] in the grid frame, begun where they are in training and of any length; see RayDataset."""
        rays, T = self.source.geometry_at(ids, away), self.grid_T_training

        def turned(vectors: jax.Array) -> jax.Array:
            return jnp.matmul(vectors, T[:3, :3].T, precision=jax.lax.Precision.HIGHEST)

        far = jnp.full_like(rays.far, jnp.inf)  # viewdirs stay: the view MLP wants them as they are
        return rays._replace(origins=turned(rays.origins) + T[:3, 3], directions=turned(rays.directions), far=far)


class GridRays(NamedTuple):
    """Rays in grid coordinates, each of P straight pieces: one, unless the grid is contracted."""

    origins: jax.Array  # [N, P, 3]: on a piece, the point at distance s along the ray is origins + s directions
    directions: jax.Array  # [N, P, 3], unit length
    begins: jax.Array  # [N, P] voxels: where a piece begins; infinite where there is none
    start: jax.Array  # [N] voxels
    end: jax.Array  # [N] voxels
    scale: jax.Array  # [N] voxels per t; in a contracted grid, voxels per half side of the inner cube
    length: jax.Array  # [N] world units per voxel along the ray; in a contracted grid, units of contracted space
    path: Path | None = None

    def points(self, ray: jax.Array, s: jax.Array) -> jax.Array:
        """[..., 3]: where rays `ray` [...] are at distances s [...] voxels."""
        if self.begins.shape[1] == 1:
            return self.origins[ray, 0] + s[..., None] * self.directions[ray, 0]
        piece = jnp.maximum((self.begins[ray] <= s[..., None]).sum(-1), 1) - 1
        return self.origins[ray, piece] + s[..., None] * self.directions[ray, piece]

    def times(self, s: jax.Array) -> jax.Array:
        """t [N] of the rays at distances s [N] voxels."""
        return s / self.scale if self.path is None else time_at(self.path, s / self.scale, jnp)


def to_grid(box: GridBox, rays: Rays) -> GridRays:
    """Clips rays of the grid's frame to the grid's box, and measures them in voxels. Contracted rays begin at `near`."""
    if box.contraction is not None:
        return _contracted(box, rays, box.contraction)
    origins = (rays.origins - box.origin) / box.voxel
    directions = rays.directions / box.voxel
    scale = jnp.linalg.norm(directions, axis=-1)
    directions = directions / scale[:, None]
    safe = jnp.where(jnp.abs(directions) < 1e-9, 1e-9, directions)
    to_low, to_high = -origins / safe, (box.dims - origins) / safe
    start = jnp.maximum(jnp.minimum(to_low, to_high).max(-1), rays.near * scale)
    end = jnp.minimum(jnp.maximum(to_low, to_high).min(-1), rays.far * scale)
    length = jnp.linalg.norm(rays.directions, axis=-1) / scale
    return GridRays(origins[:, None], directions[:, None], jnp.zeros_like(start)[:, None], start, end, scale, length)


def _contracted(box: GridBox, rays: Rays, reach: jax.Array | float) -> GridRays:
    """Rays with unit directions as paths. reach: half the side of the inner cube."""
    path = path_of(rays.origins / reach, rays.directions / reach, rays.near, jnp)
    scale = jnp.broadcast_to(reach / box.voxel, (3,))[0]  # voxels are cubes
    origins = path.origins * scale - box.origin / box.voxel
    length = jnp.full_like(path.ends, reach / scale)
    return GridRays(
        origins, path.directions, path.starts * scale, jnp.zeros_like(path.ends), path.ends * scale,
        jnp.full_like(path.ends, scale), length, path,
    )  # fmt: skip


def grid_points(box: GridBox, points: jax.Array) -> jax.Array:
    """Points [N, 3] of the grid's frame in grid coordinates."""
    if box.contraction is not None:
        points = contract(points / box.contraction, jnp) * box.contraction
    return (points - box.origin) / box.voxel


# --- The march ---

COARSE = 4  # side of a coarse occupancy cell, in voxels


class Cells(NamedTuple):
    """The cells of an occupancy grid."""

    box: GridBox
    occupied: jax.Array  # uint8, flat, x fastest, of side³ cells
    side: jax.Array
    coarse: jax.Array
    coarse_dims: jax.Array

    def has_support(self, g: jax.Array) -> jax.Array:
        """bool [...]: whether samples are taken at g [..., 3]."""
        cell = jnp.clip(g.astype(jnp.int32), 0, self.side - 1)
        return self.occupied[_flat_index(cell, jnp.stack([self.side] * 3))] > 0

    def near_content(self, g: jax.Array) -> jax.Array:
        """bool [...]: False only where no cell within COARSE / 2 of g [..., 3] is on."""
        cell = jnp.clip((g * (1.0 / COARSE)).astype(jnp.int32), 0, self.coarse_dims - 1)
        return self.coarse[_flat_index(cell, self.coarse_dims)] > 0


def segments_across(dims: np.ndarray, step: float) -> int:
    """How many runs of COARSE steps the longest ray through a grid of dims voxels has. step: in voxels."""
    return int(np.ceil(np.linalg.norm(dims) / step / COARSE)) + 1


def _flat_index(cell: jax.Array, dims: jax.Array) -> jax.Array:
    """Flat index, x fastest, of integer cells [..., 3] in a box of dims [3]."""
    return (cell[..., 2] * dims[1] + cell[..., 1]) * dims[0] + cell[..., 0]


def coarse_occupancy(support: np.ndarray) -> np.ndarray:
    """uint8 [Cz, Cy, Cx]: cell c answers for samples at g in [4c - 2, 4c + 6), whose padded cells are 4c - 2 ... 4c + 6."""
    for axis in range(3):
        wide = np.pad(np.moveaxis(support, axis, 0), [(COARSE // 2, 2 * COARSE), (0, 0), (0, 0)])
        length = COARSE * -(-support.shape[axis] // COARSE)
        shifted = (wide[first : first + length : COARSE] for first in range(2 * COARSE + 1))
        support = np.moveaxis(reduce(np.maximum, shifted), 0, axis)
    return support


def dilate(volume: np.ndarray) -> np.ndarray:
    """bool volume grown by one voxel along every axis and diagonal."""
    for axis in range(3):
        grown = volume.copy()
        source, target = np.moveaxis(volume, axis, 0), np.moveaxis(grown, axis, 0)
        target[1:] |= source[:-1]
        target[:-1] |= source[1:]
        volume = grown
    return volume


class MarchSizes(NamedTuple):
    segments: int  # that are tested a ray
    coarse: int  # of the coarse list
    samples: int  # of the sample list
    per_ray: int  # samples that a ray may have


class Samples(NamedTuple):
    """S samples in ray order."""

    ray: jax.Array  # int32 [S]
    rank: jax.Array  # int32 [S]: which sample of its ray
    g: jax.Array  # [S, 3] grid coordinates
    t: jax.Array  # [S] distance in voxels
    valid: jax.Array  # bool [S]
    complete: jax.Array  # bool [N]: all samples of this ray are in the list
    counts: jax.Array  # int32 [N]


def occupied_segments(cells: Cells, rays: GridRays, phase: jax.Array, segments: int, step: float) -> jax.Array:
    """bool [N, segments]: which runs of COARSE steps may meet content."""
    middle = rays.start[:, None] + (phase[:, None] + COARSE * jnp.arange(segments) + 0.5 * (COARSE - 1)) * step
    g = rays.points(jnp.arange(len(middle))[:, None], middle)
    ends_after = rays.start[:, None] + COARSE * jnp.arange(segments) * step < rays.end[:, None]
    return cells.near_content(g) & ends_after


def _compact(mask: jax.Array, size: int) -> jax.Array:
    """int32 [size]: where mask [M] is set, in order, as far as they fit; filled up with M."""
    place = jnp.cumsum(mask.astype(jnp.int32)) - 1
    index = jnp.arange(mask.size, dtype=jnp.int32)
    return jnp.full(size, mask.size, jnp.int32).at[jnp.where(mask, place, size)].set(index, mode="drop")


def march(cells: Cells, rays: GridRays, phase: jax.Array, sizes: MarchSizes, step: float) -> Samples:
    """The samples of N rays at start + (phase + k) step, k = 0, 1, …, that have support.

    step: in voxels, at most 1; at most 2 where near_content looks two voxels further than it must.
    """
    count = rays.start.shape[0]
    coarse = occupied_segments(cells, rays, phase, sizes.segments, step)
    picked = _compact(coarse.ravel(), sizes.coarse)
    per_ray = coarse.sum(1)
    ends = jnp.cumsum(per_ray)
    starts = ends - per_ray  # of each ray's segments in the coarse list

    listed = picked < count * sizes.segments
    ray = jnp.minimum(picked // sizes.segments, count - 1)[:, None]
    k = (picked % sizes.segments)[:, None] * COARSE + jnp.arange(COARSE)
    t = rays.start[ray] + (phase[ray] + k) * step
    g = rays.points(ray, t)
    inside = (t < rays.end[ray]) & listed[:, None]
    fine = inside & cells.has_support(g)

    # samples before each coarse entry, and before the end
    before = jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(fine.sum(1))])
    first = before[jnp.minimum(starts, sizes.coarse)]
    counts = before[jnp.minimum(ends, sizes.coarse)] - first
    complete = (first + counts <= sizes.samples) & (ends <= sizes.coarse) & (counts <= sizes.per_ray)

    chosen = _compact(fine.ravel(), sizes.samples)
    valid = chosen < fine.size
    chosen = jnp.minimum(chosen, fine.size - 1)
    sample_ray = ray[chosen // COARSE, 0]
    rank = jnp.arange(sizes.samples) - first[sample_ray]
    valid = valid & complete[sample_ray]
    return Samples(sample_ray, rank, g.reshape(-1, 3)[chosen], t.ravel()[chosen], valid, complete, counts)


def sums_along_rays(samples: Samples, values: jax.Array, rays: int, per_ray: int) -> tuple[jax.Array, jax.Array]:
    """The sum [S] of values [S] up to each valid sample on its ray, itself included, and of each whole ray [rays].

    Values are spread into [rays, per_ray] so that the running sum starts afresh for each ray and keeps precision.
    """
    slot = jnp.where(samples.valid, samples.ray * per_ray + samples.rank, rays * per_ray)
    spread = jnp.zeros(rays * per_ray, values.dtype).at[slot].set(values, mode="drop")
    sums = jnp.cumsum(spread.reshape(rays, per_ray), axis=1)
    return sums.ravel().at[slot].get(mode="fill", fill_value=0.0), sums[:, -1]


def transmittance(samples: Samples, tau: jax.Array, rays: int, per_ray: int) -> tuple[jax.Array, jax.Array]:
    """T before each sample [S] of optical depth tau [S], and T behind each ray [rays]. Samples not valid count as empty."""
    tau = jnp.where(samples.valid, tau, 0.0)
    depth, whole = sums_along_rays(samples, tau, rays, per_ray)
    return jnp.exp(tau - depth), jnp.exp(-whole)
