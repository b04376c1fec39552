"""The occupancy grid: which cells of the unit cube samples are taken in.

Notation: R³ cells [z, y, x], each with a code, uint8. NEVER: nothing can be there, by the photographs' alpha or because too few
photographs see it. Otherwise the number of visits that the cell stays on: a visit takes the density at a random point of the
cell and sets

    code <- max(code - 1, code of the density),

where the code of a density is how many visits its optical depth over STEP of the cube's side takes to fall below a threshold at a
rate of DECAY a visit (instant-ngp, Müller et al. 2022, appendix E, in logarithms).

Before the first step, a cell is on where anything can be by the training photographs: what the alpha of most leaves over, and
what enough of them see. V views; a cell is taken for the ball around it, of which a view's picture shows at most a square.
"""

# pyright: reportCallIssue=false

from collections.abc import Callable

import numpy as np
from numba import njit
from scipy import ndimage

from scenepack.constants import NDC_NEAR
from training.dataset import RayDataset
from training.multires.fused.compiled import Workers
from training.multires.fused.rays import LENS, Photographs, photographs_of
from training.multires.settings import Settings
from training.multires.state import Box
from training.scenes.lens import EQUIRECTANGULAR, PERSPECTIVE, PROJECTION, REACH

NEVER = 255
DECAY, LONGEST = 0.8, 40  # LONGEST: visits that the densest cell stays on
STEP = 1 / 512  # of the cube's side
INITIAL = 5  # visits that a cell of the hull stays on
TOGETHER = 512  # cells in a row of which all or none are visited
SHARE = 4  # a visit takes one in so many
FADED_WHOLE = 3  # what codes lose by a visit to the whole grid, instead of 1
POINTS = 1 << 20  # of which densities are asked at once
SPECK = 1e-3  # of the largest part's cells
WITHIN = 1 - 1e-6  # of the inner cube's side: in the last cell before its edge
SAMPLES_PER_PAIR = 16  # of a step, to each pair of points that the smoothness loss compares


def is_on(codes: np.ndarray) -> np.ndarray:
    """bool [R, R, R]: where samples are taken."""
    return (codes > 0) & (codes < NEVER)


def code_of(density: np.ndarray, threshold: float) -> np.ndarray:
    """uint8 codes of densities per side of the cube."""
    with np.errstate(divide="ignore"):
        visits = np.ceil(np.log(density * np.float32(STEP / threshold)) / -np.log(DECAY))
    return np.clip(visits, 0, LONGEST).astype(np.uint8)


def visited(
    codes: np.ndarray, density_at: Callable[[np.ndarray], np.ndarray], random: np.random.Generator, threshold: float,
    whole: bool,
) -> np.ndarray:  # fmt: skip
    """Codes after a visit to a random SHARE of the cells, or to the whole grid. density_at: of points float32 [N, 3] of the unit
    cube."""
    faded = FADED_WHOLE if whole else 1
    flat, side = codes.ravel().copy(), codes.shape[0]
    picked = np.flatnonzero(flat != NEVER)
    if not whole:
        groups = -(-len(picked) // TOGETHER)
        chosen = np.flatnonzero(np.arange(groups) % SHARE == random.integers(SHARE))
        places = (chosen[:, None] * TOGETHER + np.arange(TOGETHER)).ravel()
        picked = picked[places[places < len(picked)]]
    for start in range(0, len(picked), POINTS):
        cells = picked[start : start + POINTS]
        z, rest = np.divmod(cells, side * side)
        y, x = np.divmod(rest, side)
        places = np.stack([x, y, z], -1).astype(np.float32) + random.random((len(cells), 3), np.float32)
        densities, old = density_at(places / np.float32(side)), flat[cells]
        flat[cells] = np.maximum(np.maximum(old, faded) - np.uint8(faded), code_of(densities, threshold))
    return flat.reshape(codes.shape)


def without_specks(codes: np.ndarray) -> np.ndarray:
    """Codes with NEVER for parts that touch no other and have less than SPECK of the largest one's cells: wrong masks leave them
    in the air, where few photographs look."""
    part = np.zeros(codes.shape, np.int32)
    ndimage.label(is_on(codes), np.ones((3, 3, 3)), output=part)
    sizes = np.bincount(part.ravel())
    sizes[0] = sizes[1:].max(initial=0)  # cells that are off stay as they are
    return np.where(sizes[part] < SPECK * sizes[0], NEVER, codes).astype(np.uint8)


def neighbouring_points(cells: np.ndarray, settings: Settings, random: np.random.Generator) -> np.ndarray:
    """Pairs [M, 2, 3] of points of the unit cube, for the smoothness loss: a random point of the occupancy grid's cells int [C],
    and one further along an axis by a cell of the finest level. None where there are no cells."""
    if not len(cells):
        return np.zeros((0, 2, 3), np.float32)
    side, count = settings.resolution, settings.samples // SAMPLES_PER_PAIR
    chosen = cells[random.integers(0, len(cells), count)]
    corner = np.stack([chosen % side, chosen // side % side, chosen // side**2], -1)
    pairs = np.repeat(((corner + random.random((count, 3))) / side).astype(np.float32)[:, None], 2, 1)
    pairs[np.arange(count), 1, random.integers(0, 3, count)] += np.float32(1 / settings.resolutions[-1])
    return np.minimum(pairs, np.float32(1 - 1e-6))


@njit(nogil=True, cache=True)
def located(points, origin, per_cell, dims, inner, codes):
    """Places float32 [N, 3] in the unit cube of points [N, 3] of the training frame, and which are in cells that are on, int [M].

    inner: half the side of the inner cube of contracted space, 0 where it is not; a voxel beyond one of its edges, to interpolate
    with, is as the edge.
    """
    places, on, count = np.empty_like(points), np.empty(len(points), np.int64), 0
    side, most, within = codes.shape[0], np.float32(inner), np.float32(WITHIN * inner)
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        a, b, c = np.abs(x), np.abs(y), np.abs(z)
        if most > 0 and max(a, b, c) > most:
            largest = 0 if a >= max(b, c) else 1 if b >= c else 2
            x = x if largest == 0 else min(max(x, -within), within)
            y = y if largest == 1 else min(max(y, -within), within)
            z = z if largest == 2 else min(max(z, -within), within)
        x, y, z = (x - origin[0]) * per_cell[0], (y - origin[1]) * per_cell[1], (z - origin[2]) * per_cell[2]
        places[n, 0], places[n, 1], places[n, 2] = x / np.float32(side), y / np.float32(side), z / np.float32(side)
        if 0 <= x < dims[0] and 0 <= y < dims[1] and 0 <= z < dims[2]:
            code = codes[np.int64(z), np.int64(y), np.int64(x)]
            if 0 < code < NEVER:
                on[count] = n
                count += 1
    return places, on[:count]


def boxes_meeting(occupied: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """bool [N]: which boxes, low to high [N, 3] in cells (x, y, z), meet a cell that is on; by a summed-area table."""
    table = np.zeros([n + 1 for n in occupied.shape], np.int32)
    sums = table[1:, 1:, 1:]
    sums[...] = occupied
    for axis in range(3):
        np.cumsum(sums, axis, out=sums)
    most = np.array(occupied.shape[::-1])
    a, b = np.clip(np.floor(low).astype(int), 0, most), np.clip(np.floor(high).astype(int) + 1, 0, most)
    count = np.zeros(len(low), np.int64)
    for corner in range(8):  # inclusion and exclusion over the box's corners
        x, y, z = ((a if corner >> axis & 1 else b)[:, axis] for axis in range(3))
        count += (-1) ** bin(corner).count("1") * table[z, y, x]
    return count > 0


# --- Before the first step: the hull of what the photographs show ---

COARSE = 4  # cells of the occupancy grid to a cell that is looked at first, along each axis
FINE = 128  # cells that are looked at along an axis of contracted space, where some lie close before cameras
TIGHT = 64  # cells along the box, of which those that hold something decide where the cube is
BEHIND = 1e-3  # depth below which a cell may reach behind the camera
DISAGREE = 0.2  # of the photographs that see a cell, the share whose masks may be wrong there; rendered alpha never is
AROUND = 0.5 * np.pi  # how much wider than it is a fisheye shows what lies before the camera, at most
_distort, _ideal = LENS.distort, LENS.ideal


def hull_codes(dataset: RayDataset, box: Box, side: int, least_views: int, workers: Workers) -> np.ndarray:
    """Codes uint8 [side, side, side] of an occupancy grid before step 0."""
    coarse = COARSE if dataset.facts.contraction is None else max(side // FINE, 1)
    possible = np.ones((side // coarse,) * 3, np.uint8)
    _look(dataset, box, possible, coarse, least_views, workers)
    for axis in range(3):
        possible = np.repeat(possible, coarse, axis)
    if dataset.kind == "object":
        _look(dataset, box, possible, 1, 0, workers)
    z, y, x = (np.arange(side) for _ in range(3))
    inside = (z < box.dims[2])[:, None, None] & (y < box.dims[1])[:, None] & (x < box.dims[0])
    return np.where((possible > 0) & inside, INITIAL, NEVER).astype(np.uint8)


def box_around(dataset: RayDataset, side: int, depth: float, workers: Workers) -> Box:
    """The cube around the scene's box, or around what alpha leaves over of it. depth: of a cell along z, by its width."""
    low, high = dataset.aabb.astype(np.float64)
    if dataset.kind == "object":
        rough = _cube(low, high, TIGHT, 1.0)
        possible = np.ones((TIGHT,) * 3, np.uint8)
        _look(dataset, rough, possible, 1, 0, workers)
        places = np.argwhere(possible)[:, ::-1]
        if len(places):
            within = rough.origin + (places.min(0) - 1) * rough.cell, rough.origin + (places.max(0) + 2) * rough.cell
            low, high = np.maximum(low, within[0]), np.minimum(high, within[1])
    return _cube(low, high, side, depth)


def _cube(low: np.ndarray, high: np.ndarray, side: int, depth: float) -> Box:
    """Cells for a box, as wide as deep, but for z, where a cell is `depth` times as deep."""
    shape = np.array([1.0, 1.0, depth])
    cell = ((high - low) / shape).max() / side * shape
    dims = np.clip(np.ceil((high - low) / cell - 1e-6), 1, side)
    return Box(np.asarray(low, np.float64), cell, dims.astype(np.int32))


def _look(
    dataset: RayDataset, box: Box, possible: np.ndarray, coarse: int, least_views: int, workers: Workers
) -> None:  # fmt: skip
    """Clears the cells of `possible`, `coarse` times as large as the box's, where more than DISAGREE of the photographs that
    look there show nothing, or that fewer than least_views look at; in contracted space those, too, that are nearer to a
    camera than its rays begin."""
    photographs, cut_out = photographs_of(dataset.local()), dataset.kind == "object"
    ends = np.append(photographs.first[1:], dataset.count)
    counts = np.zeros((2, *possible.shape), np.int32)  # views that see a cell; of these, those that show nothing there
    disagree = 0.0 if dataset.facts.rendered else DISAGREE
    most = int(disagree * len(ends))
    side = possible.shape[0]
    for view, (first, last) in enumerate(zip(photographs.first, ends, strict=True)):
        width = int(photographs.width[view])
        rows = int(last - first) // width
        table = np.zeros((rows + 1, width + 1), np.int32)
        if cut_out:
            ids = np.arange(first, last, dtype=np.int32)
            pixels = photographs.pixels[first:last] if dataset.mesh.size == 1 else dataset.pixels_here(ids)
            shows = pixels[:, -1].reshape(rows, width) > 0
            np.cumsum(np.cumsum(shows, 0, dtype=np.int32), 1, out=table[1:, 1:])

        def look(_: int, z: int, view: int = view, table: np.ndarray = table) -> None:
            _look_at_layer(photographs, view, table, cut_out, box.origin, box.cell * coarse, possible, counts, most, z)

        workers.share(side, look)
    possible[(counts[0] < least_views) | (counts[1] > disagree * counts[0])] = 0


@njit(nogil=True, cache=True)
def _look_at_layer(photographs: Photographs, view, table, cut_out, origin, cell, possible, counts, most, z):
    """One layer of cells, as one view sees them. table int32 [rows + 1, width + 1]: pixels that show something, summed; counts:
    see _look. most: a cell that more views than this show nothing of is empty, and not counted further."""
    pose, lens = photographs.world_T_camera[view], photographs.intrinsics[view]
    distortion, projection = photographs.distortion[view], photographs.distortion[view, PROJECTION]
    rows, width = table.shape[0] - 1, table.shape[1] - 1
    radius = 0.5 * np.sqrt(cell[0] ** 2 + cell[1] ** 2 + cell[2] ** 2)
    place, relative = np.empty(3), np.empty(3)
    for y in range(possible.shape[1]):
        for x in range(possible.shape[2]):
            if possible[z, y, x] == 0 or counts[1, z, y, x] > most:
                continue
            place[0], place[1], place[2] = x, y, z
            for axis in range(3):
                place[axis] = origin[axis] + (place[axis] + 0.5) * cell[axis]
            if photographs.ndc[2] > 0:
                _from_ndc(place, photographs.ndc)
            if photographs.contraction > 0 and not _uncontract(place, photographs.contraction):
                possible[z, y, x] = 0
                continue
            for axis in range(3):
                relative[axis] = place[axis] - pose[axis, 3]
            distance2 = relative[0] ** 2 + relative[1] ** 2 + relative[2] ** 2
            if photographs.contraction > 0 and distance2 < photographs.near**2:
                possible[z, y, x] = 0
            right = pose[0, 0] * relative[0] + pose[1, 0] * relative[1] + pose[2, 0] * relative[2]
            up = pose[0, 1] * relative[0] + pose[1, 1] * relative[1] + pose[2, 1] * relative[2]
            depth = -(pose[0, 2] * relative[0] + pose[1, 2] * relative[1] + pose[2, 2] * relative[2])
            flat = projection == PERSPECTIVE
            if flat and depth < BEHIND:
                continue
            a, b = _ideal(right, up, -depth, projection)
            r2 = a * a + b * b
            if r2 > distortion[REACH] ** 2:
                continue
            u, v = _distort(a, b, distortion)
            px, py = lens[0] * u + lens[2], (lens[1] * v + lens[3]) / photographs.row_step
            if px >= 0 and py >= 0 and px < width and py < rows:
                counts[0, z, y, x] += 1
            if not cut_out:
                continue
            if projection == EQUIRECTANGULAR:
                distance, down = np.sqrt(distance2), lens[1] / photographs.row_step
                if distance >= 2.0 * radius:
                    angle = np.arcsin(radius / distance)
                    counts[1, z, y, x] += not _in_panorama(table, px, py, b, angle, lens[0], down)
                continue
            if depth < 2.0 * radius:
                continue
            stretch = max(np.sqrt((u * u + v * v) / max(r2, 1e-12)), 1.0)  # by the lens
            # what is nearer than `depth` is larger
            reach = ((1.0 + r2) if flat else AROUND) * radius / (depth - radius) * stretch
            left, top = np.int64(np.floor(px - lens[0] * reach)), np.int64(np.floor(py - lens[1] * reach))
            past, below = np.int64(px + lens[0] * reach) + 1, np.int64(py + lens[1] * reach) + 1
            if left < 0 or top < 0 or past > width or below > rows:
                continue  # partly out of sight
            if _shown(table, left, top, past, below) == 0:
                counts[1, z, y, x] += 1


@njit(nogil=True, cache=True)
def _in_panorama(table, px, py, elevation, angle, across, down):
    """Whether a panorama shows something within `angle` of the direction at (px, py). across, down: pixels to a radian."""
    rows, width = table.shape[0] - 1, table.shape[1] - 1
    top, below = max(np.int64(np.floor(py - down * angle)), 0), min(np.int64(py + down * angle) + 1, rows)
    if abs(elevation) + angle >= 0.5 * np.pi:  # around a pole
        return _shown(table, 0, top, width, below) > 0
    reach = across * np.arcsin(np.sin(angle) / np.cos(elevation))
    left, past = np.int64(np.floor(px - reach)), np.int64(px + reach) + 1
    shown = _shown(table, max(left, 0), top, min(past, width), below)
    if left < 0:
        shown += _shown(table, max(left + width, 0), top, width, below)
    if past > width:
        shown += _shown(table, 0, top, min(past - width, width), below)
    return shown > 0


@njit(nogil=True, cache=True)
def _shown(table, left, top, past, below):
    """Pixels that show something, in columns left … past - 1 of rows top … below - 1."""
    return table[below, past] - table[top, past] - table[below, left] + table[top, left]


@njit(nogil=True, cache=True)
def _uncontract(place, inner):
    """A point of contracted space becomes one of the world: scenepack.contraction.uncontract. False where no point of the world
    is contracted to: beyond the sides of the inner cube along two axes or three."""
    largest = max(abs(place[0]), abs(place[1]), abs(place[2])) / inner
    outer = 0
    for axis in range(3):
        outer += abs(place[axis]) > inner
    if outer > 1:
        return False
    if largest > 1.0:
        w = 1.0 / (2.0 - min(largest, 2.0 - 1e-6))
        for axis in range(3):
            at = place[axis] / inner
            place[axis] = inner * (np.sign(at) * w if abs(at) == largest else at * w)
    return True


@njit(nogil=True, cache=True)
def _from_ndc(place, ndc):
    """A point of NDC space becomes one of the world: the inverse of training.scenes.scene.ndc_rays."""
    z = 2.0 * NDC_NEAR / min(place[2] - 1.0, -1e-6)
    place[0] *= -z * ndc[0] / (2.0 * ndc[2])
    place[1] *= -z * ndc[1] / (2.0 * ndc[2])
    place[2] = z
