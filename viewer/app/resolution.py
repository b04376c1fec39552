"""How many pixels to draw: few enough while the camera moves to hold a frame rate, all of them once it rests.

Notation: scale, the side of the drawn picture over that of its place in the window; its cost is taken to grow with
scale². At rest the full picture is drawn tile by tile, some each frame, so that the window answers on slow cards too.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import ceil, sqrt

SMALLEST_SCALE = 0.12
STEP = 1.25  # the most that scale changes in one frame
FIRST_TILE = 96  # pixels a side, until speed is known


@dataclass
class Governor:
    """Keeps the time of a frame near a target by choosing the scale.

    target_fps: frames per second wanted while the camera moves. rest_scale: scale once it rests. enabled: whether
    scale may drop at all.
    """

    target_fps: float = 30.0
    rest_scale: float = 1.0
    enabled: bool = True
    scale: float = 0.5
    pixels_per_ms: float = 0.0  # how fast the card was lately; 0 = not known yet

    @property
    def target_ms(self) -> float:
        return 1000.0 / self.target_fps

    @property
    def moving_scale(self) -> float:
        """Scale for a frame while the camera moves."""
        return min(self.scale, self.rest_scale) if self.enabled else self.rest_scale

    def measured(self, milliseconds: float, pixels: int) -> None:
        """A picture of `pixels` took so long; the next scale follows from it."""
        milliseconds = max(milliseconds, 1e-3)
        speed = pixels / milliseconds
        self.pixels_per_ms = speed if self.pixels_per_ms == 0 else 0.6 * self.pixels_per_ms + 0.4 * speed

    def moved(self, milliseconds: float, pixels: int) -> None:
        """As measured(), for a frame drawn at moving_scale."""
        self.measured(milliseconds, pixels)
        # Part of the target belongs to the panels and to swapping buffers.
        factor = sqrt(0.8 * self.target_ms / max(milliseconds, 1e-3))
        factor = min(max(factor, 1.0 / STEP), STEP)
        self.scale = min(max(self.scale * factor, SMALLEST_SCALE), 1.0)

    def tile_side(self) -> int:
        """Pixels a side of a tile that takes about half of a frame's time."""
        if self.pixels_per_ms <= 0:
            return FIRST_TILE
        return int(min(max(sqrt(0.5 * self.target_ms * self.pixels_per_ms), 48), 4096))


def tiles(width: int, height: int, side: int) -> list[tuple[int, int, int, int]]:
    """Rectangles x, y, w, h that cover width × height exactly, from the middle outwards, each about `side` a side."""
    columns, rows = max(1, ceil(width / side)), max(1, ceil(height / side))
    xs = [round(width * i / columns) for i in range(columns + 1)]
    ys = [round(height * i / rows) for i in range(rows + 1)]
    boxes = [(x0, y0, x1 - x0, y1 - y0) for y0, y1 in pairwise(ys) for x0, x1 in pairwise(xs)]
    return sorted(boxes, key=lambda b: (b[0] + b[2] / 2 - width / 2) ** 2 + (b[1] + b[3] / 2 - height / 2) ** 2)
