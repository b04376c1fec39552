"""The contraction of unbounded scenes: all of space in a cube, so that rays stay straight piece by piece.

Notation: lengths in units of R, the half side of the inner cube, about its centre; w = |x|∞. Inside the inner cube nothing moves.
Outside, the largest coordinate becomes ±(2 - 1/w) and the others are divided by w: space ends at ±2. On each side of the cube
this is a projective map, which keeps lines straight. Source: Reiser et al., "MERF" (2023), section 4.1.

A path is a ray after the contraction. Its length s is measured in contracted space, from where the ray begins.
Functions take NumPy arrays, or others by their module `xp`.
"""

from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

MOST_PIECES = 7  # of a path: |x|∞ and 1 are the envelope of seven linear functions, each of which leads once at most


def contract(points: Any, xp: ModuleType = np) -> Any:
    """Points [..., 3] of space in contracted space."""
    w = xp.maximum(xp.abs(points).max(-1, keepdims=True), 1.0)
    return xp.where(xp.abs(points) >= w, xp.sign(points) * (2.0 - 1.0 / w), points / w)


def uncontract(points: np.ndarray) -> np.ndarray:
    """The inverse of contract, for points [..., 3] with |u|∞ < 2."""
    largest = np.abs(points).max(-1, keepdims=True)
    w = 1.0 / (2.0 - np.maximum(largest, 1.0))
    outer = (np.abs(points) == largest) & (largest > 1.0)
    return np.where(outer, np.sign(points) * w, points * w)


class Path(NamedTuple):
    """N contracted rays in P pieces: at length s, from starts[n, p] on, a point is origins[n, p] + s directions[n, p]."""

    origins: Any  # [N, P, 3]
    directions: Any  # [N, P, 3], unit length
    starts: Any  # [N, P]: length at which a piece begins; infinite where there is none
    ends: Any  # [N]: length of the whole path, to infinity
    times: Any  # [N, P]: t of the ray where a piece begins
    widths: Any  # [N, P]: w at the beginning of a piece
    rates: Any  # [N, P]: dw/dt
    speeds: Any  # [N, P]: |du/dt| w²


def path_of(origins: Any, directions: Any, begin: Any, xp: ModuleType = np) -> Path:
    """The path of rays x(t) = origins [N, 3] + t directions [N, 3], from t = begin [N] on."""
    one = xp.ones_like(begin)[:, None]
    values = xp.concatenate([origins, -origins, one], axis=1)  # seven linear functions of t, the largest of which is w
    slopes = xp.concatenate([directions, -directions, 0.0 * one], axis=1)
    t, s = begin, xp.zeros_like(begin)
    leads = (values + slopes * t[:, None]).argmax(1)
    pieces = []
    for _ in range(MOST_PIECES):
        exists = xp.isfinite(t)
        at = xp.where(exists, t, 0.0)
        value, rate = (xp.take_along_axis(a, leads[:, None], axis=1)[:, 0] for a in (values, slopes))
        width, inner = xp.where(exists, value + rate * at, 1.0), leads == 6
        outward = xp.where(leads < 3, 1.0, -1.0)[:, None] * (xp.arange(3) == (leads % 3)[:, None])
        outward = xp.where(inner[:, None], 0.0, outward)  # unit vector through the side of the cube that leads
        x = origins + at[:, None] * directions
        place = xp.where(outward != 0.0, outward * (2.0 - 1.0 / width[:, None]), x / width[:, None])
        # du/dt = V / w²
        moved = xp.where(outward != 0.0, outward * rate[:, None], directions * value[:, None] - origins * rate[:, None])
        speed = xp.where(exists, xp.sqrt((moved * moved).sum(1)), 1.0)
        unit = moved / speed[:, None]
        pieces.append((place - s[:, None] * unit, unit, xp.where(exists, s, xp.inf), t, width, rate, speed))
        overtakes = slopes > rate[:, None]
        gap = xp.where(overtakes, slopes - rate[:, None], 1.0)
        crossings = xp.where(overtakes, (value[:, None] - values) / gap, xp.inf)
        after = xp.where(exists, xp.maximum(crossings.min(1), t), xp.inf)
        leads, ends_here = crossings.argmin(1), ~xp.isfinite(after)
        lasts = xp.where(ends_here, 0.0, after) - at
        farther = xp.where(ends_here, 1.0, width + rate * lasts)
        last = 1.0 / xp.where(ends_here, width * xp.where(rate > 0, rate, 1.0), 1.0)
        grown = speed * xp.where(ends_here, last, lasts / (width * farther))
        s, t = xp.where(exists, s + grown, s), after
    columns = [xp.stack(column, 1) for column in zip(*pieces, strict=True)]
    return Path(columns[0], columns[1], columns[2], s, *columns[3:])


def piece_at(path: Path, s: Any) -> Any:
    """int [N, ...]: which piece of each path holds the length s [N, ...]."""
    starts = path.starts.reshape(len(path.starts), *(1,) * (s.ndim - 1), -1)
    return (starts <= s[..., None]).sum(-1).clip(1) - 1


def time_at(path: Path, s: Any, xp: ModuleType = np) -> Any:
    """t [N] of the rays at lengths s [N]; infinite at a path's end."""
    piece = piece_at(path, s)[:, None]
    start, time, width, rate, speed = (
        xp.take_along_axis(column, piece, axis=1)[:, 0]
        for column in (path.starts, path.times, path.widths, path.rates, path.speeds)
    )
    left = speed - (s - start) * width * rate
    return time + xp.where(left > 0, (s - start) * width**2 / xp.where(left > 0, left, 1.0), xp.inf)
