"""Which table rows surround samples, level by level, and their trilinear weights; features gathered, gradients scattered.

Notation: BLOCK samples at x, y, z in the unit cube; ids int32 and weights float32 are flat [8, BLOCK], corner k in bits zyx;
cells int32 is flat [3, BLOCK]. See training.multires.levels for the numbering of rows. Indices that are known not to be negative
are unsigned (U): Numba does not turn those around, and LLVM makes vectors of the loops.
"""

# pyright: reportCallIssue=false

import numpy as np
from numba import njit

from training.multires.fused.compiled import kernel
from training.multires.fused.vectors import FEATURES, LINE, add_to_row, blend_row, prefetch_row
from training.multires.levels import DENSE, HASH_Y, HASH_Z, HASHED, HASHED_ROWS

BLOCK = 16  # samples whose corners are computed together
CORNERS = 8 * BLOCK
PREFETCHED_ROWS = 16_384  # a level of fewer rows stays in the cache by itself
MARKED_ROWS = LINE // FEATURES  # that share a mark
U = np.uintp


@kernel
def corners(levels, level, xs, ys, zs, at, ids, weights, out, cells):
    """Sets ids and weights, from `out`, of the samples at … at + BLOCK - 1 at a level; ids count from the table's first row."""
    side = levels.resolution[level]
    resolution, last, none, one = np.float32(side), np.int32(side - 1), np.int32(0), np.float32(1.0)
    for s in range(BLOCK):
        x, y, z = xs[U(at + s)] * resolution, ys[U(at + s)] * resolution, zs[U(at + s)] * resolution
        i, j = min(max(np.int32(x), none), last), min(max(np.int32(y), none), last)
        k = min(max(np.int32(z), none), last)
        cells[U(s)], cells[U(BLOCK + s)], cells[U(2 * BLOCK + s)] = i, j, k
        fx, fy, fz = x - np.float32(i), y - np.float32(j), z - np.float32(k)
        gx, gy, gz = one - fx, one - fy, one - fz
        a, b, c, d = gx * gy, fx * gy, gx * fy, fx * fy
        weights[U(out + s)], weights[U(out + BLOCK + s)] = a * gz, b * gz
        weights[U(out + 2 * BLOCK + s)], weights[U(out + 3 * BLOCK + s)] = c * gz, d * gz
        weights[U(out + 4 * BLOCK + s)], weights[U(out + 5 * BLOCK + s)] = a * fz, b * fz
        weights[U(out + 6 * BLOCK + s)], weights[U(out + 7 * BLOCK + s)] = c * fz, d * fz
    if levels.place[level] == DENSE:
        _dense_rows(side + 1, levels.offset[level], ids, out, cells)
    elif levels.place[level] == HASHED:
        _hashed_rows(levels.offset[level], ids, out, cells)
    else:
        _brick_rows(side // 4 + 1, levels.place[level], levels.offset[level], levels.maps, ids, out, cells)


@kernel
def _dense_rows(width, first, ids, out, cells):
    """Rows of a level with a row for each of width³ vertices."""
    line, plane = np.int32(width), np.int32(width * width)
    for s in range(BLOCK):
        row = np.int32(first + cells[U(2 * BLOCK + s)] * plane + cells[U(BLOCK + s)] * line + cells[U(s)])
        ids[U(out + s)], ids[U(out + BLOCK + s)] = row, row + 1
        ids[U(out + 2 * BLOCK + s)], ids[U(out + 3 * BLOCK + s)] = row + line, row + line + 1
        ids[U(out + 4 * BLOCK + s)], ids[U(out + 5 * BLOCK + s)] = row + plane, row + plane + 1
        ids[U(out + 6 * BLOCK + s)], ids[U(out + 7 * BLOCK + s)] = row + plane + line, row + plane + line + 1


@kernel
def _hashed_rows(first, ids, out, cells):
    """Rows of a level whose vertices share HASHED_ROWS."""
    mask, one, of_y, of_z = np.uint32(HASHED_ROWS - 1), np.uint32(1), np.uint32(HASH_Y), np.uint32(HASH_Z)
    start = np.int32(first)
    for s in range(BLOCK):
        x = np.uint32(cells[U(s)])
        y, z = np.uint32(np.uint32(cells[U(BLOCK + s)]) * of_y), np.uint32(np.uint32(cells[U(2 * BLOCK + s)]) * of_z)
        x1, y1, z1 = np.uint32(x + one), np.uint32(y + of_y), np.uint32(z + of_z)
        ids[U(out + s)] = start + np.int32((x ^ y ^ z) & mask)
        ids[U(out + BLOCK + s)] = start + np.int32((x1 ^ y ^ z) & mask)
        ids[U(out + 2 * BLOCK + s)] = start + np.int32((x ^ y1 ^ z) & mask)
        ids[U(out + 3 * BLOCK + s)] = start + np.int32((x1 ^ y1 ^ z) & mask)
        ids[U(out + 4 * BLOCK + s)] = start + np.int32((x ^ y ^ z1) & mask)
        ids[U(out + 5 * BLOCK + s)] = start + np.int32((x1 ^ y ^ z1) & mask)
        ids[U(out + 6 * BLOCK + s)] = start + np.int32((x ^ y1 ^ z1) & mask)
        ids[U(out + 7 * BLOCK + s)] = start + np.int32((x1 ^ y1 ^ z1) & mask)


@kernel
def _brick_rows(bricks, place, first, maps, ids, out, cells):
    """Rows of a level of bricks, so many along each axis, whose map begins at place."""
    bricks, place, first = np.int32(bricks), np.int32(place), np.int32(first)
    one, two, three, four, six = np.int32(1), np.int32(2), np.int32(3), np.int32(4), np.int32(6)
    for s in range(BLOCK):
        i, j, k = cells[U(s)], cells[U(BLOCK + s)], cells[U(2 * BLOCK + s)]
        i1, j1, k1 = i + one, j + one, k + one
        x, x1 = i >> two, i1 >> two
        near, far = place + (k >> two) * bricks * bricks, place + (k1 >> two) * bricks * bricks
        y, y1 = (j >> two) * bricks, (j1 >> two) * bricks
        i, i1 = first + (i & three), first + (i1 & three)
        j, j1, k, k1 = (j & three) << two, (j1 & three) << two, (k & three) << four, (k1 & three) << four
        ids[U(out + s)] = (maps[U(near + y + x)] << six) + i + j + k
        ids[U(out + BLOCK + s)] = (maps[U(near + y + x1)] << six) + i1 + j + k
        ids[U(out + 2 * BLOCK + s)] = (maps[U(near + y1 + x)] << six) + i + j1 + k
        ids[U(out + 3 * BLOCK + s)] = (maps[U(near + y1 + x1)] << six) + i1 + j1 + k
        ids[U(out + 4 * BLOCK + s)] = (maps[U(far + y + x)] << six) + i + j + k1
        ids[U(out + 5 * BLOCK + s)] = (maps[U(far + y + x1)] << six) + i1 + j + k1
        ids[U(out + 6 * BLOCK + s)] = (maps[U(far + y1 + x)] << six) + i + j1 + k1
        ids[U(out + 7 * BLOCK + s)] = (maps[U(far + y1 + x1)] << six) + i1 + j1 + k1


@kernel
def _prepare(levels, table, xs, ys, zs, first, ids, weights, out, cells):
    """Corners of the samples first … first + BLOCK - 1 at all levels, from `out`, and their rows on the way to the cache."""
    for level in range(levels.resolution.size):
        if levels.offset[level] >= 0:
            corners(levels, level, xs, ys, zs, first, ids, weights, out + level * CORNERS, cells)
            if levels.rows[level] > PREFETCHED_ROWS:
                _prefetch(table, ids, out + level * CORNERS)


@kernel
def _prefetch(table, ids, out):
    """Asks for the rows of ids from `out`; a neighbour along x mostly shares the cache line."""
    for i in range(0, CORNERS, 2 * BLOCK):
        for s in range(BLOCK):
            prefetch_row(table, ids[U(out + i + s)])


@kernel
def encode(field, scratch, first, samples):
    """scratch.x [., inputs]: the features of so many samples from `first`, whole blocks; see training.multires.fused.chunk."""
    levels, table, ids, weights, cells = field.levels, field.table, scratch.ids, scratch.corner_weights, scratch.cells
    xs, ys, zs, half, blocks = scratch.xs, scratch.ys, scratch.zs, scratch.ids.size // 2, samples // BLOCK
    _prepare(levels, table, xs, ys, zs, first, ids, weights, 0, cells)
    for block in range(blocks):
        start, own = first + block * BLOCK, (block & 1) * half
        if block + 1 < blocks:
            _prepare(levels, table, xs, ys, zs, start + BLOCK, ids, weights, half - own, cells)
        for level in range(levels.resolution.size):
            if levels.offset[level] < 0:
                continue
            corner = own + level * CORNERS
            for s in range(BLOCK):
                to = (start + s) * field.inputs + level * FEATURES
                blend_row(table, ids, weights, corner + s, BLOCK, scratch.x, to)


@njit(nogil=True, cache=True)
def scatter(levels, level, output, low, high, gradient, marks):
    """Adds the slopes of a level's features to the gradient of its vertices, in the samples' order.

    output: of training.multires.fused.chunk. Only vertices whose z is in [low, high) receive anything, so that several
    workers may share a level and each row's sum still runs in one order. marks uint8: set for each MARKED_ROWS rows
    that change.
    """
    counts, xs, ys, zs, slopes = output.counts, output.xs, output.ys, output.zs, output.slopes
    capacity, level_start = xs.size // counts.size, level * xs.size
    ids, weights = np.empty(2 * CORNERS, np.int32), np.empty(2 * CORNERS, np.float32)
    px, py, pz = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    picked, planes, cells = np.empty(capacity, np.int64), np.empty(capacity, np.int64), np.empty(3 * BLOCK, np.int32)
    resolution, far = np.float32(levels.resolution[level]), levels.rows[level] > PREFETCHED_ROWS
    last = levels.resolution[level] - 1
    for chunk in range(counts.size):
        count = 0
        for n in range(chunk * capacity, chunk * capacity + counts[chunk]):
            cell = min(max(np.int64(zs[U(n)] * resolution), 0), last)
            if cell + 1 >= low and cell < high:
                picked[count], planes[count] = n, cell
                count += 1
        blocks = -(-count // BLOCK)
        for block in range(blocks + 1):
            if block < blocks:
                for s in range(BLOCK):
                    n = picked[min(block * BLOCK + s, count - 1)]
                    px[s], py[s], pz[s] = xs[n], ys[n], zs[n]
                own = (block & 1) * CORNERS
                corners(levels, level, px, py, pz, 0, ids, weights, own, cells)
                if far:
                    _prefetch(gradient, ids, own)
            if block > 0:  # its rows were asked for a block ago
                start, corner = (block - 1) * BLOCK, (1 - (block & 1)) * CORNERS
                for s in range(min(BLOCK, count - start)):
                    cell, at = planes[start + s], (level_start + picked[start + s]) * FEATURES
                    for k in range(0 if cell >= low else 4, 8 if cell + 1 < high else 4):
                        n = ids[U(corner + k * BLOCK + s)]
                        add_to_row(gradient, n, weights[U(corner + k * BLOCK + s)], slopes, at)
                        marks[U(n // MARKED_ROWS)] = 1
