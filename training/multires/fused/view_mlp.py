"""The view MLP over a chunk of rays, forward and backward, rays innermost so that loops become vectors.

Notation: R rays; activations are [channels, R], weights input-major [in, out] as everywhere. Sums over rays run in a fixed
order, so a gradient does not depend on threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

INPUTS, HIDDEN, OUTPUTS = 34, 16, 3
ENCODED = 27
METRICS = 5  # sums over rays: squared error, the same of clipped colours, distortion, counts of rays and samples
COLOUR, SQUARED, DISTORTION, RAYS, SAMPLES = range(METRICS)
PARAMETERS = INPUTS * HIDDEN + HIDDEN + HIDDEN * HIDDEN + HIDDEN + HIDDEN * OUTPUTS + OUTPUTS


class Head(NamedTuple):
    """Weights [34, 16], [16, 16], [16, 3] and biases of the view MLP; `used` is False for a diffuse model."""

    used: bool
    w0: np.ndarray
    b0: np.ndarray
    w1: np.ndarray
    b1: np.ndarray
    w2: np.ndarray
    b2: np.ndarray


class HeadWork(NamedTuple):
    """Room of one worker for R rays: sums [7, R] accumulated colours and features, slopes [8, R] of the loss with respect
    to these and to T behind the ray, inputs [34, R], hidden layers and their slopes [16, R], outputs [3, R]."""

    sums: np.ndarray
    slopes: np.ndarray
    inputs: np.ndarray
    hidden0: np.ndarray
    hidden1: np.ndarray
    output: np.ndarray
    slope0: np.ndarray
    slope1: np.ndarray
    slope2: np.ndarray
    input_slopes: np.ndarray
    gradient: np.ndarray


def make_head_work(rays: int) -> HeadWork:
    """Memory for one worker; `gradient` [PARAMETERS] is set by it for each chunk."""
    shapes = (7, 8, INPUTS, HIDDEN, HIDDEN, OUTPUTS, HIDDEN, HIDDEN, OUTPUTS, INPUTS)
    arrays = [np.zeros((n, rays), np.float32) for n in shapes]
    return HeadWork._make([*arrays, np.zeros(PARAMETERS, np.float32)])


@njit(nogil=True, cache=True)
def _layer(inputs, weights, biases, outputs, rays, rectified):
    for j in range(weights.shape[1]):
        for r in range(rays):
            outputs[j, r] = biases[j]
        for i in range(weights.shape[0]):
            weight = weights[i, j]
            for r in range(rays):
                outputs[j, r] += weight * inputs[i, r]
        if rectified:
            for r in range(rays):
                outputs[j, r] = max(outputs[j, r], np.float32(0.0))


@njit(nogil=True, cache=True, fastmath={"reassoc", "contract", "nsz"})
def _weight_slopes(inputs, slopes, rays, gradient, start):
    """Adds dL/dW [in, out] and dL/db [out] to the flat gradient from `start`; where the next layer's begin."""
    outputs = slopes.shape[0]
    for i in range(inputs.shape[0]):
        for j in range(outputs):
            total = np.float32(0.0)
            for r in range(rays):
                total += inputs[i, r] * slopes[j, r]
            gradient[start + i * outputs + j] = total
    start += inputs.shape[0] * outputs
    for j in range(outputs):
        total = np.float32(0.0)
        for r in range(rays):
            total += slopes[j, r]
        gradient[start + j] = total
    return start + outputs


@njit(nogil=True, cache=True)
def _input_slopes(slopes, weights, out, rays):
    """dL/d inputs [in, R] from dL/d outputs [out, R]."""
    for i in range(weights.shape[0]):
        for r in range(rays):
            out[i, r] = 0.0
        for j in range(weights.shape[1]):
            weight = weights[i, j]
            for r in range(rays):
                out[i, r] += weight * slopes[j, r]


@njit(nogil=True, cache=True)
def _encode(viewdirs, low, rays, octaves, inputs):
    """Channels 0 … 26: v, sin(2^k v), sin(2^k v + pi/2), frequency-major, by doubling the angle; zero from octave k = octaves on."""
    two = np.float32(2.0)
    for r in range(rays):
        for axis in range(3):
            v = viewdirs[low + r, axis]
            inputs[axis, r] = v
            sine, cosine = np.sin(v), np.cos(v)
            for k in range(octaves):
                inputs[3 + 3 * k + axis, r] = sine
                inputs[15 + 3 * k + axis, r] = cosine
                sine, cosine = two * sine * cosine, np.float32(1.0) - two * sine * sine


@njit(nogil=True, cache=True)
def shade_chunk(low, high, batch, head, has_samples, behind, octaves, shaded_below, work, metrics):
    """Adds colours of rays low … high - 1 against their targets to metrics; sets dL/d sums and the view MLP's gradient.

    A ray without samples counts for nothing. behind [R]: T behind each ray.
    """
    rays = high - low
    inputs = work.inputs
    for r in range(rays):
        for c in range(3):
            inputs[ENCODED + c, r] = work.sums[c, r] + behind[r] * batch.background[low + r, c]
        for c in range(4):
            inputs[ENCODED + 3 + c, r] = work.sums[3 + c, r]
    if head.used:
        _encode(batch.viewdirs, low, rays, octaves, inputs)
        _layer(inputs, head.w0, head.b0, work.hidden0, rays, True)
        _layer(work.hidden0, head.w1, head.b1, work.hidden1, rays, True)
        _layer(work.hidden1, head.w2, head.b2, work.output, rays, False)
    for r in range(rays):
        counts = has_samples[r]
        shaded = head.used and behind[r] <= shaded_below
        if counts:
            metrics[RAYS] += 1.0
        for c in range(3):
            colour = inputs[ENCODED + c, r]
            residual = np.float32(0.0)
            if shaded:
                residual = np.float32(1.0 / (1.0 + np.exp(-work.output[c, r])))
                colour += residual
            error = colour - batch.target[low + r, c] if counts else np.float32(0.0)
            clipped = min(max(colour, np.float32(0.0)), np.float32(1.0)) - batch.target[low + r, c]
            if counts:
                metrics[COLOUR] += np.float64(error) * error
                metrics[SQUARED] += np.float64(clipped) * clipped
            slope = np.float32(2.0) * error
            work.slopes[c, r] = slope
            work.slope2[c, r] = slope * residual * (np.float32(1.0) - residual)
    if head.used:
        _backward(head, work, rays)
        for c in range(3):
            for r in range(rays):
                work.slopes[c, r] += work.input_slopes[ENCODED + c, r]
    for r in range(rays):
        to_background = np.float32(0.0)
        for c in range(3):
            to_background += work.slopes[c, r] * batch.background[low + r, c]
        work.slopes[7, r] = to_background
        for c in range(4):
            work.slopes[3 + c, r] = work.input_slopes[ENCODED + 3 + c, r] if head.used else np.float32(0.0)


@njit(nogil=True, cache=True)
def _backward(head, work, rays):
    """From dL/d output before the sigmoid: the gradient of all weights, and dL/d inputs."""
    _input_slopes(work.slope2, head.w2, work.slope1, rays)
    for j in range(HIDDEN):
        for r in range(rays):
            if work.hidden1[j, r] <= 0:
                work.slope1[j, r] = 0.0
    _input_slopes(work.slope1, head.w1, work.slope0, rays)
    for j in range(HIDDEN):
        for r in range(rays):
            if work.hidden0[j, r] <= 0:
                work.slope0[j, r] = 0.0
    _input_slopes(work.slope0, head.w0, work.input_slopes, rays)
    start = _weight_slopes(work.inputs, work.slope0, rays, work.gradient, 0)
    start = _weight_slopes(work.hidden0, work.slope1, rays, work.gradient, start)
    _weight_slopes(work.hidden1, work.slope2, rays, work.gradient, start)
