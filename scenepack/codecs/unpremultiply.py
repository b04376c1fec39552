"""Unpremultiply colours for a lossy codec, and premultiply them again; smooth them where they are hardly visible.

Notation: c premultiplied colour or feature, a alpha, both 0 … 255; c̄ = c / a straight; ⟨·⟩ the mean over the 3³
neighbours weighted 1 2 1 along each axis. What a renderer adds up is a·c̄, so an error in c̄ counts a / 255 times,
and a codec, which cannot know that, spends most of its bits on the noise of nearly transparent voxels. Therefore
- each voxel's c̄ is drawn towards its surroundings, the more the fainter it is:
  c̄ = (c + k·⟨c⟩/⟨a⟩) / (a + k), with k = `smoothing` in units of alpha: two thirds fewer bits at equal quality;
- empty voxels, whose colour is invisible, continue their neighbours by means over 2³, 4³, … voxels ("pull-push"), so
  that no edge is coded at the surface; voxels far from all content are grey.
All is done within cells of 16³ voxels, the unit of most codecs' own macroblocks: cells without content cost nothing.
"""

from __future__ import annotations

import numpy as np

CELL = 16  # voxels
GREY = 128
CELLS_AT_ONCE = 128


def padded(values: np.ndarray, fill: int) -> np.ndarray:
    """[D, H, W, …] with rows and columns filled up to whole cells."""
    _, height, width = values.shape[:3]
    if height % CELL == 0 and width % CELL == 0:
        return values
    pad = [(0, 0), (0, -height % CELL), (0, -width % CELL)] + [(0, 0)] * (values.ndim - 3)
    return np.pad(values, pad, constant_values=fill)


def unpremultiply(values: np.ndarray, alpha: np.ndarray, smoothing: float) -> np.ndarray:
    """Premultiplied uint8 [D, H, W, C] as straight uint8 [D, H', W', C], filled; H' and W' are whole cells.

    alpha: uint8 [D, H, W].
    """
    return _in_cells(values, alpha, smoothing, premultiplied=True)


def filled(values: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """uint8 [D, H, W, C] as it is where alpha is above zero, and continued where it is not; whole cells."""
    return _in_cells(values, alpha, 0.0, premultiplied=False)


def premultiplied(values: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """The inverse of `straight`, uint8 [D, H, W, C]; never brighter than alpha, zero where alpha is zero."""
    _, height, width = alpha.shape
    product = values[:, :height, :width].astype(np.uint16) * alpha[..., None]
    return ((product + 127) // 255).astype(np.uint8)


def _in_cells(values: np.ndarray, alpha: np.ndarray, smoothing: float, *, premultiplied: bool) -> np.ndarray:
    depth, height, width, channels = values.shape
    counts = tuple(-(-side // CELL) for side in (depth, height, width))
    result = np.full((depth, counts[1] * CELL, counts[2] * CELL, channels), GREY, np.uint8)
    cells = [tuple(slice(i * CELL, (i + 1) * CELL) for i in cell) for cell in np.ndindex(counts)]
    cells = [cell for cell in cells if alpha[cell].any()]
    for start in range(0, len(cells), CELLS_AT_ONCE):
        some = cells[start : start + CELLS_AT_ONCE]
        weight = np.zeros((len(some), CELL, CELL, CELL, 1), np.float32)
        colour = np.zeros((len(some), CELL, CELL, CELL, channels), np.float32)
        for i, cell in enumerate(some):
            d, h, w = alpha[cell].shape
            weight[i, :d, :h, :w, 0] = alpha[cell]
            colour[i, :d, :h, :w] = values[cell]
        if not premultiplied:
            weight = (weight > 0).astype(np.float32)
            colour *= weight
        elif smoothing > 0:
            surroundings = _blurred(colour) / np.maximum(_blurred(weight), 1e-6)
            inside = smoothing * (weight > 0)
            colour, weight = colour + inside * surroundings, weight + inside
        mean = _pull_push(colour, weight)
        if premultiplied:
            mean *= 255
        cube = np.clip(np.rint(mean), 0, 255).astype(np.uint8)
        for i, cell in enumerate(some):
            d = result[cell].shape[0]
            result[cell] = cube[i, :d]
    return result


def _blurred(values: np.ndarray) -> np.ndarray:
    """Weights 1 2 1 along axes 1, 2, 3, zeros outside; not normalised."""
    for axis in (1, 2, 3):
        line = np.moveaxis(values, axis, 0)
        spread = 2 * line
        spread[1:] += line[:-1]
        spread[:-1] += line[1:]
        values = np.moveaxis(spread, 0, axis)
    return values


def _pull_push(total: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """total / weight [n, s, s, s, c], and where the weight is zero, that of the smallest 2³, 4³, … around with any."""
    mean = total / np.maximum(weight, 1e-6)
    side = total.shape[1]
    if side == 1:
        return mean
    pairs = (len(total), side // 2, 2, side // 2, 2, side // 2, 2, -1)
    coarse = _pull_push(total.reshape(pairs).sum((2, 4, 6)), weight.reshape(pairs).sum((2, 4, 6)))
    for axis in (1, 2, 3):
        coarse = coarse.repeat(2, axis)
    return np.where(weight > 0, mean, coarse)
