"""Forward and backward through a chunk of rays: march, fetch, activate, composite, shade, and the slopes of all losses.

Notation, per sample n of a chunk: x raw values (8), s = sigmoid(x), tau optical depth, T transmittance before it, w = T alpha;
per ray: A = sum w s over colours and features, G = dL/dA, B = T behind everything. Losses are sums over rays, in units of one
ray: the caller divides by the number of rays that count, which is known only at the end.

    dL/dtau_n = T_n (1 - alpha_n) g_n - sum over m > n of w_m g_m - B dL/dB,    g_n = G · s_n + distortion's share
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from training.voxels.fused.bricks import Bricks, row_in, row_of
from training.voxels.fused.head import shade_chunk
from training.voxels.fused.rays import Batch
from training.voxels.fused.vectors import blend

CHUNK = 64  # rays that are worked on together; results depend on it in the last bits, never on threads
CLOSE = 1e-3  # steps: what is left to rounding when a ray jumps over empty space
LOG_LATER = 1e280  # a running product that is turned into a logarithm before it overflows
METRICS = 6
COLOUR, SQUARED, PENALTY, SCATTER, RAYS, SAMPLES = range(
    METRICS
)  # sums over rays: loss, clipped error, two losses, counts


class Numbers(NamedTuple):
    """Constants of a step, float32 but for the horizon: see training.voxels.state.Settings. scatter: distortion's weight over its
    spread, in steps; sparsity: its weight times the spacing's share."""

    step: np.float32
    shift: np.float32
    reference: np.float32
    horizon: np.int64
    sparsity: np.float32
    sparsity_scale: np.float32
    scatter: np.float32
    shaded_below: np.float32


class Work(NamedTuple):
    """What the chunks of a step leave for the rows. Chunk c has samples c * room … c * room + counts[c] - 1.

    ids int32, weights, slopes float32 [C * room, 8]; counts int64 [C]; lost int64 [C]: rays that did not fit. metrics float64
    [C, METRICS].
    """

    ids: np.ndarray
    weights: np.ndarray
    slopes: np.ndarray
    counts: np.ndarray
    lost: np.ndarray
    metrics: np.ndarray


class Scratch(NamedTuple):
    """What one worker needs for a chunk of up to `room` samples: t, pre (density before its activation), sigma, before (T),
    weight [room]; first int64 [CHUNK + 1]: where each ray's samples begin; behind [CHUNK]: T behind each ray."""

    t: np.ndarray
    pre: np.ndarray
    sigma: np.ndarray
    before: np.ndarray
    weight: np.ndarray
    first: np.ndarray
    behind: np.ndarray


def make_work(chunks: int, room: int) -> Work:
    """Memory for the samples of a step; what is not used is not touched, and costs nothing."""
    size = chunks * room
    return Work(
        np.empty((size, 8), np.int32), np.empty((size, 8), np.float32), np.empty((size, 8), np.float32),
        np.zeros(chunks, np.int64), np.zeros(chunks, np.int64), np.zeros((chunks, METRICS)),
    )  # fmt: skip


def make_scratch(room: int) -> Scratch:
    """Memory for one worker."""
    numbers = (np.empty(room, np.float32) for _ in range(5))
    return Scratch(*numbers, np.zeros(CHUNK + 1, np.int64), np.ones(CHUNK, np.float32))


@njit(nogil=True, cache=True)
def gather(bricks: Bricks, slot, x, y, z, fx, fy, fz, ids, weights, n):
    """Rows and trilinear weights of the 8 voxels around a point of cell (x, y, z), which lies in brick `slot`."""
    one = np.float32(1.0)
    if (x & 3) < 3 and (y & 3) < 3 and (z & 3) < 3:
        local = ((z & 3) * 4 + (y & 3)) * 4 + (x & 3)
        for corner in range(8):
            ids[n, corner] = row_in(bricks, slot, local + (corner >> 2) * 16 + (corner >> 1 & 1) * 4 + (corner & 1))
    else:
        for corner in range(8):
            ids[n, corner] = row_of(bricks, x + (corner & 1), y + (corner >> 1 & 1), z + (corner >> 2))
    for corner in range(8):
        wx = fx if corner & 1 else one - fx
        wy = fy if corner >> 1 & 1 else one - fy
        wz = fz if corner >> 2 else one - fz
        weights[n, corner] = wz * wy * wx


@njit(nogil=True, cache=True)
def march_ray(bricks: Bricks, batch: Batch, ray, step, horizon, ids, weights, t, offset, begin, end):
    """Lists the samples of a ray that have support, at offset + begin …; their number, or -1 where `end` is too near.

    Samples lie at start + (phase + k) step. Empty blocks and bricks are jumped over by whole steps; the march ends behind
    `horizon` units of remembered optical depth. t [room] is the chunk's own; ids, weights are the step's.
    """
    ox, oy, oz = batch.origins[ray, 0], batch.origins[ray, 1], batch.origins[ray, 2]
    dx, dy, dz = batch.directions[ray, 0], batch.directions[ray, 1], batch.directions[ray, 2]
    start, stop, phase = batch.start[ray], batch.end[ray], batch.phase[ray]
    half = np.float32(0.5)
    k, deep, count = np.int64(0), np.int64(0), begin
    while True:
        along = start + (phase + np.float32(k)) * step
        if not along < stop:
            break
        gx, gy, gz = ox + along * dx - half, oy + along * dy - half, oz + along * dz - half
        lx, ly, lz = np.floor(gx), np.floor(gy), np.floor(gz)
        x = min(max(np.int64(lx) + 1, 0), np.int64(bricks.dims[0]))
        y = min(max(np.int64(ly) + 1, 0), np.int64(bricks.dims[1]))
        z = min(max(np.int64(lz) + 1, 0), np.int64(bricks.dims[2]))
        bx, by, bz = x >> 2, y >> 2, z >> 2
        slot = bricks.slots[(bz * bricks.shape[1] + by) * bricks.shape[0] + bx]
        if slot < 0 or bricks.supported[slot] == 0:
            shape = bricks.block_shape
            side = np.int64(2)
            if bricks.blocks[((bz >> 2) * shape[1] + (by >> 2)) * shape[0] + (bx >> 2)] == 0:
                side = np.int64(4)
            out = leaving(ox, dx, x, side)
            out = min(out, leaving(oy, dy, y, side))
            out = min(out, leaving(oz, dz, z, side))
            k = max(k + 1, np.int64((out - start) / step - phase - np.float32(CLOSE)) + 1)
            continue
        code = np.int64(bricks.support[slot, ((z & 3) * 4 + (y & 3)) * 4 + (x & 3)])
        k += 1
        if code == 0:
            continue
        if deep >= horizon:
            break
        if count >= end:
            return np.int64(-1)
        gather(bricks, slot, x, y, z, gx - lx, gy - ly, gz - lz, ids, weights, offset + count)
        t[count] = along
        count += 1
        deep += code - 1
    return count - begin


@njit(nogil=True, cache=True, inline="always")
def leaving(origin, direction, cell, side):
    """t where a ray leaves, along one axis, the cube of 2^side cells around `cell`; cell c covers [c - 0.5, c + 0.5)."""
    if direction == 0:
        return np.float32(3e38)
    cube = cell >> side
    wall = ((cube + 1) << side) if direction > 0 else (cube << side)
    return (np.float32(wall) - np.float32(0.5) - origin) / direction


@njit(nogil=True, cache=True, error_model="numpy")
def sigmoid_in_place(values, count):
    """values[i] = sigmoid(values[i]) to float32 rounding: e^x by a polynomial, which loops of vectors can do."""
    one = np.float32(1.0)
    for i in range(count):
        y = min(max(values[i], np.float32(-87.0)), np.float32(87.0)) * np.float32(-1.4426950408889634)
        whole = np.floor(y + np.float32(0.5))
        f = (y - whole) * np.float32(0.6931471805599453)
        p = np.float32(1 / 5040) * f + np.float32(1 / 720)
        p = p * f + np.float32(1 / 120)
        p = p * f + np.float32(1 / 24)
        p = p * f + np.float32(1 / 6)
        p = p * f + np.float32(0.5)
        p = (p * f + one) * f + one
        power = np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32)
        values[i] = one / (one + p * power)


@njit(nogil=True, cache=True)
def render_chunk(chunk, bricks, rows, batch, head, numbers, work, scratch, shading, room):
    """Works out a chunk's samples, their slopes, its share of the view MLP's gradient (in `shading`) and its metrics."""
    low, high = chunk * CHUNK, min((chunk + 1) * CHUNK, batch.start.shape[0])
    offset = chunk * room
    metrics = work.metrics[chunk]
    metrics[:] = 0.0
    work.lost[chunk] = 0
    first = scratch.first
    first[0] = 0
    for ray in range(low, high):
        begin = first[ray - low]
        found = march_ray(
            bricks, batch, ray, numbers.step, numbers.horizon, work.ids, work.weights, scratch.t, offset, begin, room
        )
        if found < 0:
            work.lost[chunk] += 1
            found = 0
        first[ray - low + 1] = begin + found
    count = first[high - low]
    work.counts[chunk] = count
    metrics[SAMPLES] = count

    values = work.slopes[offset : offset + count]  # raw values, then their activations, then their slopes
    for n in range(count):
        blend(rows, work.ids, work.weights, offset + n, work.slopes)
        values[n, 0] += numbers.shift
        scratch.pre[n] = values[n, 0]
    sigmoid_in_place(values.reshape(-1), count * 8)
    for ray in range(low, high):
        composite_ray(ray, ray - low, batch, values, numbers, scratch, shading, metrics)
    shade_chunk(low, high, batch, head, scratch, numbers.shaded_below, shading, metrics, COLOUR, SQUARED, RAYS)
    for ray in range(low, high):
        slope_ray(ray, ray - low, batch, values, numbers, scratch, shading, metrics)


@njit(nogil=True, cache=True)
def composite_ray(ray, r, batch, values, numbers, scratch, shading, metrics):
    """Density, weights and sums of a ray: T before each sample, colours and features accumulated into shading.sums [7, CHUNK]."""
    transmitted, product = np.float32(1.0), 1.0
    sums = shading.sums
    for c in range(7):
        sums[c, r] = 0.0
    thickness = numbers.step * batch.length[ray]
    penalty = 0.0
    for n in range(scratch.first[r], scratch.first[r + 1]):
        x = scratch.pre[n]
        sigma = np.float32((max(x, 0.0) + np.log1p(np.exp(-abs(x)))) / numbers.reference)
        alpha = np.float32(-np.expm1(-sigma * thickness))
        weight = transmitted * alpha
        scratch.sigma[n], scratch.before[n], scratch.weight[n] = sigma, transmitted, weight
        transmitted -= weight
        for c in range(7):
            sums[c, r] += weight * values[n, c + 1]
        product *= 1.0 + np.float64(sigma) * sigma / numbers.sparsity_scale
        if product > LOG_LATER:
            penalty += np.log(product)
            product = 1.0
    scratch.behind[r] = transmitted
    metrics[PENALTY] += penalty + np.log(product)


@njit(nogil=True, cache=True)
def slope_ray(ray, r, batch, values, numbers, scratch, shading, metrics):
    """dL/draw of each sample of a ray, into `values`, where their activations were; and the distortion loss."""
    begin, end = scratch.first[r], scratch.first[r + 1]
    if begin == end:
        return
    thickness = numbers.step * batch.length[ray]
    slopes = shading.slopes  # dL/d sums [7, CHUNK], and of what is behind in row 7
    one, origin = np.float32(1.0), scratch.t[begin]
    ahead, ahead_t = 0.0, 0.0  # weights of samples behind n, and weights times t
    inside, inside_t = 0.0, 0.0  # of all samples up to n
    if numbers.scatter > 0:
        for n in range(begin, end):
            inside += scratch.weight[n]
            inside_t += scratch.weight[n] * (scratch.t[n] - origin)
    behind = scratch.behind[r] * slopes[7, r]
    scattered = 0.0
    for n in range(end - 1, begin - 1, -1):
        weight, sigma = scratch.weight[n], scratch.sigma[n]
        g = np.float32(0.0)
        for c in range(7):
            g += slopes[c, r] * values[n, c + 1]
        if numbers.scatter > 0:
            t = scratch.t[n] - origin
            inside -= weight
            inside_t -= weight * t
            before = t * inside - inside_t
            scattered += 2.0 * weight * before + weight * weight / 3.0
            g += np.float32(numbers.scatter * (2.0 * (before + ahead_t - t * ahead) + 2.0 * weight / 3.0))
            ahead += weight
            ahead_t += weight * t
        tau_slope = (scratch.before[n] - weight) * g - behind
        behind += weight * g
        sigma_slope = tau_slope * thickness
        sigma_slope += numbers.sparsity * np.float32(2.0) * sigma / (numbers.sparsity_scale + sigma * sigma)
        values[n, 0] = sigma_slope * values[n, 0] / numbers.reference
        for c in range(7):
            s = values[n, c + 1]
            values[n, c + 1] = weight * slopes[c, r] * s * (one - s)
    metrics[SCATTER] += scattered
