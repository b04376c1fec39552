"""How many pixels to draw: few enough while the camera moves to hold a frame rate, all of them once it rests.

Notation: scale, the side of the drawn picture over that of its place in the window. All times are in milliseconds.
A frame takes panels + swap + picture, and scale changes the picture alone, which gets

    max(target - rest, rest / 2),    rest = panels + swap.

The first term holds the target. The second takes over where the rest leaves less than that: the rate is then lost
anyway, and a still smaller picture would hardly bring any of it back.

A swap that is long may be waiting for the screen (v-sync) and cost nothing: then a larger picture fits into the same
frame. So only as much of it counts as makes frames late: this share grows while they are, and shrinks while they are not.

At rest the full picture is drawn tile by tile, some each frame, so that the window answers on slow GPUs too.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import ceil, exp, log, sqrt

SMALLEST_SCALE = 0.12
STEP = 1.25  # the most that scale changes in one frame
STEADY = 0.04  # changes of scale by less than this share are not made, so that the sharpness does not flicker
HEADROOM = 0.9  # of the target is planned for: pictures differ
LATE = 1.02  # times the target: a frame that takes longer is late; screens of 59.94 Hz hold 60
SWAP_GAIN = 0.1  # how fast the counted share of the swap follows
NOISE = 0.08  # pictures that take so much more or less than expected (logarithm) tell of a change, others waver
WAVERING, CHANGING = 0.3, 0.85  # how much of the difference is believed in either case
FIRST_TILE = 96  # pixels a side, until speed is known


@dataclass
class DynamicResolution:
    """Keeps the time of a whole frame near a target by choosing the scale."""

    target_fps: float = 30.0  # frames per second wanted while the camera moves
    rest_scale: float = 1.0  # scale once it rests
    enabled: bool = True  # whether scale may drop at all
    scale: float = 0.5  # of the next picture while the camera moves
    pixels_per_ms: float = 0.0  # how fast pictures were drawn lately; 0 = not known yet
    _panels_ms: float | None = None
    _swap_ms: float = 0.0
    _counted_swap_ms: float = 0.0
    _ms_per_pixel: float | None = None  # of pictures while the camera moves
    _picture_ms: float = 0.0  # of the pictures of this frame that were drawn because the camera moved
    _pixels: int = 0

    @property
    def target_ms(self) -> float:
        return 1000.0 / self.target_fps

    @property
    def moving_scale(self) -> float:
        return min(self.scale, self.rest_scale) if self.enabled else self.rest_scale

    def measured(self, milliseconds: float, pixels: int) -> None:
        """`pixels` took so long to draw."""
        speed = pixels / max(milliseconds, 1e-3)
        self.pixels_per_ms = speed if self.pixels_per_ms == 0 else 0.6 * self.pixels_per_ms + 0.4 * speed

    def moved(self, milliseconds: float, pixels: int) -> None:
        """As measured(), for one of this frame's pictures at moving_scale; a comparison of two packs has two."""
        self.measured(milliseconds, pixels)
        self._picture_ms += max(milliseconds, 1e-3)
        self._pixels += pixels

    def frame_ended(self, frame_ms: float, swap_ms: float = 0.0) -> None:
        """The frame is on the screen; the next scale follows if the camera moved in it.

        frame_ms: all of it, from its first event to the end of swapping buffers. swap_ms: of that, swapping alone.
        """
        picture_ms, pixels = self._picture_ms, self._pixels
        self._picture_ms, self._pixels = 0.0, 0
        if not pixels:
            return
        panels = max(frame_ms - swap_ms - picture_ms, 0.0)
        self._panels_ms = panels if self._panels_ms is None else 0.7 * self._panels_ms + 0.3 * panels
        self._swap_ms = 0.7 * self._swap_ms + 0.3 * swap_ms
        late = frame_ms - LATE * self.target_ms
        self._counted_swap_ms = min(max(self._counted_swap_ms + SWAP_GAIN * late, 0.0), self._swap_ms)
        before, now = self._ms_per_pixel, picture_ms / pixels
        if before is not None:  # a camera that comes near a surface may double the cost within some frames
            surprise = log(now / before)
            now = before * exp((CHANGING if abs(surprise) > NOISE else WAVERING) * surprise)
        self._ms_per_pixel = now
        rest = self._panels_ms + self._counted_swap_ms
        factor = sqrt(max(HEADROOM * self.target_ms - rest, 0.5 * rest) / (now * pixels))
        if abs(factor - 1.0) > STEADY:
            factor = min(max(factor, 1.0 / STEP), STEP)
            self.scale = min(max(self.moving_scale * factor, SMALLEST_SCALE), 1.0)

    def tile_side(self) -> int:
        """Pixels a side of a tile that takes about half of a frame's time, or half of what the rest of a frame takes."""
        if self.pixels_per_ms <= 0:
            return FIRST_TILE
        milliseconds = 0.5 * max(self.target_ms, (self._panels_ms or 0.0) + self._counted_swap_ms)
        return int(min(max(sqrt(milliseconds * self.pixels_per_ms), 48), 4096))


def tiles(width: int, height: int, side: int) -> list[tuple[int, int, int, int]]:
    """Rectangles x, y, w, h that cover width × height exactly, from the middle outwards, each about `side` a side."""
    columns, rows = max(1, ceil(width / side)), max(1, ceil(height / side))
    xs = [round(width * i / columns) for i in range(columns + 1)]
    ys = [round(height * i / rows) for i in range(rows + 1)]
    boxes = [(x0, y0, x1 - x0, y1 - y0) for y0, y1 in pairwise(ys) for x0, x1 in pairwise(xs)]
    return sorted(boxes, key=lambda b: (b[0] + b[2] / 2 - width / 2) ** 2 + (b[1] + b[3] / 2 - height / 2) ** 2)
