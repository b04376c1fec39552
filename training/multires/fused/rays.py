"""Training rays from their ids, on the CPU: cameras, lenses, the NDC warp, pixels, and the grid's box.

The twin of RayDataset.geometry_at, colours_at and training.marching.to_grid (a test compares them), one ray at a time.

Notation: a ray's id counts views, then rows, then columns; N rays of a batch. Geometry is computed in float64.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from scenepack.contraction import MOST_PIECES
from training.dataset import NEWTON_STEPS, RayDataset
from training.multires.fused.compiled import kernel
from training.scenes.lens import PROJECTION, REACH, lens_functions
from training.scenes.scene import NDC_NEAR

LENS = lens_functions(compiled=njit(nogil=True))
_undistort, _direction = LENS.undistort, LENS.direction


class Photographs(NamedTuple):
    """The training photographs as arrays of the host; see RayDataset."""

    pixels: np.ndarray  # uint8 [P, C]
    world_T_camera: np.ndarray  # float64 [V, 3, 4]
    intrinsics: np.ndarray  # float64 [V, 4]
    distortion: np.ndarray  # float64 [V, LENS_SIZE + 1]
    first: np.ndarray  # int64 [V], as width
    width: np.ndarray
    row_step: int  # one row in so many is taken
    ndc: np.ndarray  # float64 [3] = width, height, focal; zeros where rays are not warped
    near: float  # bounds of t
    far: float
    contraction: float  # half the side of the inner cube of contracted space; 0 where it is not
    gains: np.ndarray = np.zeros((0, 3), np.float32)  # [V, 3]: see RayDataset; of none where colours stay as they are


class Batch(NamedTuple):
    """N rays in grid coordinates, each of up to P straight pieces, and what they should show; float32. At distance s, a ray is at
    origins + s directions of the last piece whose begins is not beyond s."""

    origins: np.ndarray  # [N, P, 3] voxels
    directions: np.ndarray  # [N, P, 3], unit length
    begins: np.ndarray  # [N, P] voxels
    start: np.ndarray  # [N] voxels
    end: np.ndarray  # [N] voxels
    length: np.ndarray  # [N] world units per voxel
    viewdirs: np.ndarray  # [N, 3], as the next two
    target: np.ndarray
    background: np.ndarray
    phase: np.ndarray  # [N]: of the samples, in steps
    pairs: np.ndarray = np.zeros((0, 2, 3), np.float32)  # [M, 2, 3]: neighbours in the unit cube, for smoothness


def photographs_of(dataset: RayDataset) -> Photographs:
    """The photographs of a dataset that lies on this process's CPU; pixels are not copied."""
    facts = dataset.facts
    poses, intrinsics, lenses, ndc = (
        np.asarray(array, np.float64)
        for array in (dataset.world_T_camera, dataset.intrinsics, dataset.distortion, facts.ndc_camera or (0, 0, 0.0))
    )
    return Photographs(
        np.asarray(dataset.pixels), poses, intrinsics, lenses, np.asarray(dataset.first, np.int64),
        np.asarray(dataset.width, np.int64), facts.row_step, ndc, facts.near, facts.far, facts.contraction or 0.0,
    )  # fmt: skip


def empty_batch(rays: int, contraction: float) -> Batch:
    """Unfilled arrays for so many rays, of several pieces each where contraction is not 0."""
    pieces = MOST_PIECES if contraction > 0 else 1
    shapes = (pieces, 3), (pieces, 3), (pieces,), (), (), (), (3,), (3,), (3,), ()
    return Batch(*(np.empty((rays, *shape), np.float32) for shape in shapes))


@njit(nogil=True, cache=True)
def fill_batch(photographs, ids, origin, voxel, dims, batch, low, high):
    """Fills rays low … high - 1 of `batch` from their ids, but for phase and background, which are there already."""
    memory = np.empty((6, MOST_PIECES))
    for n in range(low, high):
        _fill_ray(photographs, ids[n], origin, voxel, dims, batch, n, memory)


@njit(nogil=True, cache=True)
def take_rays(origins, directions, near, far, contraction, origin, voxel, dims, batch):
    """Fills the geometry of `batch` from rays of the training frame, [N, 3] and [N]."""
    memory = np.empty((6, MOST_PIECES))
    for n in range(len(near)):
        for axis in range(3):
            memory[0, axis], memory[1, axis] = origins[n, axis], directions[n, axis]
        begin, end = np.float64(near[n]), np.float64(far[n])
        _into_grid(batch, n, memory, begin, end, contraction, origin, voxel, dims)


@kernel
def _fill_ray(photographs, id_, origin, voxel, dims, batch, n, memory):
    """Ray n of fill_batch. memory [6, MOST_PIECES]: position and direction, and four rows for _into_contracted_grid."""
    position, direction = memory[0], memory[1]
    view = np.searchsorted(photographs.first, id_, side="right") - 1
    rest = id_ - photographs.first[view]
    x, y = rest % photographs.width[view], rest // photographs.width[view] * photographs.row_step
    lens = photographs.intrinsics[view]
    a, b = (x + 0.5 - lens[2]) / lens[0], (y + 0.5 - lens[3]) / lens[1]
    right, up, back, shown = _through_lens(a, b, photographs.distortion[view])
    pose = photographs.world_T_camera[view]
    for axis in range(3):
        direction[axis] = pose[axis, 0] * right + pose[axis, 1] * up + pose[axis, 2] * back
        position[axis] = pose[axis, 3]
    norm = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    for axis in range(3):
        direction[axis] /= norm
        batch.viewdirs[n, axis] = direction[axis]
    if photographs.ndc[2] > 0:
        _warp_to_ndc(position, direction, photographs.ndc)
    near, far, inner = photographs.near, photographs.far, photographs.contraction
    _into_grid(batch, n, memory, near, far, inner, origin, voxel, dims)
    if not shown:
        batch.end[n] = batch.start[n]
    _colour(photographs.pixels, photographs.gains, view, id_, batch, n)


@kernel
def _through_lens(u, v, lens):
    """training.scenes.lens.directions_at for one point, and whether the lens shows it."""
    bent = False
    for number in range(REACH):
        bent = bent or lens[number] != 0.0
    if not bent:
        return u, -v, -1.0, True
    a, b, shown = _undistort(u, v, lens, NEWTON_STEPS)
    x, y, z = _direction(a, b, lens[PROJECTION])
    return x, y, z, shown


@kernel
def _warp_to_ndc(position, direction, ndc):
    """training.scenes.scene.ndc_rays for one ray, in place."""
    ahead = (NDC_NEAR + position[2]) / direction[2]
    for axis in range(3):
        position[axis] -= ahead * direction[axis]
    inverse = 2.0 * NDC_NEAR / position[2]
    for axis in range(2):
        scale = -2.0 * ndc[2] / ndc[axis]
        place, slope = position[axis] / position[2], direction[axis] / direction[2]
        position[axis], direction[axis] = scale * place, scale * (slope - place)
    position[2], direction[2] = 1.0 + inverse, -inverse


@kernel
def _into_grid(batch, n, memory, near, far, contraction, origin, voxel, dims):
    """Clips a ray to the grid's box, unless that is contracted, and measures it in voxels. memory: see _fill_ray."""
    if contraction > 0:
        _into_contracted_grid(batch, n, memory, near, contraction, origin, voxel)
        return
    position, direction = memory[0], memory[1]
    world = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    for axis in range(3):
        position[axis] = (position[axis] - origin[axis]) / voxel[axis]
        direction[axis] /= voxel[axis]
    scale = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    start, end = near * scale, far * scale
    for axis in range(3):
        along = direction[axis] / scale
        safe = along if abs(along) >= 1e-9 else 1e-9
        to_low, to_high = -position[axis] / safe, (dims[axis] - position[axis]) / safe
        start, end = max(start, min(to_low, to_high)), min(end, max(to_low, to_high))
        batch.origins[n, 0, axis], batch.directions[n, 0, axis] = position[axis], along
    batch.begins[n, 0] = 0.0
    batch.start[n], batch.end[n], batch.length[n] = start, end, world / scale


@kernel
def _into_contracted_grid(batch, n, memory, near, inner, origin, voxel):
    """A ray's path through contracted space in voxels; see scenepack.contraction.path_of, notation included."""
    position, direction, values, slopes, place, moved = memory[0], memory[1], memory[2], memory[3], memory[4], memory[5]
    for axis in range(3):
        values[axis], slopes[axis] = position[axis] / inner, direction[axis] / inner
        values[axis + 3], slopes[axis + 3] = -values[axis], -slopes[axis]
    values[6], slopes[6] = 1.0, 0.0
    leads, t, s = 6, near, 0.0
    for line in range(6):
        if values[line] + slopes[line] * t > values[leads] + slopes[leads] * t:
            leads = line
    scale = inner / voxel[0]
    batch.begins[n, :] = np.inf
    for piece in range(batch.begins.shape[1]):
        value, rate = values[leads], slopes[leads]
        width, speed = value + rate * t, 0.0
        for axis in range(3):
            x = values[axis] + t * slopes[axis]
            if leads < 6 and axis == leads % 3:
                sign = 1.0 if leads < 3 else -1.0
                place[axis], moved[axis] = sign * (2.0 - 1.0 / width), sign * rate
            else:
                place[axis], moved[axis] = x / width, slopes[axis] * value - values[axis] * rate
            speed += moved[axis] ** 2
        speed = np.sqrt(speed)
        for axis in range(3):
            unit = moved[axis] / speed
            batch.origins[n, piece, axis] = (place[axis] - s * unit) * scale - origin[axis] / voxel[axis]
            batch.directions[n, piece, axis] = unit
        batch.begins[n, piece] = s * scale
        after, follows = np.inf, -1
        for line in range(7):
            if slopes[line] > rate:
                crossing = (value - values[line]) / (slopes[line] - rate)
                if crossing < after:
                    after, follows = crossing, line
        if follows < 0:
            s += speed / (width * rate)
            break
        after = max(after, t)
        s += speed * (after - t) / (width * (width + rate * (after - t)))
        t, leads = after, follows
    batch.start[n], batch.end[n], batch.length[n] = 0.0, s * scale, voxel[0]


@kernel
def _colour(pixels, gains, view, id_, batch, n):
    """The pixel's colour, in the average look, over the ray's background where it is not opaque."""
    opaque = pixels.shape[1] == 3
    alpha = np.float32(1.0) if opaque else np.float32(pixels[id_, pixels.shape[1] - 1]) / np.float32(255.0)
    for channel in range(3):
        colour = np.float32(pixels[id_, channel]) / np.float32(255.0)
        if gains.shape[0] > 0 and pixels[id_, channel] < 255:  # what is clipped stays white, as in RayDataset
            colour = min(colour / gains[view, channel], np.float32(1.0))
        batch.target[n, channel] = colour * alpha + (np.float32(1.0) - alpha) * batch.background[n, channel]
