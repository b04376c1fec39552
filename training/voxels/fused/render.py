"""Forward and backward through a chunk of rays: march, fetch, activate, composite, shade, and the slopes of all losses.

Notation, per sample n of a chunk: x raw values (8), s = sigmoid(x), tau optical depth, T transmittance before it, w = T alpha;
per ray: A = sum w s over colours and features, G = dL/dA, B = T behind everything. Losses are sums over rays, in units of one
ray: the caller divides by the number of rays that count, which is known only at the end.

    dL/dtau_n = T_n (1 - alpha_n) g_n - sum over m > n of w_m g_m - B dL/dB,    g_n = G · s_n + distortion's share
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from training.voxels.fused.bricks import Bricks, row_in, row_of
from training.voxels.fused.head import METRICS, PARAMETERS, PENALTY, SAMPLES, SCATTER, shade_chunk
from training.multires.fused.rays import Batch
from training.voxels.fused.vectors import blend

CHUNK = 64  # rays that are worked on together; results depend on it in the last bits, never on threads
CLOSE = 1e-3  # steps: what is left to rounding when a ray jumps over empty space
LOG_LATER = 1e280  # a running product that is turned into a logarithm before it overflows


class Numbers(NamedTuple):
    """Constants of a step, float32 but for last_depth: see training.voxels.settings.Settings.

    scatter: distortion's weight over its spread, in voxels; sparsity: its weight times the spacing's share.
    """

    step: np.float32
    shift: np.float32
    reference: np.float32
    last_depth: np.int64
    sparsity: np.float32
    sparsity_scale: np.float32
    scatter: np.float32
    shaded_below: np.float32


class Work(NamedTuple):
    """What the chunks of a step leave for the rows. Chunk c has samples c * room … c * room + counts[c] - 1.

    ids int32, weights, slopes float32 [C * room, 8]; counts int64 [C]; metrics
    float64 [C, METRICS]; head [C, PARAMETERS]: slopes of the view MLP.
    """

    ids: np.ndarray
    weights: np.ndarray
    slopes: np.ndarray
    counts: np.ndarray
    metrics: np.ndarray
    head: np.ndarray


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
        np.zeros(chunks, np.int64), np.zeros((chunks, METRICS)), np.zeros((chunks, PARAMETERS), np.float32),
    )  # fmt: skip


def make_scratch(room: int) -> Scratch:
    """Memory for one worker."""
    numbers = [np.empty(room, np.float32) for _ in range(5)]
    return Scratch._make([*numbers, np.zeros(CHUNK + 1, np.int64), np.ones(CHUNK, np.float32)])


@njit(nogil=True, cache=True)
def march_chunk(chunk, bricks: Bricks, batch: Batch, numbers, work, scratch):
    """Lists the samples of a chunk's rays that have support, and how many there are.

    Samples lie at start + (phase + k) step. Empty blocks and bricks are jumped over by whole steps; a ray ends behind
    `last_depth` units of remembered optical depth. Tables are taken out of their tuples once: passing these on costs more
    than the march.
    """
    low, high, room = chunk * CHUNK, min((chunk + 1) * CHUNK, batch.start.shape[0]), scratch.t.shape[0]
    offset, step, last_depth = chunk * room, numbers.step, numbers.last_depth
    ids, weights, t, first = work.ids, work.weights, scratch.t, scratch.first
    slots, blocks, base, bits = bricks.slots, bricks.blocks, bricks.base, bricks.bits
    support, supported = bricks.support, bricks.supported
    most_x, most_y, most_z = np.int64(bricks.dims[0]), np.int64(bricks.dims[1]), np.int64(bricks.dims[2])
    width, height = np.int64(bricks.shape[0]), np.int64(bricks.shape[1])
    blocks_wide, blocks_high = np.int64(bricks.block_shape[0]), np.int64(bricks.block_shape[1])
    one, half = np.float32(1.0), np.float32(0.5)
    count = 0
    first[0] = 0
    for ray in range(low, high):
        ox, oy, oz = batch.origins[ray, 0], batch.origins[ray, 1], batch.origins[ray, 2]
        dx, dy, dz = batch.directions[ray, 0], batch.directions[ray, 1], batch.directions[ray, 2]
        start, stop, phase = batch.start[ray], batch.end[ray], batch.phase[ray]
        k, deep = np.int64(0), np.int64(0)
        along = start + phase * step
        while along < stop:
            gx, gy, gz = ox + along * dx - half, oy + along * dy - half, oz + along * dz - half
            lx, ly, lz = np.floor(gx), np.floor(gy), np.floor(gz)
            x = min(max(np.int64(lx) + 1, 0), most_x)
            y = min(max(np.int64(ly) + 1, 0), most_y)
            z = min(max(np.int64(lz) + 1, 0), most_z)
            slot = slots[((z >> 2) * height + (y >> 2)) * width + (x >> 2)]
            if slot < 0 or supported[slot] == 0:
                empty_block = blocks[((z >> 4) * blocks_high + (y >> 4)) * blocks_wide + (x >> 4)] == 0
                side = 4 if empty_block else 2
                out = min(leaving(ox, dx, x, side), leaving(oy, dy, y, side), leaving(oz, dz, z, side))
                k = max(k + 1, np.int64((out - start) / step - phase - np.float32(CLOSE)) + 1)
                along = start + (phase + np.float32(k)) * step
                continue
            code = np.int64(support[slot, ((z & 3) * 4 + (y & 3)) * 4 + (x & 3)])
            k += 1
            along_now, along = along, start + (phase + np.float32(k)) * step
            if code == 0:
                continue
            if deep >= last_depth:
                break
            if count >= room:  # the caller sees that the chunk is full
                break
            n = offset + count
            if (x & 3) < 3 and (y & 3) < 3 and (z & 3) < 3:
                here, local, lowest = bits[slot], ((z & 3) * 4 + (y & 3)) * 4 + (x & 3), base[slot]
                for corner in range(8):
                    shift = (corner >> 2) * 16 + (corner >> 1 & 1) * 4 + (corner & 1)
                    ids[n, corner] = row_in(here, lowest, local + shift)
            else:
                for corner in range(8):
                    ids[n, corner] = row_of(slots, bits, base, width, height, x + (corner & 1),
                                            y + (corner >> 1 & 1), z + (corner >> 2))  # fmt: skip
            fx, fy, fz = gx - lx, gy - ly, gz - lz
            ex, ey, ez = one - fx, one - fy, one - fz
            weights[n, 0], weights[n, 1] = ez * ey * ex, ez * ey * fx
            weights[n, 2], weights[n, 3] = ez * fy * ex, ez * fy * fx
            weights[n, 4], weights[n, 5] = fz * ey * ex, fz * ey * fx
            weights[n, 6], weights[n, 7] = fz * fy * ex, fz * fy * fx
            t[count] = along_now
            count += 1
            deep += code - 1
        first[ray - low + 1] = count
    work.counts[chunk] = count


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
def render_chunk(chunk, bricks, rows, batch, head, numbers, work, scratch, shading):
    """Works out a chunk's samples, their slopes, its share of the view MLP's gradient, and its metrics."""
    low, high = chunk * CHUNK, min((chunk + 1) * CHUNK, batch.start.shape[0])
    offset, metrics = chunk * scratch.t.shape[0], work.metrics[chunk]
    metrics[:] = 0.0
    march_chunk(chunk, bricks, batch, numbers, work, scratch)
    count = work.counts[chunk]
    metrics[SAMPLES] = count

    fetch_chunk(offset, count, rows, work.ids, work.weights, work.slopes, numbers.shift, scratch.pre)
    composite_chunk(low, high, offset, batch.length, work.slopes, numbers, scratch, shading.sums, metrics)
    shade_chunk(low, high, batch, head, scratch, numbers.shaded_below, shading, metrics)
    slope_chunk(low, high, offset, batch.length, work.slopes, numbers, scratch, shading.slopes, metrics)
    work.head[chunk, :] = shading.gradient


@njit(nogil=True, cache=True)
def fetch_chunk(offset, count, rows, ids, weights, values, shift, pre):
    """values [., 8]: sigmoids of the raw values at a chunk's samples; pre [.]: their raw density, before its activation."""
    for n in range(count):
        blend(rows, ids, weights, offset + n, values)
        values[offset + n, 0] += shift
        pre[n] = values[offset + n, 0]
    sigmoid_in_place(values[offset : offset + count].reshape(-1), count * 8)


@njit(nogil=True, cache=True)
def composite_chunk(low, high, offset, length, values, numbers, scratch, sums, metrics):
    """Density, weights and T of each sample; colours and features of each ray, accumulated into sums [7, CHUNK]."""
    pre, sigmas, befores, weights, first = scratch.pre, scratch.sigma, scratch.before, scratch.weight, scratch.first
    reference, scale = numbers.reference, np.float64(numbers.sparsity_scale)
    total = np.empty(7, np.float32)
    penalty = 0.0
    for r in range(high - low):
        transmitted, product = np.float32(1.0), 1.0
        thickness = numbers.step * length[low + r]
        total[:] = np.float32(0.0)
        for n in range(first[r], first[r + 1]):
            x = np.float64(pre[n])
            sigma = np.float32((max(x, 0.0) + np.log1p(np.exp(-abs(x)))) / reference)
            weight = transmitted * np.float32(-np.expm1(-np.float64(sigma * thickness)))
            sigmas[n], befores[n], weights[n] = sigma, transmitted, weight
            transmitted -= weight
            for c in range(7):
                total[c] += weight * values[offset + n, c + 1]
            product *= 1.0 + np.float64(sigma) * sigma / scale
            if product > LOG_LATER:
                penalty += np.log(product)
                product = 1.0
        scratch.behind[r] = transmitted
        penalty += np.log(product)
        for c in range(7):
            sums[c, r] = total[c]
    metrics[PENALTY] = penalty


@njit(nogil=True, cache=True)
def slope_chunk(low, high, offset, length, values, numbers, scratch, slopes, metrics):
    """dL/draw of each sample into `values`, where their activations were, from dL/d sums and dL/d behind [8, CHUNK]."""
    ts, sigmas, befores, weights, first = scratch.t, scratch.sigma, scratch.before, scratch.weight, scratch.first
    reference, step, scatter = numbers.reference, numbers.step, np.float64(numbers.scatter)
    sparsity, scale = np.float32(2.0) * numbers.sparsity, numbers.sparsity_scale
    one, own = np.float32(1.0), np.float64(step) / 3.0  # own: of distortion, of a sample with itself
    slope = np.empty(8, np.float32)
    scattered = 0.0
    for r in range(high - low):
        begin, end = first[r], first[r + 1]
        if begin == end:
            continue
        thickness = step * length[low + r]
        for c in range(8):
            slope[c] = slopes[c, r]
        origin = ts[begin]
        inside, inside_t = 0.0, 0.0  # weights of the samples up to n, and weights times t
        for n in range(begin, end):
            inside += weights[n]
            inside_t += weights[n] * (ts[n] - origin)
        ahead, ahead_t = 0.0, 0.0  # of those behind n
        behind = scratch.behind[r] * slope[7]
        for n in range(end - 1, begin - 1, -1):
            weight, sigma, m = weights[n], sigmas[n], offset + n
            g = np.float32(0.0)
            for c in range(7):
                g += slope[c] * values[m, c + 1]
            if scatter > 0:
                t = np.float64(ts[n] - origin)
                inside -= weight
                inside_t -= weight * t
                before = t * inside - inside_t
                scattered += 2.0 * weight * before + own * weight * weight
                g += np.float32(scatter * (2.0 * (before + ahead_t - t * ahead) + 2.0 * own * weight))
                ahead += weight
                ahead_t += weight * t
            tau_slope = (befores[n] - weight) * g - behind
            behind += weight * g
            sigma_slope = tau_slope * thickness + sparsity * sigma / (scale + sigma * sigma)
            values[m, 0] = sigma_slope * values[m, 0] / reference
            for c in range(7):
                s = values[m, c + 1]
                values[m, c + 1] = weight * slope[c] * s * (one - s)
    metrics[SCATTER] = scattered
