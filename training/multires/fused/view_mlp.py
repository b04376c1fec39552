"""The view MLP over a chunk of rays, forward and backward, by the matrix products of training.multires.fused.network.

Notation: m rays that have samples, padded to whole tiles; inputs [m, INPUTS] are ordered for the products: colour (3),
features (4), a zero, encoded direction (27), a zero. Parameters are laid out alike, flat: w0 [INPUTS, 16], b0, w1 [16, 16], b1,
w2 [16, 8], b2 [8], of which the last two have three columns that count. PLACES says where each parameter of
training.multires.field is.
"""

# pyright: reportCallIssue=false

from typing import NamedTuple

import numpy as np

from training.multires.fused.compiled import kernel
from training.multires.fused.network import ANYTHING, add_layer_gradient, cut, set_layer

INPUTS, HIDDEN, OUTPUTS = 36, 16, 8
DIRECTION = 8  # of the inputs: where the direction begins
OCTAVES = 4
B0 = INPUTS * HIDDEN
W1 = B0 + HIDDEN
B1 = W1 + HIDDEN * HIDDEN
W2 = B1 + HIDDEN
B2 = W2 + HIDDEN * OUTPUTS
SIZE = B2 + OUTPUTS
TURNED_W1 = OUTPUTS * HIDDEN
TURNED_W0 = TURNED_W1 + HIDDEN * HIDDEN
ZEROS = TURNED_W0 + HIDDEN * OUTPUTS
# sums over rays: squared error, the same of clipped colours, distortion, sparsity, smoothness, counts of rays and samples
METRICS = 7
COLOUR, SQUARED, DISTORTION, SPARSITY, SMOOTHNESS, RAYS, SAMPLES = range(METRICS)


def _places() -> np.ndarray:
    rows = np.concatenate([DIRECTION + np.arange(27), np.arange(7)])  # the published order: direction, colour, features
    w0 = (rows[:, None] * HIDDEN + np.arange(HIDDEN)).ravel()
    w2 = (np.arange(HIDDEN)[:, None] * OUTPUTS + np.arange(3)).ravel()
    return np.concatenate([w0, np.arange(B0, W2), W2 + w2, B2 + np.arange(3)])


PLACES = _places()


def packed(view_mlp: np.ndarray) -> np.ndarray:
    """Parameters [SIZE] of the flat ones of training.multires.field."""
    parameters = np.zeros(SIZE, np.float32)
    parameters[PLACES] = view_mlp
    return parameters


def turned(parameters: np.ndarray) -> np.ndarray:
    """w2^T [8, 16], w1^T, the first rows of w0, those of colour and features, as [16, 8], and zeros, for the gradients."""
    first_w0, w1, w2 = parameters[: DIRECTION * HIDDEN], parameters[W1:B1], parameters[W2:B2]
    parts = [weights.reshape(-1, width).T for weights, width in ((w2, OUTPUTS), (w1, HIDDEN), (first_w0, HIDDEN))]
    return np.concatenate([*(part.ravel() for part in parts), np.zeros(HIDDEN, np.float32)])


class Shading(NamedTuple):
    """Memory of one worker, of each of m rays."""

    ray: np.ndarray  # its number in the chunk
    inputs: np.ndarray
    hidden0: np.ndarray
    hidden1: np.ndarray
    output: np.ndarray
    slope0: np.ndarray  # of hidden0, as the next two of hidden1 and output
    slope1: np.ndarray
    slope2: np.ndarray
    input_slopes: np.ndarray  # of the first eight inputs


def make_shading(rays: int) -> Shading:
    """Memory for chunks of so many rays."""
    widths = INPUTS, HIDDEN, HIDDEN, OUTPUTS, HIDDEN, HIDDEN, OUTPUTS, OUTPUTS
    return Shading(np.zeros(rays, np.int64), *(np.zeros(rays * width, np.float32) for width in widths))


@kernel
def _encode(viewdirs, ray, octaves, inputs, at):
    """v, sin(2^k v), sin(2^k v + pi/2), frequency-major, by doubling the angle; zero from octave k = octaves on."""
    one, two = np.float32(1.0), np.float32(2.0)
    for axis in range(3):
        v = viewdirs[ray, axis]
        inputs[at + axis] = v
        sine, cosine = np.sin(v), np.cos(v)
        for k in range(OCTAVES):
            inputs[at + 3 + 3 * k + axis] = sine if k < octaves else np.float32(0.0)
            inputs[at + 15 + 3 * k + axis] = cosine if k < octaves else np.float32(0.0)
            sine, cosine = two * sine * cosine, one - two * sine * sine


@kernel
def shade_chunk(low, count, batch, field, numbers, scratch, work, metrics, gradient):
    """Adds errors of `count` rays, work.ray of the chunk from `low`, to metrics, and the view MLP's gradient to `gradient`.

    scratch.ray_slopes [CHUNK, 8] become dL/dbehind, then dL/dsums. See training.multires.fused.chunk.
    """
    rows, behind, sums, slopes = (count + 7) // 8 * 8, scratch.behind, scratch.sums, scratch.ray_slopes
    x, zero, one = work.inputs, np.float32(0.0), np.float32(1.0)
    for i in range(rows):
        r, at = work.ray[min(i, count - 1)], i * INPUTS
        for c in range(3):
            x[at + c] = sums[r * 8 + 1 + c] + behind[r] * batch.background[low + r, c]
        for c in range(4):
            x[at + 3 + c] = sums[r * 8 + 4 + c]
        if numbers.has_view_mlp:
            _encode(batch.viewdirs, low + r, numbers.octaves, x, at + DIRECTION)
    if numbers.has_view_mlp:
        w, first, h0, h1 = field.parameters, numbers.first_view, work.hidden0, work.hidden1
        set_layer(x, INPUTS, w, first, first + B0, zero, h0, HIDDEN, rows)
        set_layer(h0, HIDDEN, w, first + W1, first + B1, zero, h1, HIDDEN, rows)
        set_layer(h1, HIDDEN, w, first + W2, first + B2, ANYTHING, work.output, OUTPUTS, rows)
    metrics[RAYS] += count
    work.slope2[: rows * OUTPUTS] = zero
    for i in range(count):
        r = work.ray[i]
        shaded = numbers.has_view_mlp and behind[r] <= numbers.shaded_below
        for c in range(3):
            colour, residual = x[i * INPUTS + c], zero
            if shaded:
                residual = np.float32(one / (one + np.exp(-work.output[i * OUTPUTS + c])))
                colour += residual
            error = colour - batch.target[low + r, c]
            clipped = min(max(colour, zero), one) - batch.target[low + r, c]
            metrics[COLOUR] += np.float64(error) * error
            metrics[SQUARED] += np.float64(clipped) * clipped
            slope = np.float32(2.0) * error
            slopes[r * 8 + 1 + c] = slope
            work.slope2[i * OUTPUTS + c] = slope * residual * (one - residual)
    if numbers.has_view_mlp:
        _backward(rows, field, numbers, work, gradient)
    else:
        work.input_slopes[: rows * OUTPUTS] = zero
    for i in range(count):
        r, to_background = work.ray[i], zero
        for c in range(3):
            slopes[r * 8 + 1 + c] += work.input_slopes[i * OUTPUTS + c]
            to_background += slopes[r * 8 + 1 + c] * batch.background[low + r, c]
        for c in range(4):
            slopes[r * 8 + 4 + c] = work.input_slopes[i * OUTPUTS + 3 + c]
        slopes[r * 8] = to_background


@kernel
def _backward(rows, field, numbers, work, gradient):
    """From dL/doutput before the sigmoid: adds to the gradient of the parameters, and sets those of the first inputs."""
    x, h0, h1, turned = work.inputs, work.hidden0, work.hidden1, field.turned
    s0, s1, s2 = work.slope0, work.slope1, work.slope2
    first, back = numbers.first_view, numbers.first_turned
    zeros = back + ZEROS
    add_layer_gradient(h1, HIDDEN, s2, OUTPUTS, gradient, first + W2, rows)
    set_layer(s2, OUTPUTS, turned, back, zeros, ANYTHING, s1, HIDDEN, rows)
    cut(s1, h1, rows * HIDDEN)
    add_layer_gradient(h0, HIDDEN, s1, HIDDEN, gradient, first + W1, rows)
    set_layer(s1, HIDDEN, turned, back + TURNED_W1, zeros, ANYTHING, s0, HIDDEN, rows)
    cut(s0, h0, rows * HIDDEN)
    add_layer_gradient(x, INPUTS, s0, HIDDEN, gradient, first, rows)
    set_layer(s0, HIDDEN, turned, back + TURNED_W0, zeros, ANYTHING, work.input_slopes, OUTPUTS, rows)
