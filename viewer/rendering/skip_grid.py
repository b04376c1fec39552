"""Skip grid: how far each cell is from content; and the hull of the content.

A box around the content would do, but more pixels see it (docs/notebook.md).

Notation: a *texel cube* j is the cube within which trilinear interpolation blends the same 2^3 voxels, j and j + 1 along
each axis: it spans j + 0.5 ... j + 1.5, and j = -1 ... n - 1. A *cell* i is `CELL`^3 texel cubes, from CELL * i - 0.5 to
CELL * (i + 1) - 0.5 along each axis; cells cover the whole grid, also where it is empty. A cell has content where any
sample in it could be anything but zero. Its Chebyshev distance D, in cells, to the nearest cell with content (0: it has
some itself) says that the cube of (2 D - 1)^3 cells around it is empty. An *eighth* of a cell is a cell of half the size.
Source: distance-field skipping after Cohen and Sheffer, "Proximity clouds" (1994), on cells chosen for docs/rendering.md.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull

from scenepack.blocks import block_copy
from scenepack.pack import Pack, cached_per_pack

COARSE = 32  # coarse cells along the longest side; the hull goes around these
MARGIN = 1.0  # voxels that it is grown by at least: more than rasterising could round


def hull_triangles(content: np.ndarray) -> np.ndarray:
    """float32 [T, 3, 3] corners (x, y, z), voxels, counter-clockwise seen from outside; none where there is no content.

    content: bool [cells z, y, x].
    """
    if not content.any():
        return np.zeros((0, 3, 3), np.float32)
    group = -(-max(content.shape) // COARSE)
    boxes = _rows(content, group) * CELL - 0.5  # [N, 2 ends, (x, y, z)]
    side = np.indices((2, 2, 2)).reshape(3, -1).T  # of the eight corners
    corners = boxes[:, side, np.arange(3)]
    # Grown outwards, each corner by another amount: then no two triangles lie in one plane, and none is degenerate.
    grown = np.random.default_rng(0).uniform(MARGIN, 2 * MARGIN, corners.shape)
    points = (corners + (2 * side - 1) * grown).reshape(-1, 3)
    hull = ConvexHull(points)
    triangles = points[hull.simplices]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return triangles.astype(np.float32)


def _rows(content: np.ndarray, group: int) -> np.ndarray:
    """int [N, 2, 3]: first and one past the last cell (x, y, z) of each row of group × group cells along x with content.

    What lies between the ends of a row is inside of any hull around them.
    """
    pad = [(0, -n % group) for n in content.shape[:2]] + [(0, 0)]
    z, y, x = content.shape
    rows = np.pad(content, pad).reshape(-(-z // group), group, -(-y // group), group, x)
    rows = np.asarray(rows.any(axis=(1, 3)))
    k, j = np.nonzero(rows.any(axis=2))
    some = rows[k, j]
    first, last = some.argmax(axis=1), x - some[:, ::-1].argmax(axis=1)
    low = np.stack([first, j * group, k * group], -1)
    high = np.stack([last, np.minimum((j + 1) * group, y), np.minimum((k + 1) * group, z)], -1)
    return np.stack([low, high], 1)


# --- How far a ray may jump ---

CELL = 4  # texel cubes a side; 1 and 2 were slower, 3 no faster (docs/performance.md)
FARTHEST = 255


@dataclass(frozen=True)
class SkipGrid:
    """What rays may jump over."""

    words: np.ndarray  # uint16 [cells z, y, x], see skip_words
    content_min: np.ndarray  # float64 [3] (x, y, z), voxels: corners of the box around all cells with content, ...
    content_max: np.ndarray  # ... both zero where none has
    hull: np.ndarray  # float32 [T, 3, 3], see hull_triangles


@cached_per_pack
def skip_grid_of(pack: Pack) -> SkipGrid:
    words = skip_words(content_eighths(pack))
    content = words & FARTHEST == 0
    low, high = np.zeros(3), np.zeros(3)
    if len(cells := np.argwhere(content)[:, ::-1]):
        low, high = CELL * cells.min(axis=0) - 0.5, CELL * (cells.max(axis=0) + 1) - 0.5
    return SkipGrid(words, low, high, hull_triangles(content))


def skip_words(eighths: np.ndarray) -> np.ndarray:
    """uint16 [cells z, y, x]: a cell's distance, at most FARTHEST, in the low byte, its eighths with content above it.

    eighths: bool [z, y, x], as content_eighths has them. Bit 8 + dx + 2 dy + 4 dz is that of eighth (dx, dy, dz).
    """
    shape = [-(-n // 2) for n in eighths.shape]
    bits = np.zeros(shape, np.uint16)
    for bit, (dz, dy, dx) in enumerate(np.ndindex(2, 2, 2)):
        some = eighths[dz::2, dy::2, dx::2]
        z, y, x = some.shape
        bits[:z, :y, :x] |= some.astype(np.uint16) << (8 + bit)
    if not bits.any():
        return np.full_like(bits, FARTHEST)
    distance: Any = ndimage.distance_transform_cdt(bits == 0, metric="chessboard")
    return bits | np.minimum(distance, FARTHEST).astype(np.uint8)


def content_eighths(pack: Pack) -> np.ndarray:
    """bool [z, y, x], of eighths of cells: where a sample may find content.

    A texel cube across a macroblock's border counts for both macroblocks, whose padded copies need not agree.
    """
    size, side = pack.block_size, pack.padded_block_size
    cells = np.zeros([n * size // 2 + 1 for n in pack.grid_blocks[::-1]], bool)
    for block in map(tuple, np.argwhere(pack.occupied).tolist()):
        first = [b * size for b in block]  # of the copy's first texel cube, counted from j = -1
        before = [f % 2 for f in first]  # cubes of the first eighth that are the neighbour's
        voxels = np.zeros([(b + side) // 2 * 2 + 1 for b in before], bool)
        voxels[tuple(slice(b, b + side) for b in before)] = block_copy(pack, pack.atlas_rgba, block)[..., 3] > 0
        # Two cubes along an axis blend three voxels
        voxels = voxels[:-1:2] | voxels[1::2] | voxels[2::2]
        voxels = voxels[:, :-1:2] | voxels[:, 1::2] | voxels[:, 2::2]
        content = voxels[..., :-1:2] | voxels[..., 1::2] | voxels[..., 2::2]
        at = tuple(slice(f // 2, f // 2 + n) for f, n in zip(first, content.shape, strict=True))
        cells[at] |= content[tuple(slice(0, c.stop - c.start) for c in at)]
    return cells
