"""Rays as the march wants them: in the frame of a grid, as long as the grid, measured in voxels.

One rule for all that is compared with photographs, of fields and of packs alike (docs/rendering.md): a ray begins `near` from
its camera and ends where it leaves the grid's box. `far` is for the paper's method, which has no grid; boxes lie before it, but
for the outermost corners of a Blender scene's, where only mist of fields is cut off.

Frames: a grid's own (a pack's grid frame, say) and the training frame, in which a dataset makes its rays; they differ by
the rigid grid_T_training [4, 4]. Of the trainer's own voxels the two are one.
Where a grid is contracted (scenepack.contraction), a ray is a path of several straight pieces, as long as all of space.
Products of geometry ask for the highest precision: TF32, an NVIDIA GPU's default, moves a ray by 0.2 pixels of 800.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

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
