"""Which pictures are used: not twice the same, and none that is blurred. What is set aside is told by name.

Notation: a preview is a grey picture float32 [h, w] in [0, 1]; sharpness has no unit and says something only beside that of
pictures of the same things.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from training.scenes.pictures import area_average

BLURRED = 0.35  # of the median sharpness of the pictures to either side
AROUND = 7  # pictures to either side
MOST_BLURRED = 0.25  # of all pictures; where more seem so, they differ in what they show
SAME = 1.5 / 255  # root mean square difference of thumbnails below which two pictures show the same from the same place
THUMBNAIL = 32


def sharpness(preview: np.ndarray) -> float:
    """Variance of second differences at half the preview's scale, by that at a quarter: detail that a blur takes away, by detail
    that it leaves. Light, contrast and what is shown count little. The lesser of both directions, for a camera that moved.
    """
    half = _halved(preview)
    fine, coarse = _curvature(half), _curvature(_halved(half))
    return min(a / (b + 1e-7) for a, b in zip(fine, coarse, strict=True))


def _halved(picture: np.ndarray) -> np.ndarray:
    """Means of 2 × 2 pixels."""
    height, width = (side // 2 * 2 for side in picture.shape)
    rows = picture[:height:2, :width] + picture[1:height:2, :width]
    return (rows[:, ::2] + rows[:, 1::2]) / 4.0


def _curvature(picture: np.ndarray) -> tuple[float, float]:
    """Variance of second differences along rows, and along columns; 0 for pictures of a few pixels."""
    along = (np.diff(picture, 2, axis=axis) for axis in (1, 0))
    across, down = (float(values.var()) if values.size else 0.0 for values in along)
    return across, down


def thumbnail(preview: np.ndarray) -> np.ndarray:
    """The preview as float32 [THUMBNAIL, THUMBNAIL]."""
    small = [min(THUMBNAIL, side) for side in preview.shape]
    mean = area_average(area_average(preview, small[0], 0), small[1], 1)
    out = np.zeros((THUMBNAIL, THUMBNAIL), np.float32)
    out[: small[0], : small[1]] = mean
    return out


def same_view(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two thumbnails show the same from the same place."""
    return float(np.sqrt(np.mean((a - b) ** 2))) < SAME


def blurred(sharpnesses: Sequence[float]) -> list[bool]:
    """Which pictures, in the order they were taken, are far less sharp than those before and those after them."""
    values = np.asarray(sharpnesses, np.float64)
    found = []
    for i, value in enumerate(values):
        sides = [side for side in (values[max(i - AROUND, 0) : i], values[i + 1 : i + 1 + AROUND]) if len(side)]
        found.append(bool(sides) and value < BLURRED * min(float(np.median(side)) for side in sides))
    return found if sum(found) <= MOST_BLURRED * len(found) else [False] * len(found)


def repeated(digests: Sequence[str], thumbnails: Sequence[np.ndarray]) -> list[int | None]:
    """For each picture the number of an earlier one that it repeats, None where it repeats none."""
    first: dict[str, int] = {}
    out: list[int | None] = []
    for i, digest in enumerate(digests):
        kept = [j for j, repeats in enumerate(out) if repeats is None]
        alike = (j for j in kept if same_view(thumbnails[i], thumbnails[j]))
        out.append(first[digest] if digest in first else next(alike, None))
        first.setdefault(digest, i)
    return out
