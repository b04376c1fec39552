"""How far away a camera stands so that what a pack shows fills its picture.

Measured is the convex hull around what can be seen: in the outer macroblocks, the box around voxels of some opacity. Small
pieces apart from the rest, as training leaves in empty space, would push the camera far away; they are not counted.
"""

from math import radians, tan

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull

from scenepack.blocks import block_data
from scenepack.pack import Pack, cached_per_pack
from scenepack.placement import placement_of
from viewer.rendering.camera import ORBIT_ELEVATION, ViewCamera, box_points, content_box, inner_box, orbit_path

MARGIN = 1.05  # of half the picture over what is seen
STRAY = 0.01  # of the macroblocks: a piece with fewer is not counted
OUTER = 1.8  # macroblocks: those closer to the hull than their diagonal may touch it
SEEN = 26  # of 255: opacity of a voxel that can be seen
TOUCHING = np.ones((3, 3, 3), bool)  # corners, too


def counted_blocks(pack: Pack) -> np.ndarray:
    """The occupied macroblocks without stray pieces, bool [z, y, x]; of contracted packs, those in the inner cube."""
    occupied = pack.occupied
    if pack.contraction is not None:
        low, high = inner_box(pack)
        outer = np.ones_like(occupied)
        first, last = np.floor(low / pack.block_size).astype(int), np.ceil(high / pack.block_size).astype(int)
        outer[tuple(slice(a, b) for a, b in zip(first[::-1], last[::-1], strict=True))] = False
        occupied = occupied & ~outer
    pieces, count = ndimage.label(occupied, TOUCHING)  # pyright: ignore[reportGeneralTypeIssues]
    if count < 2:
        return occupied
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    kept = sizes >= STRAY * sizes.sum()
    return kept[pieces] if kept.any() else occupied


@cached_per_pack
def outline(pack: Pack) -> np.ndarray:
    """Corners of the hull around what is counted, float64 [n, 3], grid frame; of the grid where a pack is empty."""
    blocks = np.argwhere(counted_blocks(pack))  # z, y, x
    if not len(blocks):
        return box_points(*content_box(pack))
    size = pack.block_size
    corners = box_points(blocks[:, ::-1] * size, (blocks[:, ::-1] + 1) * size).reshape(-1, 3)
    hull = ConvexHull(corners)
    middles = (blocks[:, ::-1] + 0.5) * size
    inside = -(middles @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)  # to the hull's nearest face
    boxes = [box for block in blocks[inside < OUTER * size] if (box := _seen_box(pack, block)) is not None]
    if boxes:
        corners = box_points(*np.stack(boxes, axis=1)).reshape(-1, 3)
    if np.linalg.matrix_rank(corners - corners[0]) == 3:
        corners = corners[ConvexHull(corners).vertices]
    return pack.min_xyz + pack.voxel_size * np.clip(corners, *inner_box(pack))


def _seen_box(pack: Pack, block: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Corners (x, y, z; voxels of the grid) of the box around what is seen of a macroblock (z, y, x); None where nothing is."""
    seen = block_data(pack, pack.atlas_rgba, tuple(block))[..., 3] >= SEEN
    if not seen.any():
        return None
    spans = [np.flatnonzero(seen.any(axis=axes)) for axes in ((0, 1), (0, 2), (1, 2))]  # along x, y, z
    low, high = (np.array([span[end] for span in spans], np.float64) for end in (0, -1))
    start = block[::-1] * float(pack.block_size)
    return start + low, start + high + 1.0


def middle_of(points: np.ndarray) -> np.ndarray:
    """The middle of the box around points [n, 3]."""
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def filling_distance(local: np.ndarray, fov: float, aspect: float, *, orthographic: bool = False) -> float:
    """The least distance from which all points are in the picture; above 0.

    local: float [n, 3], about the point looked at, in camera axes (x right, y up, z back). fov: vertical, degrees. aspect:
    width over height. orthographic: the distance at which a perspective picture is as high as that of parallel rays.
    """
    half = tan(0.5 * radians(fov)) * np.array([aspect, 1.0])
    across = (MARGIN * np.abs(local[:, :2]) / half).max(axis=1)
    return max(float((across if orthographic else across + local[:, 2]).max()), 1e-6)


def filling_orbit(
    pack: Pack, frames: int, fov_degrees: float, size: tuple[int, int], first: float = 0.0
) -> list[ViewCamera]:
    """One turn about the placed frame's y axis in which no view cuts anything off (of forward-facing packs, orbit_path).

    fov_degrees: vertical. size: width, height in pixels. first: azimuth of the first view, degrees, as ViewCamera.orbit takes it.
    """
    if pack.ndc:
        return orbit_path(pack, frames, fov_degrees, size)
    azimuths = [first + 360.0 * i / frames for i in range(frames)]
    points, placed = outline(pack), np.array(placement_of(pack).rotation)
    middle, distance = middle_of(points), 0.0

    def orbit(azimuth: float, distance: float) -> ViewCamera:
        camera = ViewCamera.orbit(pack, azimuth, ORBIT_ELEVATION, distance, fov_degrees, size, np.zeros(3))
        camera.grid_T_camera[:3] = placed.T @ camera.grid_T_camera[:3]
        camera.grid_T_camera[:3, 3] += middle
        return camera

    for azimuth in azimuths:
        axes = orbit(azimuth, 1.0).grid_T_camera[:3, :3]
        distance = max(distance, filling_distance((points - middle) @ axes, fov_degrees, size[0] / size[1]))
    return [orbit(azimuth, distance) for azimuth in azimuths]
