"""The decoder over blocks of samples: matrix products, activations, and their gradients.

Notation: n samples, a multiple of SAMPLES; x [n, I] inputs, hidden [n, 64], raw [n, 8] outputs; all sample-major and flat.
Parameters are one flat array: w0 [I, 64], b0 [64], w1 [64, 8], b1 [8], then those of the view MLP. I is a multiple of 8.
"""

# pyright: reportCallIssue=false

import numpy as np

from training.multires.field import HIDDEN, OUTPUTS
from training.multires.fused.compiled import kernel
from training.multires.fused.vectors import tile_product_4x16, tile_product_8x8

SAMPLES = 64  # that are decoded together: their activations stay in the first cache
ANYTHING = np.float32(-np.inf)  # the least of an output that is not rectified
LARGEST = np.float32(87.0)  # e^x of float32 stays finite and normal for |x| up to this
_LOG2_E, _LN_2 = np.float32(1.4426950408889634), np.float32(0.6931471805599453)


@kernel
def set_product(left, right, out, bias, inner, rows, columns):
    """out [rows, columns] = max(least, left [rows, inner] right [inner, columns] + bias); rows and columns are multiples of 8, or
    rows of 4 and columns of 16.

    Matrices are tuples: left (array, start, stride of rows, stride of columns), right and out (array, start, stride of rows),
    bias (array, start, stride of rows, least), in elements of flat arrays.
    """
    wide = columns // 16 * 16
    for column in range(0, wide, 16):
        for row in range(0, rows, 4):
            tile_product_4x16(*_tile(left, right, out, bias, row, column), inner)
    if wide < columns:
        for row in range(0, rows, 8):
            tile_product_8x8(*_tile(left, right, out, bias, row, wide), inner)


@kernel(inline="always")
def _tile(left, right, out, bias, row, column):
    """The same matrices from a row and a column of `out` on."""
    return (
        (left[0], left[1] + row * left[2], left[2], left[3]), (right[0], right[1] + column, right[2]),
        (out[0], out[1] + row * out[2] + column, out[2]), (bias[0], bias[1] + row * bias[2] + column, bias[2], bias[3]),
    )  # fmt: skip


@kernel
def set_layer(source, inputs, parameters, weights, biases, least, out, outputs, rows):
    """out [rows, outputs] = max(least, source [rows, inputs] w + b); where w [inputs, outputs] and b begin in parameters."""
    set_product(
        (source, 0, inputs, 1), (parameters, weights, outputs), (out, 0, outputs), (parameters, biases, 0, least),
        inputs, rows, outputs,
    )  # fmt: skip


@kernel
def add_layer_gradient(source, inputs, slopes, outputs, gradient, first, rows):
    """Adds the gradient of a layer's w, from `first` of gradient, and of b behind it; slopes [rows, outputs]: of its output."""
    weights = (gradient, first, outputs)
    set_product((source, 0, 1, inputs), (slopes, 0, outputs), weights, (*weights, ANYTHING), rows, inputs, outputs)
    into = gradient[first + inputs * outputs : first + (inputs + 1) * outputs]
    for n in range(rows):
        row = slopes[n * outputs : (n + 1) * outputs]
        for c in range(outputs):
            into[c] += row[c]


@kernel
def cut(slopes, hidden, count):
    """Slopes are zero where a rectified layer is."""
    for i in range(count):
        slopes[i] = slopes[i] if hidden[i] > np.float32(0.0) else np.float32(0.0)


@kernel(inline="always")
def _power(x):
    """(n, e^r - 1) where e^x = 2^n e^r and |r| < 0.35, of x cut to ± LARGEST; to float32 rounding."""
    y = min(max(x, -LARGEST), LARGEST) * _LOG2_E
    whole = np.floor(y + np.float32(0.5))
    f = (y - whole) * _LN_2
    p = np.float32(1 / 5040) * f + np.float32(1 / 720)
    p = p * f + np.float32(1 / 120)
    p = p * f + np.float32(1 / 24)
    p = p * f + np.float32(1 / 6)
    p = p * f + np.float32(0.5)
    return np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32), (p * f + np.float32(1.0)) * f


@kernel(error_model="numpy")
def exp_in_place(values):
    """e^values, to float32 rounding, of values cut to ± LARGEST: a polynomial, computed as vectors."""
    for i in range(values.size):
        scale, rest = _power(values[i])
        values[i] = scale * (rest + np.float32(1.0))


@kernel(error_model="numpy")
def opacity_in_place(values):
    """1 - e^-values, as exp_in_place."""
    for i in range(values.size):
        scale, rest = _power(-values[i])
        values[i] = (np.float32(1.0) - scale) - scale * rest


@kernel
def decode(field, scratch, first, samples):
    """Sets hidden and raw of so many samples from `first`; field and scratch: see training.multires.fused.chunk."""
    inputs, parameters, w1 = field.inputs, field.parameters, (field.inputs + 1) * HIDDEN
    x, hidden, raw = scratch.x[first * inputs :], scratch.hidden[first * HIDDEN :], scratch.raw[first * OUTPUTS :]
    set_layer(x, inputs, parameters, 0, inputs * HIDDEN, np.float32(0.0), hidden, HIDDEN, samples)
    set_layer(hidden, HIDDEN, parameters, w1, w1 + HIDDEN * OUTPUTS, ANYTHING, raw, OUTPUTS, samples)


@kernel(error_model="numpy")
def activate(raw, density, first, samples, largest_raw):
    """Raw outputs [n, 8] become [unused, colours and features in [0, 1]]; density [n] = e^min(raw 0, largest_raw)."""
    one = np.float32(1.0)
    values, densities = raw[first * OUTPUTS : (first + samples) * OUTPUTS], density[first : first + samples]
    for i in range(values.size):
        values[i] = -values[i]
    for n in range(samples):
        values[n * OUTPUTS] = min(-values[n * OUTPUTS], largest_raw)
    exp_in_place(values)
    for n in range(samples):
        densities[n] = values[n * OUTPUTS]
    for i in range(values.size):
        values[i] = one / (one + values[i])


@kernel
def add_gradient(field, scratch, first, samples, gradient):
    """Adds dL/dparameters of so many samples from `first` to gradient, and sets scratch.x_slopes [samples, I] = dL/dx.

    scratch.slopes [n, 8]: dL/draw. field.turned: w1^T [8, 64], w0^T [64, I], then 64 zeros.
    """
    inputs, turned, at_hidden = field.inputs, field.turned, scratch.hidden_slopes
    zeros = (OUTPUTS + inputs) * HIDDEN
    x, hidden, slopes = scratch.x[first * inputs :], scratch.hidden[first * HIDDEN :], scratch.slopes[first * OUTPUTS :]
    add_layer_gradient(hidden, HIDDEN, slopes, OUTPUTS, gradient, (inputs + 1) * HIDDEN, samples)
    set_layer(slopes, OUTPUTS, turned, 0, zeros, ANYTHING, at_hidden, HIDDEN, samples)
    cut(at_hidden, hidden, samples * HIDDEN)
    add_layer_gradient(x, inputs, at_hidden, HIDDEN, gradient, 0, samples)
    set_layer(at_hidden, HIDDEN, turned, OUTPUTS * HIDDEN, zeros, ANYTHING, scratch.x_slopes, inputs, samples)
