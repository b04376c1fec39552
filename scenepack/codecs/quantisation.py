"""Quantisation: values in coarse steps, stored as counts of steps, which a lossless codec predicts better.

Colours, features or alphas are in steps of s if each is a multiple of s or its maximum: min(n s, alpha) for colours and features,
min(n s, 255) for alphas. The counts n are stored, and s. Packs tuned in steps of 4 and 16 take a tenth fewer bytes.
"""

from math import gcd
from typing import NamedTuple

import numpy as np

MOST_STEP = 128  # larger steps leave only zero and the maximum
OPAQUE = 255


class Steps(NamedTuple):
    """Step sizes of colours, features and alphas, in units of 1/255."""

    colour: int = 1
    feature: int = 1
    alpha: int = 1

    @property
    def channels(self) -> np.ndarray:
        """float32 [8], of colour, alpha and features."""
        return np.array([*[self.colour] * 3, self.alpha, *[self.feature] * 4], np.float32)


EXACT = Steps()


def steps_of(rgba: np.ndarray, features: np.ndarray | None) -> Steps:
    """The coarsest steps of premultiplied uint8 [D, H, W, 4]; 1 where there are none."""
    alpha = rgba[..., 3]
    of_features = 1 if features is None else _step(features, alpha)
    opaque = np.broadcast_to(np.uint8(OPAQUE), alpha.shape)
    return Steps(_step(rgba[..., :3], alpha), of_features, _step(rgba[..., 3:], opaque))


def to_counts(rgba: np.ndarray, features: np.ndarray | None, steps: Steps) -> tuple[np.ndarray, np.ndarray | None]:
    """rgba and features of a piece as counts of steps."""
    if (steps.colour, steps.alpha) != (1, 1):
        rgba = np.concatenate([_counts(rgba[..., :3], steps.colour), _counts(rgba[..., 3:], steps.alpha)], axis=-1)
    return rgba, features if features is None or steps.feature == 1 else _counts(features, steps.feature)


def from_counts(rgba: np.ndarray, features: np.ndarray | None, steps: Steps) -> tuple[np.ndarray, np.ndarray | None]:
    """The inverse of `to_counts`."""
    alpha = _times(rgba[..., 3:], steps.alpha, OPAQUE)
    if (steps.colour, steps.alpha) != (1, 1):
        rgba = np.concatenate([_times(rgba[..., :3], steps.colour, alpha), alpha], axis=-1)
    return rgba, features if features is None or steps.feature == 1 else _times(features, steps.feature, alpha)


def in_steps(values: np.ndarray, step: int, most: np.ndarray | int) -> np.ndarray:
    """The same counts of steps under another maximum `most`: uint8."""
    return _times(_counts(values, step), step, most) if step > 1 else np.minimum(values, most)


def _step(values: np.ndarray, most: np.ndarray) -> int:
    step = 0
    for plane, bound in zip(values, most, strict=True):  # plane by plane, because counting takes eight bytes a value
        if np.any(plane > bound[..., None]):  # not premultiplied
            return 1
        used = bound > 0
        some = plane[used]
        below = some[some < bound[used][:, None]]
        step = gcd(step, *(int(value) for value in np.flatnonzero(np.bincount(below, minlength=256))))
        if step == 1:
            break
    return step if 1 <= step <= MOST_STEP else 1


def _counts(values: np.ndarray, step: int) -> np.ndarray:
    return values if step == 1 else ((values.astype(np.uint16) + (step - 1)) // step).astype(np.uint8)


def _times(counts: np.ndarray, step: int, most: np.ndarray | int) -> np.ndarray:
    return counts if step == 1 else np.minimum(counts * np.uint16(step), most).astype(np.uint8)
