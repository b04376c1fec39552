"""The decoder over blocks of samples: matrix products, activations, and their gradients.

Notation: n samples, a multiple of SAMPLES; x [n, I] inputs, hidden [n, 64], raw [n, 8] outputs; all sample-major and flat.
Parameters are one flat array: w0 [I, 64], b0 [64], w1 [64, 8], b1 [8], then those of the view MLP. I is a multiple of 8.
"""

# pyright: reportCallIssue=false

import numpy as np

from training.multires.field import HIDDEN, OUTPUTS
from training.multires.fused.compiled import kernel
from training.multires.fused.vectors import add_product_4x16, add_product_8x8, set_product_4x16, set_product_8x8

SAMPLES = 64  # that are decoded together: their activations stay in the first cache
ANYTHING = np.float32(-np.inf)  # the least of an output that is not rectified
LARGEST = np.float32(87.0)  # e^x of float32 stays finite and normal for |x| up to this
_LOG2_E, _LN_2 = np.float32(1.4426950408889634), np.float32(0.6931471805599453)


@kernel
def add_product(left, right, out, inner, rows, columns):
    """out [rows, columns] += left [rows, inner] right [inner, columns]; rows and columns are multiples of 8, or rows of 4 and
    columns of 16.

    Matrices are tuples: left (array, start, stride of rows, stride of columns), right and out (array, start, stride of rows), in
    elements of flat arrays.
    """
    wide = columns // 16 * 16
    for column in range(0, wide, 16):
        for row in range(0, rows, 4):
            add_product_4x16(
                (left[0], left[1] + row * left[2], left[2], left[3]), (right[0], right[1] + column, right[2]),
                (out[0], out[1] + row * out[2] + column, out[2]), inner,
            )  # fmt: skip
    if wide < columns:
        for row in range(0, rows, 8):
            add_product_8x8(
                (left[0], left[1] + row * left[2], left[2], left[3]), (right[0], right[1] + wide, right[2]),
                (out[0], out[1] + row * out[2] + wide, out[2]), inner,
            )  # fmt: skip


@kernel
def set_product(left, right, out, bias, inner, rows, columns):
    """out = max(left right + bias, least), bias (array, start, least) of `columns` values; otherwise as add_product."""
    wide = columns // 16 * 16
    for column in range(0, wide, 16):
        for row in range(0, rows, 4):
            set_product_4x16(
                (left[0], left[1] + row * left[2], left[2], left[3]), (right[0], right[1] + column, right[2]),
                (out[0], out[1] + row * out[2] + column, out[2]), inner, (bias[0], bias[1] + column, bias[2]),
            )  # fmt: skip
    if wide < columns:
        for row in range(0, rows, 8):
            set_product_8x8(
                (left[0], left[1] + row * left[2], left[2], left[3]), (right[0], right[1] + wide, right[2]),
                (out[0], out[1] + row * out[2] + wide, out[2]), inner, (bias[0], bias[1] + wide, bias[2]),
            )  # fmt: skip


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
    inputs, parameters, zero = field.inputs, field.parameters, np.float32(0.0)
    b0 = inputs * HIDDEN
    w1 = b0 + HIDDEN
    b1 = w1 + HIDDEN * OUTPUTS
    x, hidden = (scratch.x, first * inputs, inputs, 1), (scratch.hidden, first * HIDDEN, HIDDEN)
    set_product(x, (parameters, 0, HIDDEN), hidden, (parameters, b0, zero), inputs, samples, HIDDEN)
    set_product(
        (scratch.hidden, first * HIDDEN, HIDDEN, 1), (parameters, w1, OUTPUTS), (scratch.raw, first * OUTPUTS, OUTPUTS),
        (parameters, b1, ANYTHING), HIDDEN, samples, OUTPUTS,
    )  # fmt: skip


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
    inputs, turned = field.inputs, field.turned
    b0 = inputs * HIDDEN
    w1 = b0 + HIDDEN
    b1 = w1 + HIDDEN * OUTPUTS
    h, o = first * HIDDEN, first * OUTPUTS
    nothing = (turned, (OUTPUTS + inputs) * HIDDEN, ANYTHING)
    slopes, at_hidden = scratch.slopes, scratch.hidden_slopes
    add_product(
        (scratch.hidden, h, 1, HIDDEN), (slopes, o, OUTPUTS), (gradient, w1, OUTPUTS), samples, HIDDEN, OUTPUTS
    )  # fmt: skip
    add_sums(slopes[o : o + samples * OUTPUTS], samples, gradient, b1, OUTPUTS)
    set_product(
        (slopes, o, OUTPUTS, 1), (turned, 0, HIDDEN), (at_hidden, 0, HIDDEN), nothing, OUTPUTS, samples, HIDDEN
    )  # fmt: skip
    on = scratch.hidden[h : h + samples * HIDDEN]
    for i in range(on.size):
        at_hidden[i] = at_hidden[i] if on[i] > np.float32(0.0) else np.float32(0.0)
    add_sums(at_hidden, samples, gradient, b0, HIDDEN)
    add_product(
        (scratch.x, first * inputs, 1, inputs), (at_hidden, 0, HIDDEN), (gradient, 0, HIDDEN), samples, inputs, HIDDEN
    )  # fmt: skip
    set_product(
        (at_hidden, 0, HIDDEN, 1), (turned, OUTPUTS * HIDDEN, inputs), (scratch.x_slopes, 0, inputs), nothing, HIDDEN, samples,
        inputs,
    )  # fmt: skip


@kernel
def add_sums(rows, count, sums, first, width):
    """Adds so many rows of `width` values to sums, from `first`."""
    into = sums[first : first + width]
    for n in range(count):
        row = rows[n * width : (n + 1) * width]
        for c in range(width):
            into[c] += row[c]
