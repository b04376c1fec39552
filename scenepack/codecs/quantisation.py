"""Quantisation: values in coarse steps, stored as counts of steps, which a lossless codec predicts better.

Colours, features or alphas are in steps of s if each is a multiple of s or its maximum: min(n s, alpha) for colours and features,
min(n s, 255) for alphas. The counts n are stored, and s. Packs tuned in steps of 4 and 16 take a tenth fewer bytes.
"""

from math import gcd
from typing import NamedTuple

import numpy as np

from scenepack.codecs.base import Parts

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


def steps_of(parts: Parts) -> Steps:
    """The coarsest steps of premultiplied parts; 1 where there are none."""
    rgba, *others = parts
    alpha = rgba[..., 3]
    of_features = _step(others[0], alpha) if others else 1
    opaque = np.broadcast_to(np.uint8(OPAQUE), alpha.shape)
    return Steps(_step(rgba[..., :3], alpha), of_features, _step(rgba[..., 3:], opaque))


def to_counts(parts: Parts, steps: Steps) -> Parts:
    """The parts of a piece as counts of steps."""
    rgba, *others = parts
    if (steps.colour, steps.alpha) != (1, 1):
        rgba = np.concatenate([_counts(rgba[..., :3], steps.colour), _counts(rgba[..., 3:], steps.alpha)], axis=-1)
    return [rgba, *(_counts(features, steps.feature) for features in others)]


def from_counts(parts: Parts, steps: Steps) -> Parts:
    """The inverse of `to_counts`."""
    rgba, *others = parts
    alpha = _times(rgba[..., 3:], steps.alpha, OPAQUE)
    if (steps.colour, steps.alpha) != (1, 1):
        rgba = np.concatenate([_times(rgba[..., :3], steps.colour, alpha), alpha], axis=-1)
    return [rgba, *(_times(features, steps.feature, alpha) for features in others)]


def in_steps(values: np.ndarray, step: int, most: np.ndarray | int) -> np.ndarray:
    """The same counts of steps under another maximum `most`: uint8."""
    return _times(_counts(values, step), step, most) if step > 1 else np.minimum(values, most)


def _step(values: np.ndarray, most: np.ndarray) -> int:
    step = 0
    for plane, bound in zip(values, most[..., None], strict=True):  # plane by plane: the first mostly says that it is 1
        if np.any(plane > bound):  # not premultiplied
            return 1
        step = gcd(step, int(np.gcd.reduce(plane[plane < bound], initial=0)))
        if step == 1:
            break
    return step if 1 <= step <= MOST_STEP else 1


def _counts(values: np.ndarray, step: int) -> np.ndarray:
    return values if step == 1 else ((values.astype(np.uint16) + (step - 1)) // step).astype(np.uint8)


def _times(counts: np.ndarray, step: int, most: np.ndarray | int) -> np.ndarray:
    return counts if step == 1 else np.minimum(counts * np.uint16(step), most).astype(np.uint8)
