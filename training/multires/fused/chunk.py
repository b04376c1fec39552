"""A chunk of rays through the field, forward and backward, by one worker; its samples stay in the cache meanwhile.

Samples come wave by wave: a few of each ray that still has light, so that a ray ends exactly where its light does and blocks of
samples are full. Within a ray they are in order. What training.multires.field defines, computed in float32. The gradient is that
of some of the samples, and exact on average (_sample_slopes).

Notation: n samples of a chunk, in blocks; I inputs of the decoder; CHUNK rays. Arrays of samples are flat.
"""

# pyright: reportCallIssue=false

from typing import NamedTuple

import numpy as np

from training.multires.field import HIDDEN, OUTPUTS
from training.multires.fused.compiled import kernel
from training.multires.fused.corners import BLOCK, CORNERS, encode
from training.multires.fused.march import march_ray
from training.multires.fused.network import SAMPLES as TOGETHER
from training.multires.fused.network import activate, add_gradient, decode, opacity_in_place
from training.multires.fused.vectors import FEATURES, add_to_row, colour_slopes
from training.multires.fused.view_mlp import DISTORTION, SAMPLES, SMOOTHNESS, SPARSITY, shade_chunk
from training.multires.levels import Levels

CHUNK = 128  # rays
FIRST_WAVE, LATER_WAVES, LONGEST_WAVE = 4, 3, 8  # samples of each ray: more where few rays are left, to fill blocks
LARGEST_PRODUCT = 1e250  # times one more factor, it is finite
SAMPLED_BELOW = 2.0  # times the mean of slopes; see _sample_slopes


class Field(NamedTuple):
    levels: Levels
    table: np.ndarray  # of features
    parameters: np.ndarray  # of decoder and view MLP, as the loops have them
    turned: np.ndarray  # what their gradients' products read
    inputs: int  # I


class Numbers(NamedTuple):
    """What a step treats as constants."""

    step: float  # distance between samples, in cells
    reference: float  # world units of a side of the cube
    distortion: float  # weight by distances in cells
    sparsity: float  # weight by lengths in world units
    sparsity_scale: float
    largest_raw: float
    least_light: float
    shaded_below: float  # T at which the view MLP, if has_view_mlp, counts
    octaves: int  # of the direction that it sees
    has_view_mlp: bool
    first_view: int  # where its parameters begin
    first_turned: int  # the same in Field.turned
    smoothness: tuple[float, float]  # weights of density, and of colours and features
    cell: float  # side of the finest level's, of the cube
    sampled_below: float  # times the mean of slopes: samples below are taken at random for the gradient; 0: all are
    near: float  # this and the next: see Settings
    whole_from: float


class Scratch(NamedTuple):
    """Memory of one worker for `capacity` samples."""

    ray: np.ndarray  # of each sample: its ray, int32 (-1: padding)
    xs: np.ndarray  # place in the unit cube
    ys: np.ndarray
    zs: np.ndarray
    t: np.ndarray
    density: np.ndarray
    weight: np.ndarray
    light: np.ndarray  # T behind it (0: it does not count)
    pull: np.ndarray  # dL/dweight of the distortion loss
    x: np.ndarray  # [., I]
    hidden: np.ndarray  # [., 64]
    raw: np.ndarray  # [., 8]
    slopes: np.ndarray  # [., 8]
    ids: np.ndarray  # what encoding and decoding need
    corner_weights: np.ndarray
    cells: np.ndarray
    hidden_slopes: np.ndarray
    x_slopes: np.ndarray
    behind: np.ndarray  # of each ray
    next_k: np.ndarray  # k of its next sample
    alive: np.ndarray
    of_behind: np.ndarray  # what lies behind a sample, times its slopes
    sums: np.ndarray  # [., 8]: unused, colours, features
    ray_slopes: np.ndarray  # of these
    ray_sums: np.ndarray  # float64 [4, .]


def make_scratch(capacity: int, levels: int, inputs: int) -> Scratch:
    """Memory for chunks of so many samples, a multiple of BLOCK."""

    def floats(*shape: int) -> np.ndarray:
        return np.zeros(int(np.prod(shape)), np.float32)

    corner = 2 * levels * CORNERS
    return Scratch(
        np.zeros(capacity, np.int32), *(floats(capacity) for _ in range(8)), floats(capacity, inputs), floats(capacity, HIDDEN),
        floats(capacity, OUTPUTS), floats(capacity, OUTPUTS), np.zeros(corner, np.int32), floats(corner),
        np.zeros(3 * BLOCK, np.int32), floats(TOGETHER, HIDDEN), floats(TOGETHER, inputs), floats(CHUNK),
        np.zeros(CHUNK, np.int64), np.zeros(CHUNK, np.bool_), floats(CHUNK), floats(CHUNK, 8), floats(CHUNK, 8),
        np.zeros((4, CHUNK)),
    )  # fmt: skip


@kernel
def _pad(scratch, count):
    """Fills up the last block of samples; their number then."""
    end = (count + BLOCK - 1) // BLOCK * BLOCK
    for n in range(count, end):
        scratch.ray[n] = -1
        scratch.xs[n] = scratch.ys[n] = scratch.zs[n] = np.float32(0.5)
        scratch.weight[n] = scratch.light[n] = scratch.t[n] = np.float32(0.0)
    return end


@kernel
def evaluate(field, largest_raw, scratch, begin, end):
    """Features, raw values and activations of samples begin … end - 1, whole blocks."""
    for first in range(begin, end, TOGETHER):
        some = min(TOGETHER, end - first)
        encode(field, scratch, first, some)
        decode(field, scratch, first, some)
        activate(scratch.raw, scratch.density, first, some, largest_raw)


@kernel
def forward(low, high, grid, field, batch, numbers, scratch):
    """Samples of rays low … high - 1 and what the rays gather: sums, behind. The number of samples, with
    padding; -1 where the capacity does not suffice."""
    for r in range(high - low):
        scratch.behind[r], scratch.next_k[r] = np.float32(1.0), 0
        scratch.alive[r] = batch.start[low + r] < batch.end[low + r]
    sums = scratch.sums
    sums[:] = np.float32(0.0)
    begin, wave, per_length = 0, FIRST_WAVE, numbers.step / numbers.reference
    while True:
        count = begin
        for r in range(high - low):
            if scratch.alive[r]:
                count = march_ray(grid, batch, low + r, r, numbers.step, wave, scratch, count, scratch.ray.size - BLOCK)
                if count < 0:
                    return -1
        if count == begin:
            return count
        end = _pad(scratch, count)
        evaluate(field, numbers.largest_raw, scratch, begin, end)
        for n in range(begin, count):
            scratch.weight[n] = scratch.density[n] * (batch.length[low + scratch.ray[n]] * per_length)
        opacity_in_place(scratch.weight[begin:count])
        for n in range(begin, count):
            r = scratch.ray[n]
            before = scratch.behind[r]
            if before < numbers.least_light:
                scratch.weight[n] = scratch.light[n] = np.float32(0.0)
                continue
            weight = before * scratch.weight[n]
            after = before - weight
            scratch.weight[n], scratch.light[n], scratch.behind[r] = weight, max(after, np.float32(1e-30)), after
            scratch.alive[r] = scratch.alive[r] and after >= numbers.least_light
            add_to_row(sums, 2 * r, weight, scratch.raw, n * OUTPUTS)
            add_to_row(sums, 2 * r + 1, weight, scratch.raw, n * OUTPUTS + FEATURES)
        begin, wave = end, LATER_WAVES
        alive = 0
        for r in range(high - low):
            alive += scratch.alive[r]
        if alive > 0:
            wave = min(max(LATER_WAVES, BLOCK // alive), LONGEST_WAVE)


@kernel
def _pull_together(low, count, batch, numbers, scratch, metrics):
    """The distortion loss of a chunk's rays: scratch.pull, dL/dweight of each sample."""
    # weights of the samples before, weights times t, and the same of all
    sums = scratch.ray_sums
    inside, inside_t, whole, whole_t = sums[0], sums[1], sums[2], sums[3]
    sums[:] = 0.0
    for n in range(count):
        r = scratch.ray[n]
        if r >= 0:
            whole[r] += scratch.weight[n]
            whole_t[r] += scratch.weight[n] * np.float64(scratch.t[n] - batch.start[low + r])
    own = np.float64(numbers.step) / 3.0
    for n in range(count):
        r = scratch.ray[n]
        if r < 0 or scratch.light[n] == 0:
            scratch.pull[n] = np.float32(0.0)
            continue
        weight, t = np.float64(scratch.weight[n]), np.float64(scratch.t[n] - batch.start[low + r])
        before = t * inside[r] - inside_t[r]
        inside[r] += weight
        inside_t[r] += weight * t
        behind = (whole_t[r] - inside_t[r]) - t * (whole[r] - inside[r])
        metrics[DISTORTION] += 2.0 * weight * before + own * weight * weight
        scratch.pull[n] = np.float32(numbers.distortion * (2.0 * (before + behind) + 2.0 * own * weight))


@kernel
def _slopes_of_raw(low, high, count, batch, numbers, scratch, metrics):
    """scratch.slopes [., 8] = dL/draw from dL/d what each ray gathered, ray_slopes [CHUNK, 8]: T behind it, then 7 sums."""
    behind, ray_slopes = scratch.of_behind, scratch.ray_slopes
    product, logs = scratch.ray_sums[0], scratch.ray_sums[1]  # of each ray's 1 + (density² / scale)
    zero, one, two = np.float32(0.0), np.float32(1.0), np.float32(2.0)
    largest = np.exp(numbers.largest_raw) * np.float32(0.9999)
    per_world, per_scale = one / numbers.reference, one / numbers.sparsity_scale
    per_length = numbers.step / numbers.reference
    for r in range(high - low):
        behind[r], product[r], logs[r] = scratch.behind[r] * ray_slopes[r * OUTPUTS], 1.0, 0.0
    for n in range(count - 1, -1, -1):
        r, at = scratch.ray[n], n * OUTPUTS
        if r < 0 or scratch.light[n] == 0:
            for c in range(OUTPUTS):
                scratch.slopes[at + c] = zero
            continue
        weight = scratch.weight[n]
        of_weight = scratch.pull[n] + colour_slopes(ray_slopes, r * OUTPUTS, scratch.raw, at, weight, scratch.slopes)
        sigma = scratch.density[n] * per_world
        scaled = one + sigma * sigma * per_scale
        of_sparsity = two * numbers.sparsity * sigma * per_scale / scaled
        product[r] *= np.float64(scaled)
        if product[r] > LARGEST_PRODUCT:
            logs[r], product[r] = logs[r] + np.log(product[r]), 1.0
        slope = (scratch.light[n] * of_weight - behind[r] + of_sparsity) * (batch.length[low + r] * per_length)
        behind[r] += weight * of_weight
        slope *= scratch.density[n]
        if scratch.density[n] >= largest:  # beyond the largest density only what leads back counts
            slope = max(slope, zero)
        scratch.slopes[at] = slope
        away = numbers.near + scratch.t[n] * batch.length[low + r]
        if away < numbers.whole_from:
            share = (away / numbers.whole_from) ** 2
            for c in range(OUTPUTS):
                scratch.slopes[at + c] *= share
    for r in range(high - low):
        metrics[SPARSITY] += (logs[r] + np.log(product[r])) * np.float64(batch.length[low + r] * per_length)


class Output(NamedTuple):
    """What chunks leave for the scatter."""

    counts: np.ndarray  # chunk c has counts[c] samples (-1: its capacity did not suffice) from c * capacity on
    xs: np.ndarray
    ys: np.ndarray
    zs: np.ndarray
    slopes: np.ndarray  # [L, chunks * capacity, 4]: of their features
    metrics: np.ndarray  # float64 [chunks, METRICS]
    gradient: np.ndarray  # float32 [parts, P]: of the parameters, by groups of chunks


@kernel
def _list_rays(count, scratch, shading):
    """Sets shading.ray to the rays that have samples; how many these are."""
    seen, listed = scratch.alive, 0  # no ray is alive any more
    seen[:] = False
    for n in range(count):
        r = scratch.ray[n]
        if r >= 0 and not seen[r]:
            seen[r], shading.ray[listed] = True, r
            listed += 1
    return listed


@kernel
def train_chunks(first, last, part, grid, field, batch, numbers, scratch, shading, output):
    """Samples, loss and gradients of chunks first … last - 1, one part, into `output`."""
    for chunk in range(first, last):  # here, because a call from Python takes as long as a tenth of a chunk
        low, high = chunk * CHUNK, min((chunk + 1) * CHUNK, batch.start.shape[0])
        metrics, gradient = output.metrics[chunk], output.gradient[part]
        metrics[:] = 0.0
        count = forward(low, high, grid, field, batch, numbers, scratch)
        output.counts[chunk] = count
        if count <= 0:
            continue
        listed = _list_rays(count, scratch, shading)
        shade_chunk(low, listed, batch, field, numbers, scratch, shading, metrics, gradient)
        _pull_together(low, count, batch, numbers, scratch, metrics)
        _slopes_of_raw(low, high, count, batch, numbers, scratch, metrics)
        kept = _sample_slopes(count, batch.phase[low], numbers.sampled_below, field.inputs, scratch, metrics)
        _leave_slopes(chunk, kept, field, scratch, output, gradient)


@kernel
def _sample_slopes(count, phase, sampled_below, inputs, scratch, metrics):
    """Moves the samples that matter to the gradient to the front of scratch; how many there are, with padding.

    Where a sample's slopes, summed without signs, are below sampled_below times their mean, it is taken with a probability in
    proportion to that sum, and its slopes are divided by the probability: the expected gradient is the exact one.
    """
    sums, total, counted = scratch.pull, np.float64(0.0), 0  # the distortion loss is in the slopes already
    for n in range(count):
        sums[n] = np.float32(0.0)
        if scratch.light[n] != 0:
            for c in range(OUTPUTS):
                sums[n] += abs(scratch.slopes[n * OUTPUTS + c])
            total, counted = total + sums[n], counted + 1
    metrics[SAMPLES] = counted
    least, kept = np.float32(sampled_below * total / max(counted, 1)), 0
    # low bits of a random number whose high bits placed the samples
    due = (phase * np.float32(4096.0)) % np.float32(1.0)
    for n in range(count):
        if scratch.light[n] == 0:
            continue
        scale = np.float32(1.0)
        if sums[n] < least:
            due += sums[n] / least
            if due < np.float32(1.0):
                continue
            due -= np.float32(1.0)
            scale = least / sums[n]
        _move_row(scratch.slopes, OUTPUTS, n, kept, scale)
        _move_row(scratch.x, inputs, n, kept, np.float32(1.0))
        _move_row(scratch.hidden, HIDDEN, n, kept, np.float32(1.0))
        scratch.xs[kept], scratch.ys[kept], scratch.zs[kept] = scratch.xs[n], scratch.ys[n], scratch.zs[n]
        scratch.light[kept] = scratch.light[n]
        kept += 1
    end = min((kept + BLOCK - 1) // BLOCK * BLOCK, count)
    for n in range(kept, end):
        scratch.light[n] = np.float32(0.0)
        _move_row(scratch.slopes, OUTPUTS, n, n, np.float32(0.0))
    return end


@kernel
def _move_row(rows, width, source, target, scale):
    """rows[target] = scale rows[source], of a flat array."""
    old, new = rows[source * width : (source + 1) * width], rows[target * width : (target + 1) * width]
    for i in range(width):
        new[i] = scale * old[i]


@kernel
def _leave_slopes(chunk, count, field, scratch, output, gradient):
    """From scratch.slopes of `count` samples to gradients of the parameters and to slopes of features in `output`."""
    base, place, table_capacity = chunk * (scratch.ray.size - BLOCK), 0, output.xs.size
    for first in range(0, count, TOGETHER):
        some = min(TOGETHER, count - first)
        add_gradient(field, scratch, first, some, gradient)
        for n in range(first, first + some):
            if scratch.light[n] == 0:
                continue
            to = base + place
            output.xs[to], output.ys[to], output.zs[to] = scratch.xs[n], scratch.ys[n], scratch.zs[n]
            for level in range(field.levels.resolution.size):
                at, source = (level * table_capacity + to) * FEATURES, (n - first) * field.inputs + level * FEATURES
                for f in range(FEATURES):
                    output.slopes[at + f] = scratch.x_slopes[source + f]
            place += 1
    output.counts[chunk] = place


@kernel
def smooth_chunk(chunk, part, pairs, low, high, scale, field, numbers, scratch, output):
    """The smoothness loss of pairs low … high - 1 of points [M, 2, 3], times scale: gradients into `output`."""
    one, two, count = np.float32(1.0), np.float32(2.0), 2 * (high - low)
    for n in range(count):
        point = pairs[low + n // 2, n % 2]
        scratch.ray[n], scratch.light[n] = 0, one
        scratch.xs[n], scratch.ys[n], scratch.zs[n] = point[0], point[1], point[2]
    end = _pad(scratch, count)
    evaluate(field, numbers.largest_raw, scratch, 0, end)
    scratch.slopes[: end * OUTPUTS] = np.float32(0.0)
    of_density, of_colour = numbers.smoothness
    total = 0.0
    for n in range(0, count, 2):
        a, b = scratch.density[n] * numbers.cell, scratch.density[n + 1] * numbers.cell
        apart = np.log1p(a) - np.log1p(b)
        total += np.float64(of_density) * apart * apart
        slope = two * of_density * scale * apart
        scratch.slopes[n * OUTPUTS] = slope * a / (one + a)
        scratch.slopes[(n + 1) * OUTPUTS] = -slope * b / (one + b)
        for c in range(1, OUTPUTS):
            u, v = scratch.raw[n * OUTPUTS + c], scratch.raw[(n + 1) * OUTPUTS + c]
            total += np.float64(of_colour) * (u - v) * (u - v)
            slope = two * of_colour * scale * (u - v)
            scratch.slopes[n * OUTPUTS + c] = slope * u * (one - u)
            scratch.slopes[(n + 1) * OUTPUTS + c] = -slope * v * (one - v)
    output.metrics[chunk, :] = 0.0
    output.metrics[chunk, SMOOTHNESS] = total * scale
    _leave_slopes(chunk, end, field, scratch, output, output.gradient[part])


@kernel
def gather_chunk(chunk, grid, field, batch, numbers, scratch, gathered):
    """gathered [N, 8] of a chunk's rays: see training.multires.field.composite. Whether the capacity sufficed."""
    low, high = chunk * CHUNK, min((chunk + 1) * CHUNK, batch.start.shape[0])
    if forward(low, high, grid, field, batch, numbers, scratch) < 0:
        return False
    for r in range(high - low):
        for c in range(7):
            gathered[low + r, c] = scratch.sums[r * OUTPUTS + c + 1]
        gathered[low + r, 7] = scratch.behind[r]
    return True


@kernel
def query_points(field, largest_raw, points, values, low, high, scratch):
    """values [N, 8] of points low … high - 1 [N, 3] of the unit cube: density per side of it, colours and features."""
    step = scratch.ray.size // TOGETHER * TOGETHER
    for first in range(low, high, step):
        count = min(step, high - first)
        for n in range(count):
            point = points[first + n]
            scratch.xs[n], scratch.ys[n], scratch.zs[n] = point[0], point[1], point[2]
        end = _pad(scratch, count)
        evaluate(field, largest_raw, scratch, 0, end)
        for n in range(count):
            values[first + n, 0] = scratch.density[n]
            for c in range(1, OUTPUTS):
                values[first + n, c] = scratch.raw[n * OUTPUTS + c]
