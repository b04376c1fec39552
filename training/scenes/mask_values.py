"""What a mask shows of its photograph: whatever program wrote it, and however it stores black and white.

Notation: a mask's values are float32 [H, W], 0 where it hides and 1 where it shows. Nothing is inverted or guessed.
"""

from __future__ import annotations

import numpy as np

NEARLY = np.uint8(8)  # JPEG leaves neither black nor white as they were
LABELS = 1 / 8  # masks that stay below are 0 and 1, or numbers of objects
GREY = 16 / 255  # channels that differ by no more are grey


def mask_values(picture: np.ndarray, *, lossy: bool = False) -> np.ndarray:
    """The values of a mask that was decoded to uint8 or float32 [H, W, 3 or 4]. lossy: it was a JPEG, for instance.

    1. Alpha that is somewhere transparent is the mask; black hides as well if all else that is visible is white. Alpha that is
       transparent everywhere tells nothing of a mask that has colours.
    2. Of two colours, the darker one hides; of one, black does.
    3. Black hides and any other value shows, in masks of colours and in those that are nearly black everywhere (0 and 1).
    4. Any other mask is a soft one: its values count as they are.
    """
    colour = picture[..., :3]
    full = 255 if picture.dtype == np.uint8 else 1.0
    if picture.shape[-1] == 4 and 2 * float(picture[..., 3].min()) < float(picture[..., 3].max()):
        alpha = picture[..., 3]
        black, white = (colour == 0).all(axis=-1), (colour == full).all(axis=-1)
        shown = _values(alpha[..., None], full)
        is_drawn = (black | white | (alpha == 0)).all() and (white & (alpha > 0)).any()
        return np.where(black, np.float32(0), shown) if is_drawn else shown
    if picture.shape[-1] == 4 and not picture[..., 3].any() and (colour == colour[:1, :1]).all():
        return np.zeros(colour.shape[:2], np.float32)
    if lossy and picture.dtype == np.uint8:
        colour = np.where(colour < NEARLY, 0, np.where(colour > 255 - NEARLY, 255, colour))
    return _values(colour, full)


def _values(colour: np.ndarray, full: float) -> np.ndarray:
    """Rules 2 to 4, of [H, W, 1 or 3]."""
    level = colour.max(axis=-1)
    if not colour.size:
        return level.astype(np.float32)
    first = colour[0, 0]
    other = (colour != first).any(axis=-1)
    if not other.any():
        return np.full(level.shape, float(first.max() > 0), np.float32)
    second = colour[np.unravel_index(other.argmax(), other.shape)]
    if ((colour == second).all(axis=-1) | ~other).all():
        return (other if _luma(second) > _luma(first) else ~other).astype(np.float32)
    spread = level - colour.min(axis=-1)
    if level.max() < LABELS * full or spread.max() > GREY * full:
        return (level > 0).astype(np.float32)
    return level.astype(np.float32) / np.float32(full)


def _luma(colour: np.ndarray) -> float:
    return float(colour @ np.array([0.299, 0.587, 0.114])) if len(colour) == 3 else float(colour[0])
