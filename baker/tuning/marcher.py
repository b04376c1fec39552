"""Training rays through a pack, as the viewer marches it: loops on the processor's cores, each ray by one of them.

Rays are given as ids int32 [N] of pixels and `pixel_offset` float32 [N, 2], in pixels from their centres (None: none).

Notation: B = block_size + 2; a slot is an occupied macroblock, numbered in the grid's order; a cell of its padded copy lies
between voxel (x, y, z) and the next along each axis. A second table says of each block of 4³ cells
whether all are empty: rays cross such a block in one jump.
"""

# pyright: reportCallIssue=false

from collections.abc import Callable, Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numba import njit

from scenepack.constants import ALPHA_CONTRIBUTES, TRANSMITTANCE_STOP
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.marching import GridBox, GridFrameRays, GridRays, to_grid
from training.multires.fused.compiled import Workers, kernel
from training.multires.fused.march import piece_from

OnShare = Callable[[float], None]

MAX_ALPHA = 1 - 1e-6  # keeps the optical depth of opaque samples finite
TOGETHER = 65_536  # rays that are made together
PART = 512  # rays that a worker claims
MARKED = 16  # macroblocks that a worker claims
LISTED = 16  # samples of a ray that are listed before they are looked at
CLOSE = 1e-3  # steps: what is left to rounding when a ray jumps over empty space
MOST_COPIES = 4  # workers that mark transmittance: each has a copy of all voxels


def box_of(min_xyz: np.ndarray, voxel_size: float, size: tuple[int, ...], contraction: float | None) -> GridBox:
    """The box of a grid of `size` (x, y, z) voxels that begins at min_xyz, in its frame."""
    inner = None if contraction is None else jnp.float32(contraction)
    return GridBox(jnp.asarray(min_xyz, jnp.float32), jnp.float32(voxel_size), jnp.asarray(size, jnp.int32), inner)


def pack_rays(pack: Pack, dataset: RayDataset) -> GridFrameRays:
    """The training rays as a viewer of the pack would cast them: in its grid frame, from the camera on, without an end."""
    return GridFrameRays(dataset, jnp.asarray(np.linalg.inv(pack.worldspace_T_opengl), jnp.float32))


class Tables(NamedTuple):
    """Where a pack's voxels are."""

    slots: np.ndarray  # int32 [bz by bx]: of each macroblock, -1 where it is empty
    blocks: np.ndarray  # int64 [3] = (bx, by, bz)
    size: int  # block_size
    first: np.ndarray  # int64 [slots]: flat index in the atlas of each copy's first voxel
    row: int  # flat step along y there
    layer: int  # the same along z
    support: np.ndarray  # uint8 [slots, B³]: whether a cell has alpha around it
    near: np.ndarray  # uint8 [slots, n³]: the same of 4³ cells
    rgba: np.ndarray  # uint8 [., 4]: the atlas, flat
    features: np.ndarray  # the same; zeros where a pack has none


class Found(NamedTuple):
    """Up to LISTED samples of a ray; the last three are of those that contribute alone."""

    slot: np.ndarray  # int32
    cell: np.ndarray  # int32 [., 3]
    fraction: np.ndarray  # float32 [., 3], within the cell
    t: np.ndarray  # float32, voxels
    at: np.ndarray  # int64: the lowest corner in the atlas
    weights: np.ndarray  # float32 [., 8], of the corners
    alpha: np.ndarray  # float32


def tables_of(pack: Pack, workers: Workers) -> Tables:
    """The tables of a pack; its atlas is not copied."""
    _, height, width, _ = pack.atlas_rgba.shape
    side, occupied = pack.padded_block_size, pack.occupied
    slots = np.full(occupied.shape, -1, np.int32)
    slots[occupied] = np.arange(np.count_nonzero(occupied), dtype=np.int32)
    places = pack.atlas_indices[occupied].astype(np.int64) * side
    first = (places[:, 2] * height + places[:, 1]) * width + places[:, 0]
    rgba = np.ascontiguousarray(pack.atlas_rgba).reshape(-1, 4)
    features = pack.atlas_features
    features = np.zeros(rgba.shape, np.uint8) if features is None else np.ascontiguousarray(features).reshape(-1, 4)
    support = np.zeros((len(first), side**3), np.uint8)
    near = np.zeros((len(first), (-(-side // 4)) ** 3), np.uint8)
    marked = rgba, first, width, width * height, side, support, near
    workers.share_range(len(first), MARKED, lambda _, low, high: mark_support(*marked, low, high))
    blocks = np.array(occupied.shape[::-1], np.int64)
    return Tables(slots.ravel(), blocks, pack.block_size, first, width, width * height, support, near, rgba, features)


@kernel
def mark_support(rgba, first, row, layer, side, support, near, low, high):
    """Fills support and near of Tables from the alphas of the atlas, of slots low … high - 1."""
    across = -(-side // 4)
    for slot in range(low, high):
        for z in range(side - 1):
            for y in range(side - 1):
                for x in range(side - 1):
                    at = first[slot] + z * layer + y * row + x
                    some = rgba[at, 3] | rgba[at + 1, 3] | rgba[at + row, 3] | rgba[at + row + 1, 3]
                    at += layer
                    some |= rgba[at, 3] | rgba[at + 1, 3] | rgba[at + row, 3] | rgba[at + row + 1, 3]
                    if some != 0:
                        support[slot, (z * side + y) * side + x] = 1
                        near[slot, ((z >> 2) * across + (y >> 2)) * across + (x >> 2)] = 1


@kernel(inline="always")
def wall(origin, direction, low, high):
    """t at which a ray leaves low … high along one axis."""
    if direction == 0:
        return np.float32(3e38)
    return ((high if direction > 0 else low) - origin) / direction


@kernel
def list_samples(tables: Tables, rays, ray, k, capacity, found):
    """Lists up to `capacity` samples with support of a ray, from its k-th place on: how many, and the place to go on from.

    Samples lie at start + 0.5 + k; the ray has no more where fewer than `capacity` are listed.
    """
    start, stop = rays.start[ray], rays.end[ray]
    slots, support, near = tables.slots, tables.support, tables.near
    most_x, most_y, most_z = tables.blocks[0] - 1, tables.blocks[1] - 1, tables.blocks[2] - 1
    size = np.int64(tables.size)
    side, across = size + 2, (size + 5) >> 2
    half = np.float32(0.5)
    count = 0
    along = start + half + np.float32(k)
    piece, until, ox, oy, oz, dx, dy, dz = piece_from(rays, ray, 0, along)
    while along < stop and count < capacity:
        if along >= until:
            piece, until, ox, oy, oz, dx, dy, dz = piece_from(rays, ray, piece, along)
        gx, gy, gz = ox + along * dx, oy + along * dy, oz + along * dz
        bx = min(max(np.int64(gx) // size, 0), most_x)
        by = min(max(np.int64(gy) // size, 0), most_y)
        bz = min(max(np.int64(gz) // size, 0), most_z)
        slot = slots[(bz * (most_y + 1) + by) * (most_x + 1) + bx]
        x0, y0, z0 = np.float32(bx * size), np.float32(by * size), np.float32(bz * size)
        if slot < 0:
            far = np.float32(size)
            out = min(wall(ox, dx, x0, x0 + far), wall(oy, dy, y0, y0 + far), wall(oz, dz, z0, z0 + far))
        else:
            lx, ly, lz = gx - x0 + half, gy - y0 + half, gz - z0 + half  # + 1 for the padding, - 0.5 for the centre
            x = min(max(np.int64(np.floor(lx)), 0), size)
            y = min(max(np.int64(np.floor(ly)), 0), size)
            z = min(max(np.int64(np.floor(lz)), 0), size)
            if near[slot, ((z >> 2) * across + (y >> 2)) * across + (x >> 2)] != 0:
                if support[slot, (z * side + y) * side + x] != 0:
                    found.slot[count] = slot
                    found.cell[count, 0], found.cell[count, 1], found.cell[count, 2] = x, y, z
                    found.fraction[count, 0] = lx - np.float32(x)
                    found.fraction[count, 1] = ly - np.float32(y)
                    found.fraction[count, 2] = lz - np.float32(z)
                    found.t[count] = along
                    count += 1
                k += 1
                along = start + half + np.float32(k)
                continue
            out = min(_cube(ox, dx, x, x0, size), _cube(oy, dy, y, y0, size), _cube(oz, dz, z, z0, size))
        out = min(out, until)
        k = max(k + 1, np.int64(out - start - half - np.float32(CLOSE)) + 1)
        along = start + half + np.float32(k)
    return count, k


@kernel(inline="always")
def _cube(origin, direction, cell, low, size):
    """t at which a ray leaves, along one axis, the 4³ cells around `cell`, or the macroblock that begins at `low`."""
    at = low - np.float32(0.5) + np.float32(cell >> 2 << 2)
    return wall(origin, direction, max(at, low), min(at + np.float32(4.0), low + np.float32(size)))


@kernel
def list_contributing(tables: Tables, rays, ray, k, found):
    """The contributing ones of up to LISTED samples of a ray: how many, where to go on, and of how many: fewer are the last."""
    rgba, first, row, layer = tables.rgba, tables.first, np.int64(tables.row), np.int64(tables.layer)
    slot, cell, fraction, weights, one = found.slot, found.cell, found.fraction, found.weights, np.float32(1.0)
    listed, k = list_samples(tables, rays, ray, k, LISTED, found)
    count = 0
    for i in range(listed):
        at = first[slot[i]] + np.int64(cell[i, 2]) * layer + np.int64(cell[i, 1]) * row + np.int64(cell[i, 0])
        fx, fy, fz = fraction[i, 0], fraction[i, 1], fraction[i, 2]
        ex, ey, ez = one - fx, one - fy, one - fz
        weights[count, 0], weights[count, 1] = ez * ey * ex, ez * ey * fx
        weights[count, 2], weights[count, 3] = ez * fy * ex, ez * fy * fx
        weights[count, 4], weights[count, 5] = fz * ey * ex, fz * ey * fx
        weights[count, 6], weights[count, 7] = fz * fy * ex, fz * fy * fx
        alpha = np.float32(0.0)
        for corner in range(8):
            place = at + (corner >> 2) * layer + (corner >> 1 & 1) * row + (corner & 1)
            alpha += weights[count, corner] * np.float32(rgba[place, 3])
        alpha *= np.float32(1 / 255)
        if alpha <= np.float32(ALPHA_CONTRIBUTES):
            continue
        found.at[count], found.alpha[count], found.t[count], slot[count] = at, alpha, found.t[i], slot[i]
        for axis in range(3):
            cell[count, axis] = cell[i, axis]
        count += 1
    return count, k, listed


@njit(nogil=True, cache=True)
def accumulate_rays(tables: Tables, rays, low, high, found, sums):
    """sums float32 [N, 8] of rays low … high - 1: premultiplied colour and features, and T behind all."""
    rgba, features, weights = tables.rgba, tables.features, found.weights
    row, layer, one, total = np.int64(tables.row), np.int64(tables.layer), np.float32(1.0), np.empty(8, np.float32)
    for ray in range(low, high):
        passed, k, listed = one, np.int64(0), LISTED
        total[:] = np.float32(0.0)
        while listed == LISTED and passed > np.float32(TRANSMITTANCE_STOP):
            count, k, listed = list_contributing(tables, rays, ray, k, found)
            for i in range(count):
                scale = passed * np.float32(1 / 255)
                for corner in range(8):
                    place = found.at[i] + (corner >> 2) * layer + (corner >> 1 & 1) * row + (corner & 1)
                    share = weights[i, corner] * scale
                    for c in range(3):
                        total[c] += share * np.float32(rgba[place, c])
                    for c in range(4):
                        total[3 + c] += share * np.float32(features[place, c])
                passed *= one - min(found.alpha[i], np.float32(MAX_ALPHA))
                if passed <= np.float32(TRANSMITTANCE_STOP):
                    break
        for c in range(7):
            sums[ray, c] = total[c]
        sums[ray, 7] = passed


@kernel
def raise_transmittance(tables: Tables, rays, low, high, found, best):
    """Raises best uint8 [slots, B³] to the T before each sample of rays low … high - 1, where it contributes."""
    side, one, weights = np.int64(tables.size) + 2, np.float32(1.0), found.weights
    for ray in range(low, high):
        passed, k, listed = one, np.int64(0), LISTED
        while listed == LISTED and passed > np.float32(TRANSMITTANCE_STOP):
            count, k, listed = list_contributing(tables, rays, ray, k, found)
            for i in range(count):
                slot, x, y, z = found.slot[i], found.cell[i, 0], found.cell[i, 1], found.cell[i, 2]
                local, arriving = (z * side + y) * side + x, np.uint8(np.ceil(np.float32(255) * passed))
                for corner in range(8):
                    if weights[i, corner] > 0:
                        place = local + ((corner >> 2) * side + (corner >> 1 & 1)) * side + (corner & 1)
                        best[slot, place] = max(best[slot, place], arriving)
                passed *= one - min(found.alpha[i], np.float32(MAX_ALPHA))
                if passed <= np.float32(TRANSMITTANCE_STOP):
                    break


@kernel
def half_depth_rays(tables: Tables, rays, low, high, found, depths):
    """depths float32 [N] of rays low … high - 1: t of the last sample that half of the light or more arrives at."""
    one, half = np.float32(1.0), np.float32(0.5)
    for ray in range(low, high):
        passed, k, listed, depth = one, np.int64(0), LISTED, np.float32(0.0)
        while listed == LISTED and passed >= half:
            count, k, listed = list_contributing(tables, rays, ray, k, found)
            for i in range(count):
                if passed < half:
                    break
                depth = found.t[i]
                passed *= one - min(found.alpha[i], np.float32(MAX_ALPHA))
        depths[ray] = depth


@kernel
def meeting_rays(tables: Tables, rays, low, high, found, meets):
    """meets bool [N] of rays low … high - 1: whether any sample has support."""
    for ray in range(low, high):
        count, _ = list_samples(tables, rays, ray, np.int64(0), 1, found)
        meets[ray] = count > 0


class PackMarcher:
    """The training rays through a pack. Its arrays are read, not copied: they must stay as they are.

    rays: the training rays in the pack's frame. box: its grid there.
    """

    def __init__(self, pack: Pack, dataset: RayDataset) -> None:
        self.rays, self.workers = pack_rays(pack, dataset), Workers()
        self.tables = tables_of(pack, self.workers)
        self.box = box_of(pack.min_xyz, pack.voxel_size, pack.grid_size, pack.contraction)
        self.found = [sample_buffers() for _ in range(self.workers.count)]

    def meets(self, ids: np.ndarray) -> np.ndarray:
        """bool [N]: which rays have a sample with support."""
        meets = np.zeros(len(ids), bool)
        self.over(ids, meeting_rays, lambda _, first: meets[first:])
        return meets

    def half_depths(self, ids: np.ndarray) -> np.ndarray:
        """float32 [N]: distance along each ray, in voxels, of the last sample that half of the light or more arrives at; 0
        where there is none."""
        depths = np.zeros(len(ids), np.float32)
        self.over(ids, half_depth_rays, lambda _, first: depths[first:])
        return depths

    def transmittance(self, batches: Iterable[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """uint8 [slots, B, B, B] of the occupied macroblocks' padded copies, in the grid's order: the largest T before a
        sample that a voxel is part of, in units of 1/255 and rounded up; 0 where there is none. batches: ids and pixel_offset of
        rays."""
        workers = Workers(min(self.workers.count, MOST_COPIES))
        copies = [np.zeros(self.tables.support.shape, np.uint8) for _ in range(workers.count)]
        for ids, pixel_offset in batches:
            self.over(ids, raise_transmittance, lambda worker, _: copies[worker], pixel_offset, workers=workers)
        best = copies[0]
        for other in copies[1:]:
            np.maximum(best, other, out=best)
        side = self.tables.size + 2
        return best.reshape(-1, side, side, side)

    def accumulate(self, ids: np.ndarray, on_share: OnShare = lambda share: None) -> np.ndarray:
        """What the viewer accumulates along each ray (docs/rendering.md): see accumulate_rays."""
        sums = np.zeros((len(ids), 8), np.float32)
        self.over(ids, accumulate_rays, lambda _, first: sums[first:], on_share=on_share)
        return sums

    def over(
        self, ids: np.ndarray, loop: Callable[..., None], into: Callable[[int, int], np.ndarray],
        pixel_offset: np.ndarray | None = None, on_share: OnShare = lambda share: None, workers: Workers | None = None,
    ) -> None:  # fmt: skip
        """Calls loop(tables, rays, low, high, found, into(worker, first)) for parts of all rays; see share_rays."""

        def look(worker: int, rays: GridRays, first: int, low: int, high: int) -> None:
            loop(self.tables, rays, low, high, self.found[worker], into(worker, first))

        share_rays(workers or self.workers, self.box, self.rays, ids, look, on_share, pixel_offset)


def share_rays(
    workers: Workers, box: GridBox, source: GridFrameRays, ids: np.ndarray, look: Callable[[int, GridRays, int, int, int], None],
    on_share: OnShare, pixel_offset: np.ndarray | None = None,
) -> None:  # fmt: skip
    """Calls look(worker, rays, first, low, high) for parts of all rays, which are made TOGETHER at a time, in voxels: for those
    from `first` + low to `first` + high - 1, which are low … high - 1 of `rays`."""
    for first in range(0, len(ids), TOGETHER):
        some = np.minimum(np.arange(first, first + TOGETHER), len(ids) - 1)
        rays = rays_in_grid(box, source, ids[some], None if pixel_offset is None else pixel_offset[some])
        count = min(TOGETHER, len(ids) - first)
        workers.share_range(count, PART, lambda worker, *part: look(worker, rays, first, *part))  # noqa: B023  (called now)
        on_share((first + count) / len(ids))


def rays_in_grid(
    box: GridBox, source: GridFrameRays, ids: np.ndarray, pixel_offset: np.ndarray | None = None
) -> GridRays:
    """Training rays in voxels as the loops take them: of NumPy, without the path, which no loop needs."""
    return GridRays(*map(np.asarray, _in_grid(box, source, ids, pixel_offset)[:-1]))  # type: ignore[arg-type]


@jax.jit
def _in_grid(box: GridBox, source: GridFrameRays, ids: jax.Array, pixel_offset: jax.Array | None) -> GridRays:
    return to_grid(box, source.geometry_at(ids, pixel_offset))


def sample_buffers() -> Found:
    """What one worker looks at together."""
    return Found(
        np.empty(LISTED, np.int32), np.empty((LISTED, 3), np.int32), np.empty((LISTED, 3), np.float32),
        np.empty(LISTED, np.float32), np.empty(LISTED, np.int64), np.empty((LISTED, 8), np.float32),
        np.empty(LISTED, np.float32),
    )  # fmt: skip
