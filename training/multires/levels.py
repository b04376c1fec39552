"""The levels of the feature table: which of its rows stand for which vertices.

Notation: a level of resolution n divides the unit cube into n³ cells and has features at its (n + 1)³ vertices (x, y, z in
0 … n). All levels share one table [E, FEATURES] of rows. A dense level has a row for each vertex, x fastest. A finer level has
rows only for bricks of 4³ vertices that lie near content; its map says which brick of its 64 rows each one has. Brick 0 of a
level stands for all that are absent: its features are zero and never learn. Blocks of 64 rows, as bricks are, begin at
multiples of 64. Where space is contracted, content lies everywhere: a level finer than HASHED_FROM has HASHED_ROWS rows, and its
vertices share them by a hash (instant-ngp, Müller et al. 2022, equation 4).
"""

from typing import Any, NamedTuple

import numpy as np

FEATURES = 4
DENSE, HASHED = -1, -2  # in place of where a level's map begins
BRICK = 4  # vertices of a brick along each axis
ROWS_OF_BRICK = BRICK**3
DENSE_UP_TO = 64  # resolution; finer levels are sparse
HASHED_FROM = 128  # resolution; finer levels of contracted space are hashed
HASHED_ROWS = 1 << 21
HASH_Y, HASH_Z = 2654435761, 805459861  # factors of y and z; of x it is 1
ALL_HASHED = np.array([-1], np.int32)  # in place of a level's bricks
INITIAL = 1e-4  # features begin between plus and minus this


class Levels(NamedTuple):
    """The L levels of a feature table."""

    resolution: np.ndarray  # int64 [L], as the next three
    offset: np.ndarray  # the first of its rows, -1 while it has none
    rows: np.ndarray  # how many
    place: np.ndarray  # where its map begins in maps, DENSE or HASHED for others
    maps: np.ndarray  # int32: brick of each 4³ vertices, x fastest

    @property
    def total(self) -> int:
        """Rows of the whole table."""
        return int(self.rows.sum())


class Level(NamedTuple):
    """A level as constants of a program: see Levels."""

    resolution: int
    offset: int
    place: int


def rows_at(level: Level, maps: Any, x: Any, y: Any, z: Any) -> Any:
    """Rows int32 of a level's vertices; x, y, z: int32 of any shape, of NumPy or JAX, as maps."""
    if level.place == HASHED:
        x, y, z = (v.astype(np.uint32) * np.uint32(factor) for v, factor in ((x, 1), (y, HASH_Y), (z, HASH_Z)))
        return level.offset + ((x ^ y ^ z) % HASHED_ROWS).astype(np.int32)
    if level.place == DENSE:
        width = level.resolution + 1
        return level.offset + (z * width + y) * width + x
    bricks = bricks_along(level.resolution)
    brick = maps[level.place + (z // BRICK * bricks + y // BRICK) * bricks + x // BRICK]
    within = (z % BRICK * BRICK + y % BRICK) * BRICK + x % BRICK
    return level.offset + brick * ROWS_OF_BRICK + within


def bricks_along(resolution: int) -> int:
    """Bricks of a level along each axis."""
    return resolution // BRICK + 1


def is_dense(resolution: int) -> bool:
    """Whether a level of this resolution has a row for every vertex."""
    return resolution <= DENSE_UP_TO


def make_levels(resolutions: tuple[int, ...], bricks: tuple[np.ndarray | None, ...]) -> Levels:
    """The levels with these bricks: int32 sorted flat numbers of the bricks present; None for a level that has no rows yet; empty
    for a dense one; ALL_HASHED."""
    offset, rows, place, maps = [], [], [], []
    for resolution, present in zip(resolutions, bricks, strict=True):
        offset.append(-1 if present is None else sum(rows))
        hashed = present is not None and np.array_equal(present, ALL_HASHED)
        place.append(DENSE if is_dense(resolution) else HASHED if hashed else sum(part.size for part in maps))
        if present is None:
            rows.append(0)
        elif hashed:
            rows.append(HASHED_ROWS)
        elif is_dense(resolution):
            rows.append(-(-((resolution + 1) ** 3) // ROWS_OF_BRICK) * ROWS_OF_BRICK)
        else:
            rows.append((len(present) + 1) * ROWS_OF_BRICK)
            numbers = np.zeros(bricks_along(resolution) ** 3, np.int32)
            numbers[present] = np.arange(1, len(present) + 1, dtype=np.int32)
            maps.append(numbers)
    fields = [np.array(values, np.int64) for values in (resolutions, offset, rows, place)]
    return Levels(fields[0], fields[1], fields[2], fields[3], np.concatenate(maps) if maps else np.zeros(1, np.int32))


def bricks_near(occupied: np.ndarray, resolution: int) -> np.ndarray:
    """int32, sorted: bricks with vertices of cells that touch `occupied` [R, R, R], grown by a cell; empty for a dense level."""
    if is_dense(resolution):
        return np.zeros(0, np.int32)
    side, count = occupied.shape[0], bricks_along(resolution)
    needed = occupied
    for axis in range(3):
        # vertex v is needed by cell c of the occupancy grid where c - 1 <= v side / resolution <= c + 2, rounded outwards
        first = np.floor((np.arange(count) * BRICK - 1) * side / resolution).astype(int) - 1
        last = np.ceil((np.arange(count) * BRICK + BRICK) * side / resolution).astype(int) + 1
        sums = np.zeros([n + (i == axis) for i, n in enumerate(needed.shape)], np.int32)
        np.cumsum(needed, axis, out=sums[tuple(slice(i == axis, None) for i in range(3))])
        low, high = np.clip(first, 0, side), np.clip(last, 0, side)
        needed = np.take(sums, high, axis) > np.take(sums, low, axis)
    return np.flatnonzero(needed).astype(np.int32)


def moved_rows(old: Levels, new: Levels, old_bricks: tuple, new_bricks: tuple) -> np.ndarray:
    """int64 [E new]: the row of the old table that each row of the new one was; -1 where there was none."""
    source = np.full(new.total, -1, np.int64)
    for level in range(len(new.resolution)):
        before, now = old_bricks[level], new_bricks[level]
        if before is None or now is None:
            continue
        first, target = old.offset[level], new.offset[level]
        if old.place[level] < 0:
            source[target : target + new.rows[level]] = first + np.arange(new.rows[level])
            continue
        _, in_old, in_new = np.intersect1d(before, now, assume_unique=True, return_indices=True)
        rows = np.arange(ROWS_OF_BRICK)
        to = (target + (in_new + 1)[:, None] * ROWS_OF_BRICK + rows).ravel()
        source[to] = (first + (in_old + 1)[:, None] * ROWS_OF_BRICK + rows).ravel()
    return source


def decay_of_blocks(levels: Levels, weight: float) -> np.ndarray:
    """float32 [E / 64], a factor for each block of rows: times a feature, it is the gradient of `weight` times the mean square of
    all features of its level. -1 for blocks that never learn (absent_rows)."""
    entries = np.maximum(levels.rows, 1) * FEATURES
    decay = np.repeat(np.float32(2 * weight) / entries.astype(np.float32), levels.rows // ROWS_OF_BRICK)
    for rows in absent_rows(levels):
        decay[rows.start // ROWS_OF_BRICK] = -1.0
    return decay


def absent_rows(levels: Levels) -> list[slice]:
    """The rows of the bricks 0: zero for ever."""
    return [
        slice(int(start), int(start) + ROWS_OF_BRICK)
        for start, place in zip(levels.offset, levels.place, strict=True)
        if start >= 0 and place >= 0
    ]
