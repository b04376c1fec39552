"""The occupancy grid: which cells of the unit cube samples are taken in.

Notation: R³ cells [z, y, x], each with a code, uint8. NEVER: nothing can be there, by the photographs' alpha or because too few
photographs see it. Otherwise the number of visits that the cell stays on: a visit takes the density at a random point of the
cell and sets

    code <- max(code - 1, code of the density),

where the code of a density is how many visits its optical depth over STEP of the cube's side takes to fall below a threshold at a
rate of DECAY a visit (instant-ngp, Müller et al. 2022, appendix E, in logarithms).
"""

from collections.abc import Callable

import numpy as np

from training.multires.settings import Settings

NEVER = 255
DECAY, LONGEST = 0.8, 40  # LONGEST: visits that the densest cell stays on
STEP = 1 / 512  # of the cube's side
INITIAL = 5  # visits that a cell of the hull stays on
TOGETHER = 512  # cells in a row of which all or none are visited
SHARE = 4  # a visit takes one in so many
FADED_WHOLE = 3  # what codes lose by a visit to the whole grid, instead of 1
POINTS = 1 << 20  # of which densities are asked at once
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
