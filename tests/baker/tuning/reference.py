"""Packs to tune, and their voxels and training rays in float64, without Numba: what the marcher and the tuner are held to."""

from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from baker.tuning.marcher import pack_rays
from scenepack import Pack
from scenepack.blocks import block_copy
from scenepack.constants import ALPHA_CONTRIBUTES, TRANSMITTANCE_STOP
from tests.reference_marcher import fetch, march, shade
from tests.scenepack.random_packs import random_pack, random_view_mlp
from training.dataset import RayDataset


def pack_of(seed: int = 7, **options: Any) -> Pack:
    """A random pack where the photographs look. No voxel is quite opaque: that has no gradient of its density."""
    pack = random_pack(np.random.default_rng(seed), block_size=14, grid_blocks=(2, 2, 2), style="blob", **options)
    size = np.array(pack.grid_size) * 0.06
    if not options.get("diffuse"):
        pack = replace(pack, view_mlp=random_view_mlp(np.random.default_rng(8), 0.5))
    features = None if pack.atlas_features is None else np.minimum(pack.atlas_features, 250)
    rgba = np.minimum(pack.atlas_rgba, 250)
    return replace(pack, voxel_size=0.06, min_xyz=-0.5 * size, atlas_rgba=rgba, atlas_features=features)


@dataclass(frozen=True)
class VoxelRays:
    """Rays in voxels: origins, unit directions [R, 3], first [R]: where they may begin; viewdirs, target [R, 3]."""

    origins: np.ndarray
    directions: np.ndarray
    first: np.ndarray
    viewdirs: np.ndarray
    target: np.ndarray


def voxel_rays(pack: Pack, dataset: RayDataset, ids: np.ndarray, away: np.ndarray | None = None) -> VoxelRays:
    """Training rays `ids` [R], `away` [R, 2] pixels from the centres of their pixels."""
    rays = pack_rays(pack, dataset).geometry_at(jnp.asarray(ids), None if away is None else jnp.asarray(away))
    origins, directions, near = (np.asarray(a, np.float64) for a in (rays.origins, rays.directions, rays.near))
    length = np.linalg.norm(directions, axis=-1)
    return VoxelRays(
        (origins - pack.min_xyz) / pack.voxel_size, directions / length[:, None], near * length / pack.voxel_size,
        np.asarray(rays.viewdirs, np.float64), np.asarray(dataset.colours_at(jnp.asarray(ids)), np.float64),
    )  # fmt: skip


def sampled(pack: Pack, rays: VoxelRays) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every sample of each ray, [R, S]: t in voxels, alpha (0 where it does not count), T before it (0 behind the last)."""
    with np.errstate(divide="ignore"):
        walls = np.stack([-rays.origins / rays.directions, (pack.grid_size - rays.origins) / rays.directions])
    start, end = np.maximum(walls.min(0).max(-1), rays.first), walls.max(0).min(-1)
    t = start[:, None] + 0.5 + np.arange(int(np.ceil(np.linalg.norm(pack.grid_size))) + 1)
    inside = t < end[:, None]
    places = rays.origins[:, None] + t[..., None] * rays.directions[:, None]
    alpha = np.zeros(t.shape)
    alpha[inside] = fetch(pack, places[inside])[0][:, 3]
    alpha[alpha <= ALPHA_CONTRIBUTES] = 0
    before = np.cumprod(np.concatenate([np.ones((len(t), 1)), 1 - alpha], axis=1), axis=1)[:, :-1]
    return t, alpha, np.where(before > TRANSMITTANCE_STOP, before, 0)


def cells_of_atlas(pack: Pack, side: int) -> np.ndarray:
    """int [D, H, W]: of each place in the atlas with alpha, the cell of its voxel: cubes of side³, numbered from 1 in the
    grid's order; 0 elsewhere."""
    alpha, wide = pack.atlas_rgba[..., 3], pack.padded_block_size
    cubes, cells = np.zeros((*alpha.shape, 3), int), np.zeros(alpha.shape, int)  # of cubes: z, y, x
    for block in np.argwhere(pack.occupied):
        voxels = np.moveaxis(np.indices([wide] * 3), 0, -1) - 1 + block * pack.block_size
        block_copy(pack, cubes, tuple(block))[...] = voxels // side
    cells[alpha > 0] = np.unique(cubes[alpha > 0], axis=0, return_inverse=True)[1].ravel() + 1
    return cells


def moved(pack: Pack, cells: np.ndarray, delta: np.ndarray) -> Pack:
    """The pack with the content of its cells moved by delta [K + 1, 8], not rounded: atlases float64."""
    before = pack.atlas_rgba[..., 3:] / 255.0
    own, some = delta[cells], np.maximum(before, 1e-6)
    alpha = 1 - (1 - before) ** np.exp(own[..., 3:4])
    rgba = 255 * np.concatenate([(pack.atlas_rgba[..., :3] / 255 / some + own[..., :3]) * alpha, alpha], axis=-1)
    features = pack.atlas_features
    if features is not None:
        features = np.where(before > 0, 255 * (features / 255 / some + own[..., 4:]) * alpha, 0)
    return replace(pack, atlas_rgba=np.where(before > 0, rgba, 0), atlas_features=features)


def accumulated(pack: Pack, rays: VoxelRays) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour [R, 3], features [R, 4] and T [R], as composited."""
    return march(pack, rays.origins, rays.directions, rays.first)


def shown(pack: Pack, sums: tuple[np.ndarray, np.ndarray, np.ndarray], rays: VoxelRays, background) -> np.ndarray:
    """[R, 3] what the viewer makes of accumulated rays, not above 1."""
    return np.minimum(shade(pack, *sums, rays.viewdirs, background)[1], 1)
