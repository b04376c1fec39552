"""The ground of a scene: the plane that much of what is seen from above lies in, with nearly all of the rest higher.

Planes through three random points of the surface are tried (RANSAC), and the best one is fitted to all points that lie in it.
"""

from math import radians, sin

import numpy as np

from console import UserError
from scenepack.blocks import block_copy
from scenepack.pack import Pack

SURFACE = 0.5  # opacity of a voxel that may be ground
MOST_POINTS = 4000  # that are looked at
TRIES, TOGETHER = 6000, 500  # planes, and how many of them at once
THICK = 1.5  # voxels on either side of a plane that count as lying in it
LEAST_SHARE = 0.15  # of the points that lie in the ground
BELOW_SHARE = 0.1  # of the points that may lie below it
LEAST_WIDTH = 0.25  # of the ground across, of that of all points
NARROWEST = radians(5.0)  # angle of a triangle that tells a plane
STEEPEST = radians(60.0)  # from what is up now
FITS = 3  # to the points in the plane of the fit before


def ground_plane(pack: Pack, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A point of the ground and what is up there, a unit vector; float64 [3] both, grid frame. up: what is up now, float [3].

    UserError where there is no such plane.
    """
    nothing = UserError("no ground was found in the scene", remedy="click on three points of it, on the Move page")
    points, thick = _surface_points(pack, up), THICK * pack.voxel_size
    if pack.ndc or len(points) < 3:
        raise nothing
    rng, best, most = np.random.default_rng(0), None, 0.0
    for _ in range(TRIES // TOGETHER):
        a, b, c = points[rng.integers(0, len(points), (3, TOGETHER))]
        normals = np.cross(b - a, c - a)
        sizes = np.linalg.norm(normals, axis=1)
        wide = sizes > sin(NARROWEST) * np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
        normals, a = normals[wide] / sizes[wide, None], a[wide]
        normals *= np.copysign(1.0, normals @ up)[:, None]
        heights = points @ normals.T - np.sum(a * normals, axis=1)
        below = np.count_nonzero(heights < -2 * thick, axis=0)
        allowed = (below <= BELOW_SHARE * len(points)) & (normals @ up >= np.cos(STEEPEST) * np.linalg.norm(up))
        counts = np.count_nonzero(np.abs(heights) <= thick, axis=0) * allowed
        index = int(np.argmax(counts)) if len(counts) else 0
        if len(counts) and counts[index] > most:
            best, most = (a[index], normals[index]), counts[index]
    if best is None:
        raise nothing
    at, normal = best
    for _ in range(FITS):
        inside = points[np.abs((points - at) @ normal) <= thick]
        at = inside.mean(axis=0)
        _, spread, axes = np.linalg.svd(inside - at, full_matrices=False)
        normal = axes[2] * np.copysign(1.0, axes[2] @ normal)
    narrow = spread[1] / np.sqrt(len(inside)) < LEAST_WIDTH * points.std(axis=0).max()
    if narrow or len(inside) < LEAST_SHARE * len(points):
        raise nothing
    return at, normal


def _surface_points(pack: Pack, up: np.ndarray) -> np.ndarray:
    """Some of the opaque voxels that are clear above, float64 [n, 3], grid frame; of contracted packs, in the inner cube."""
    axis, found = int(np.argmax(np.abs(up))), []
    above = [slice(1, -1)] * 3  # z, y, x
    above[2 - axis] = slice(2, None) if up[axis] > 0 else slice(None, -2)
    for z, y, x in np.argwhere(pack.occupied).tolist():
        opaque = block_copy(pack, pack.atlas_rgba, (z, y, x))[..., 3] >= 255 * SURFACE
        shown = np.argwhere(opaque[1:-1, 1:-1, 1:-1] & ~opaque[tuple(above)])
        found.append((shown + np.array([z, y, x]) * pack.block_size)[:, ::-1] + 0.5)
    points = pack.min_xyz + pack.voxel_size * (np.concatenate(found) if found else np.zeros((0, 3)))
    if pack.contraction is not None:
        points = points[np.abs(points).max(axis=1) <= pack.contraction]
    return np.random.default_rng(0).permutation(points)[:MOST_POINTS]
