"""Adam for the rows that a step has changed.

A feature without a gradient is left alone, moments included (the masked Adam of DVGO, Sun et al. 2022).
"""

from __future__ import annotations

import numpy as np

from training.multires.fused.compiled import kernel
from training.multires.fused.vectors import FEATURES
from training.multires.settings import ADAM_BETAS, ADAM_EPSILON

BLOCK = 64 * FEATURES  # floats of the rows that share a mark
KEEP_1, KEEP_2 = (np.float32(beta) for beta in ADAM_BETAS)
NEW_1, NEW_2, EPSILON = (np.float32(value) for value in (1 - ADAM_BETAS[0], 1 - ADAM_BETAS[1], ADAM_EPSILON))


@kernel(error_model="numpy")
def move_marked(values, first, second, gradient, marks, scale, rate, low, high):
    """Moves the marked blocks low … high - 1 of flat arrays by gradient * scale, which is set to zero with its marks."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for block in range(low, high):
        if marks[block] == 0:
            continue
        marks[block] = 0
        start, end = block * BLOCK, (block + 1) * BLOCK
        value, mean, square, slope = values[start:end], first[start:end], second[start:end], gradient[start:end]
        for i in range(BLOCK):
            g = slope[i] * scale
            seen = one if g != zero else zero
            new_mean = mean[i] + seen * NEW_1 * (g - mean[i])
            new_square = square[i] + seen * NEW_2 * (g * g - square[i])
            mean[i], square[i], slope[i] = new_mean, new_square, zero
            value[i] -= seen * rate * new_mean / (np.sqrt(new_square) + EPSILON)
