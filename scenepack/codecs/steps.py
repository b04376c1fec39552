"""Values in coarse steps, counted in steps: a lossless codec predicts a value from its neighbours, and a mean of counts falls on
a step as well. What is tuned in steps of 4 and 16 takes a tenth fewer bytes like this.

Colours, or features, are in steps of s where each is a multiple of s, or as large as its alpha allows: min(n s, alpha). The n are
stored; besides, a reader needs only s.
"""

from __future__ import annotations

from math import gcd

import numpy as np

Steps = tuple[int, int]  # of colours, and of features
MOST_STEP = 128  # beyond, there is all or nothing


def steps_of(rgba: np.ndarray, features: np.ndarray | None) -> Steps:
    """The coarsest steps that premultiplied uint8 [D, H, W, 4] are in; 1 where they are in none."""
    return _step(rgba[..., :3], rgba[..., 3]), 1 if features is None else _step(features, rgba[..., 3])


def counted(rgba: np.ndarray, features: np.ndarray | None, steps: Steps) -> tuple[np.ndarray, np.ndarray | None]:
    """rgba and features of a piece, in counts of steps; alpha stays."""
    if steps[0] > 1:
        rgba = np.concatenate([_counts(rgba[..., :3], steps[0]), rgba[..., 3:]], axis=-1)
    return rgba, features if features is None or steps[1] == 1 else _counts(features, steps[1])


def times(rgba: np.ndarray, features: np.ndarray | None, steps: Steps) -> tuple[np.ndarray, np.ndarray | None]:
    """The inverse of `counted`."""
    alpha = rgba[..., 3:]
    if steps[0] > 1:
        rgba = np.concatenate([_times(rgba[..., :3], steps[0], alpha), alpha], axis=-1)
    return rgba, features if features is None or steps[1] == 1 else _times(features, steps[1], alpha)


def _step(values: np.ndarray, alpha: np.ndarray) -> int:
    step = 0
    for plane, most in zip(values, alpha, strict=True):  # one by one, for counting takes eight bytes a value
        if np.any(plane > most[..., None]):  # not premultiplied
            return 1
        used = most > 0
        some = plane[used]
        below = some[some < most[used][:, None]]
        step = gcd(step, *(int(value) for value in np.flatnonzero(np.bincount(below, minlength=256))))
        if step == 1:
            break
    return step if 1 <= step <= MOST_STEP else 1


def _counts(values: np.ndarray, step: int) -> np.ndarray:
    return ((values.astype(np.uint16) + (step - 1)) // step).astype(np.uint8)


def _times(counts: np.ndarray, step: int, alpha: np.ndarray) -> np.ndarray:
    return np.minimum(counts * np.uint16(step), alpha).astype(np.uint8)
