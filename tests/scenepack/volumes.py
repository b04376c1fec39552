"""Packs of small volumes held in full, for tests: macroblocks are cut out one by one, with the voxels around them."""

from typing import Any

import numpy as np

from scenepack.blocks import Triple, atlas_layout, atlas_shape, choose_atlas_blocks, dense_from_pack, grid_block_counts
from scenepack.pack import Pack, ViewMlp

BLENDER_FRAME = np.array([[-1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)
NDC_FRAME = np.diag([1.0, 1.0, -1.0, 1.0])
PLANE = np.array([0.25, -0.15, 1.0]), -2.4  # of plane_pack, in the training frame: n, d of n . p = d


def occupied_blocks(alpha: np.ndarray, block_size: int) -> np.ndarray:
    """bool [blocks z, blocks y, blocks x]: macroblocks with any `alpha` [z, y, x] above zero."""
    nz, ny, nx = (-(-n // block_size) for n in alpha.shape)
    full = np.pad(alpha > 0, [(0, -n % block_size) for n in alpha.shape])
    return np.any(full.reshape(nz, block_size, ny, block_size, nx, block_size), axis=(1, 3, 5))


def atlas_from_dense(
    rgba: np.ndarray, features: np.ndarray | None, block_size: int, occupied: np.ndarray | None = None, *,
    atlas_blocks: Triple | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:  # fmt: skip
    """(atlas_indices, atlas_rgba, atlas_features) of a volume.

    rgba: uint8 [z, y, x, 4], premultiplied; features: the same shape or None. occupied: bool [blocks z, y, x], by default every
    macroblock with some alpha; what lies in others is dropped.
    """
    if occupied is None:
        occupied = occupied_blocks(rgba[..., 3], block_size)
    depth, height, width = rgba.shape[:3]
    assert occupied.shape == grid_block_counts((width, height, depth), block_size)[::-1]
    blocks = atlas_blocks or choose_atlas_blocks(int(occupied.sum()), block_size)
    indices, side = atlas_layout(occupied, blocks), block_size + 2
    kept = occupied
    for axis in range(3):
        kept = kept.repeat(block_size, axis)

    def atlas_of(dense: np.ndarray) -> np.ndarray:
        around = np.pad(dense, [*((1, 1 - n % -block_size) for n in dense.shape[:3]), (0, 0)])
        around[1:-1, 1:-1, 1:-1][~kept] = 0
        atlas = np.zeros((*atlas_shape(blocks, block_size), 4), np.uint8)
        for block in np.argwhere(occupied):
            to = tuple(slice(i * side, (i + 1) * side) for i in indices[tuple(block)][::-1].tolist())
            atlas[to] = around[tuple(slice(i * block_size, i * block_size + side) for i in block)]
        return atlas

    return indices, atlas_of(rgba), None if features is None else atlas_of(features)


def pack_of_cube(
    side: int, block_size: int, atlas: tuple[np.ndarray, np.ndarray, np.ndarray | None], view_mlp: ViewMlp | None,
    worldspace_T_opengl: np.ndarray, **camera: Any,
) -> Pack:  # fmt: skip
    """A pack of side^3 voxels over [-1, 1]^3. atlas: indices, rgba, features. camera: what forward-facing packs have besides."""
    return Pack(
        voxel_size=2.0 / side, min_xyz=np.full(3, -1.0), grid_size=(side, side, side), block_size=block_size,
        atlas_indices=atlas[0], atlas_rgba=atlas[1], atlas_features=atlas[2], view_mlp=view_mlp,
        worldspace_T_opengl=np.array(worldspace_T_opengl, float), **camera,
    )  # fmt: skip


def cube_pack(
    rgba: np.ndarray, block_size: int, frame: np.ndarray = BLENDER_FRAME, features: np.ndarray | None = None,
    view_mlp: ViewMlp | None = None, **camera: Any,
) -> Pack:  # fmt: skip
    """The pack of a cube of voxels over [-1, 1]^3: rgba [z, y, x, 4], premultiplied; features likewise."""
    return pack_of_cube(len(rgba), block_size, atlas_from_dense(rgba, features, block_size), view_mlp, frame, **camera)


def features_of(pack: Pack) -> np.ndarray:
    """Its features' atlas, which it must have."""
    assert pack.atlas_features is not None
    return pack.atlas_features


def dense_of(pack: Pack) -> tuple[np.ndarray, np.ndarray]:
    rgba, features = dense_from_pack(pack)
    assert features is not None
    return rgba, features


def centres(side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y, z [z, y, x] of the voxels of a cube over [-1, 1]^3."""
    z, y, x = (np.mgrid[:side, :side, :side] + 0.5) * (2 / side) - 1
    return x, y, z


def solid_pack(
    inside: np.ndarray, colour: tuple[int, int, int], frame: np.ndarray = BLENDER_FRAME, **camera: Any
) -> Pack:
    """A pack over [-1, 1]^3 of one colour, opaque where `inside` ([z, y, x] in voxels, 0 at the surface) is positive."""
    alpha = np.rint(255 * np.clip(inside + 0.5, 0, 1))[..., None]
    rgba = np.concatenate([np.rint(alpha * np.array(colour) / 255), alpha], axis=-1).astype(np.uint8)
    return cube_pack(rgba, 14, frame, **camera)


def plane_pack(side: int, colour: tuple[int, int, int]) -> Pack:
    """A forward-facing pack of what lies behind PLANE, by NeRF's warp (appendix C): x = -w x' / (2 f) z, z = 2 / (z' - 1)."""
    width, height, focal = 160.0, 120.0, 140.0
    (n, d), (x, y, z) = PLANE, centres(side)
    world_z = 2.0 / (-z - 1.0)  # the grid's z is minus NDC's
    world = np.stack([-x * world_z * width / (2 * focal), -y * world_z * height / (2 * focal), world_z], -1)
    behind = (d - world @ n) * world_z**-2 * side  # about voxels
    return solid_pack(behind, colour, NDC_FRAME, ndc=True, input_width=width, input_height=height, input_focal=focal)
