"""Which pairs of pictures are matched: all of few; of many, neighbours in their order and those that look most alike.

Pictures look alike whose features of the largest scale match ("preemptive matching", Wu, Towards Linear-time Incremental
Structure from Motion, 3DV 2013). That also finds where a walk around something comes back to its beginning.

Notation: N pictures, numbered in the order of their names; F features of each, descriptors uint8 [F, 128].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

ALL_UP_TO = 60  # pictures of which all pairs are matched
OVERLAP = 8  # next pictures that each is matched with; and those 16, 32, … further on
MOST_ALIKE = 12  # others
LARGEST = 200  # features that are compared, of the largest scale
RATIO = 0.85  # of the distances to the nearest and the second nearest feature, at most
TOGETHER = 50  # pictures that one is compared with at once: 8 MB
FEWEST = 4  # such matches; fewer are chance


def all_pairs(count: int) -> list[tuple[int, int]]:
    """Every two of `count` pictures."""
    return [(i, j) for i in range(count) for j in range(i + 1, count)]


def how_many_pairs(count: int) -> int:
    """How many pairs of `count` pictures are matched, at most."""
    return count * (count - 1) // 2 if count <= ALL_UP_TO else count * (len(_steps(count)) + MOST_ALIKE)


def _steps(count: int) -> list[int]:
    """How much further on in the order the pictures are that each is matched with."""
    return [*range(1, OVERLAP + 1), *(1 << k for k in range(count.bit_length()) if 1 << k > OVERLAP)]


def chosen_pairs(descriptors: Sequence[np.ndarray]) -> list[tuple[int, int]]:
    """Sorted pairs (i, j), i < j, of pictures with these features of the largest scale: [F, 128] each."""
    count = len(descriptors)
    pairs = {(i, i + step) for i in range(count) for step in _steps(count) if i + step < count}
    alike = likeness(descriptors)
    for i in range(count):
        best = np.argsort(-alike[i], kind="stable")[:MOST_ALIKE]
        pairs |= {(min(i, j), max(i, j)) for j in map(int, best) if alike[i, j] >= FEWEST}
    return sorted(pairs)


def likeness(descriptors: Sequence[np.ndarray]) -> np.ndarray:
    """How many features [N, N] of one picture have their match in another. Symmetric, 0 on the diagonal."""
    count = len(descriptors)
    unit = np.zeros((count, LARGEST, 128), np.float32)  # rows of zeros where a picture has fewer: they match nothing
    for row, found in zip(unit, descriptors, strict=True):
        row[: len(found[:LARGEST])] = found[:LARGEST]
    unit /= np.maximum(np.linalg.norm(unit, axis=-1, keepdims=True), 1e-6)
    alike = np.zeros((count, count), np.int64)
    for i in range(count):
        for first in range(i + 1, count, TOGETHER):
            others = slice(first, min(first + TOGETHER, count))
            alike[i, others] = alike[others, i] = _matches(unit[i], unit[others])
    return alike


def _matches(a: np.ndarray, others: np.ndarray) -> np.ndarray:
    """For each of some pictures [M, F, 128] the features that are its and `a`'s nearest, and much nearer than the second: [M]."""
    cosine = np.einsum("fd,mgd->mfg", a, others, optimize=True)
    nearest, back = cosine.argmax(axis=2), cosine.argmax(axis=1)
    first = np.take_along_axis(cosine, nearest[..., None], axis=2)[..., 0]
    np.put_along_axis(cosine, nearest[..., None], -1.0, axis=2)
    clear = (2.0 - 2.0 * first) < RATIO**2 * (2.0 - 2.0 * cosine.max(axis=2))
    return (clear & (np.take_along_axis(back, nearest, axis=1) == np.arange(len(a)))).sum(axis=1)
