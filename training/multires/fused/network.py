"""The decoder over blocks of samples: matrix products, activations, and their gradients.

Notation: n samples, a multiple of SAMPLES; x [n, I] inputs, hidden [n, 64], raw [n, 8] outputs; all sample-major and flat.
Parameters are one flat array: w0 [I, 64], b0 [64], w1 [64, 8], b1 [8], then those of the view MLP. I is a multiple of 8.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

import numpy as np
from numba import njit

from training.multires.field import HIDDEN, OUTPUTS
from training.multires.fused.vectors import (
    add_product_4x16,
    add_product_8x8,
    set_product_4x16,
    set_product_8x8,
)

SAMPLES = 64  # that are decoded together: their activations stay in the first cache
LARGEST = np.float32(87.0)  # e^x of float32 stays finite and normal for |x| up to this
_LOG2_E, _LN_2 = np.float32(1.4426950408889634), np.float32(0.6931471805599453)


@njit(nogil=True, cache=True)
def add_product(a, a_start, a_row, a_inner, b, b_start, b_inner, inner, out, out_start, out_row, rows, columns):
    """out [rows, columns] += a [rows, inner] b [inner, columns], flat arrays from their starts. Strides are in elements.

    rows and columns are multiples of 8.
    """
    wide = columns // 16 * 16
    for column in range(0, wide, 16):
        for row in range(0, rows, 4):
            add_product_4x16(
                a, a_start + row * a_row, a_row, a_inner, b, b_start + column, b_inner, inner, out,
                out_start + row * out_row + column, out_row,
            )  # fmt: skip
    if wide < columns:
        for row in range(0, rows, 8):
            add_product_8x8(
                a, a_start + row * a_row, a_row, a_inner, b, b_start + wide, b_inner, inner, out,
                out_start + row * out_row + wide, out_row,
            )  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy")
def exp_in_place(values):
    """e^values, to float32 rounding, of values cut to ± LARGEST: a polynomial, computed as vectors."""
    one = np.float32(1.0)
    for i in range(values.size):
        y = min(max(values[i], -LARGEST), LARGEST) * _LOG2_E
        whole = np.floor(y + np.float32(0.5))
        f = (y - whole) * _LN_2
        p = np.float32(1 / 5040) * f + np.float32(1 / 720)
        p = p * f + np.float32(1 / 120)
        p = p * f + np.float32(1 / 24)
        p = p * f + np.float32(1 / 6)
        p = p * f + np.float32(0.5)
        p = (p * f + one) * f + one
        values[i] = p * np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32)


@njit(nogil=True, cache=True)
def set_product(
    a, a_start, a_row, a_inner, b, b_start, b_inner, inner, out, out_start, out_row, bias, bias_start, least, rows, columns
):  # fmt: skip
    """out = max(a b + bias, least), bias [columns]; otherwise as add_product."""
    wide = columns // 16 * 16
    for column in range(0, wide, 16):
        for row in range(0, rows, 4):
            set_product_4x16(
                a, a_start + row * a_row, a_row, a_inner, b, b_start + column, b_inner, inner, out,
                out_start + row * out_row + column, out_row, bias, bias_start + column, least,
            )  # fmt: skip
    if wide < columns:
        for row in range(0, rows, 8):
            set_product_8x8(
                a, a_start + row * a_row, a_row, a_inner, b, b_start + wide, b_inner, inner, out,
                out_start + row * out_row + wide, out_row, bias, bias_start + wide, least,
            )  # fmt: skip


@njit(nogil=True, cache=True)
def decode(x, hidden, raw, first, samples, inputs, parameters):
    """Sets hidden and raw of so many samples from `first`."""
    b0 = inputs * HIDDEN
    w1 = b0 + HIDDEN
    b1 = w1 + HIDDEN * OUTPUTS
    h, o = first * HIDDEN, first * OUTPUTS
    set_product(
        x, first * inputs, inputs, 1, parameters, 0, HIDDEN, inputs, hidden, h, HIDDEN, parameters, b0, np.float32(0.0),
        samples, HIDDEN,
    )  # fmt: skip
    set_product(
        hidden, h, HIDDEN, 1, parameters, w1, OUTPUTS, HIDDEN, raw, o, OUTPUTS, parameters, b1, np.float32(-np.inf),
        samples, OUTPUTS,
    )  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy")
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


@njit(nogil=True, cache=True)
def add_gradient(x, hidden, slopes, first, samples, inputs, parameters, turned, scratch, x_slopes, gradient):
    """Adds dL/dparameters of so many samples from `first` to gradient, and sets x_slopes [samples, I] = dL/dx.

    slopes [n, 8]: dL/draw. turned: w1^T [8, 64], w0^T [64, I], then 64 zeros. scratch [SAMPLES, 64].
    """
    b0 = inputs * HIDDEN
    w1 = b0 + HIDDEN
    b1 = w1 + HIDDEN * OUTPUTS
    h, o, zeros, anything = first * HIDDEN, first * OUTPUTS, (OUTPUTS + inputs) * HIDDEN, np.float32(-np.inf)
    add_product(hidden, h, 1, HIDDEN, slopes, o, OUTPUTS, samples, gradient, w1, OUTPUTS, HIDDEN, OUTPUTS)
    add_sums(slopes[o : o + samples * OUTPUTS], samples, gradient, b1, OUTPUTS)
    set_product(
        slopes, o, OUTPUTS, 1, turned, 0, HIDDEN, OUTPUTS, scratch, 0, HIDDEN, turned, zeros, anything, samples, HIDDEN
    )  # fmt: skip
    on, at_hidden = hidden[h : h + samples * HIDDEN], scratch[: samples * HIDDEN]
    for i in range(on.size):
        at_hidden[i] = at_hidden[i] if on[i] > np.float32(0.0) else np.float32(0.0)
    add_sums(scratch, samples, gradient, b0, HIDDEN)
    add_product(x, first * inputs, 1, inputs, scratch, 0, HIDDEN, samples, gradient, 0, HIDDEN, inputs, HIDDEN)
    set_product(
        scratch, 0, HIDDEN, 1, turned, OUTPUTS * HIDDEN, inputs, HIDDEN, x_slopes, 0, inputs, turned, zeros, anything,
        samples, inputs,
    )  # fmt: skip


@njit(nogil=True, cache=True)
def add_sums(rows, count, sums, first, width):
    """Adds so many rows of `width` values to sums, from `first`."""
    into = sums[first : first + width]
    for n in range(count):
        row = rows[n * width : (n + 1) * width]
        for c in range(width):
            into[c] += row[c]
