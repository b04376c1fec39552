"""An island with a lighthouse, in a dish of sea: the bundled demo. Grass, cliffs, water, glass, thin rails and a sail.

Deterministic by seed. shapes: what there is, as a signed distance field; light: how it is lit and seen.
"""

import itertools

import numpy as np
from scipy.ndimage import uniform_filter

from tools.procedural.island.light import fill_picture
from tools.procedural.island.shapes import BOAT_AT, COTTAGE_AT, JETTY_AT, SPAN, TOWER_AT, WATER, Island, ground, rough
from training.scenes.scene import Camera

HEIGHTS = 1024  # of the height map, a side
Point = tuple[float, float]


def smooth(low: float, high: float, value: np.ndarray) -> np.ndarray:
    """0 below `low`, 1 above `high`, smooth between."""
    share = np.clip((value - low) / (high - low), 0, 1)
    return share * share * (3 - 2 * share)


def height_map() -> np.ndarray:
    """float32 [HEIGHTS, HEIGHTS] (y, x): a shelf under the water, a beach in the south-west, cliffs in the north-east."""
    at = np.linspace(-SPAN, SPAN, HEIGHTS)
    x, y = np.meshgrid(at, at)
    coarse = np.array([[rough(2.2 * b + 9, 2.2 * a, 0.5) for b in at[::8]] for a in at[::8]])
    fine = np.array([[rough(7 * b, 7 * a, 4.5) for b in at[::4]] for a in at[::4]])
    coarse = uniform_filter(np.kron(coarse, np.ones((8, 8))), 16, mode="nearest", origin=-1)
    fine = uniform_filter(np.kron(fine, np.ones((4, 4))), 8, mode="nearest", origin=-1)
    away = np.hypot((x - 0.06) / 1.02, (y - 0.08) / 0.98) + 0.34 * (coarse - 0.5)
    north_east = smooth(-0.45, 0.55, (x + 0.9 * y) / 1.35 + 0.5 * (coarse - 0.5))
    shelf = WATER - 0.17 + 0.17 * smooth(1.05, 0.62, away)
    beach = 0.17 * smooth(0.74, 0.30, away)
    cliff = 0.25 * smooth(0.76, 0.57, away + 0.12 * (fine - 0.5)) + 0.10 * smooth(0.5, 0.1, away)
    heights = shelf + beach * (1 - north_east) + (cliff + 0.03) * north_east + 0.022 * (fine - 0.5)
    for (cx, cy), radius in ((TOWER_AT, 0.17), (COTTAGE_AT, 0.23)):  # level ground under what is built
        level = heights[int((cy + SPAN) / (2 * SPAN) * (HEIGHTS - 1)), int((cx + SPAN) / (2 * SPAN) * (HEIGHTS - 1))]
        heights += (level - heights) * smooth(1.35 * radius, radius * 0.85, np.hypot(x - cx, y - cy))
    return heights.astype(np.float32)


def make_island(seed: int) -> Island:
    """Everything in its place. seed: of plants, rocks and the fence."""
    heights = height_map()
    rng = np.random.default_rng(seed)

    def on_ground(x: float, y: float) -> float:
        return float(ground(heights, x, y))

    def scattered() -> list[Point]:
        """Level places for plants, away from what is built, from the path and from one another."""
        found: list[Point] = []
        for _ in range(6000):
            x, y = rng.uniform(-0.7, 0.7, 2)
            clear = (
                np.hypot(x - TOWER_AT[0], y - TOWER_AT[1]) > 0.25
                and np.hypot(x - COTTAGE_AT[0], y - COTTAGE_AT[1]) > 0.28
            )
            level = abs(on_ground(x + 0.03, y) - on_ground(x - 0.03, y)) + abs(
                on_ground(x, y + 0.03) - on_ground(x, y - 0.03)
            )
            clear = clear and level < 0.035 and on_ground(x, y) > WATER + 0.085
            clear = clear and all(np.hypot(x - a, y - b) > 0.09 for a, b in path)
            if clear and all(np.hypot(x - a, y - b) > 0.115 for a, b in found):
                found.append((x, y))
            if len(found) == 19:
                break
        return found

    path = _path()
    places = scattered()
    pines = [(x, y, on_ground(x, y) - 0.01, rng.uniform(0.17, 0.30), rng.uniform(0.05, 0.072)) for x, y in places[:12]]
    trees = [(x, y, on_ground(x, y) - 0.01, rng.uniform(0.10, 0.15), rng.uniform(0.055, 0.075)) for x, y in places[12:]]
    rocks = []
    while len(rocks) < 16:
        angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(0.55, 0.98)
        x, y = far * np.cos(angle), far * np.sin(angle)
        away = min(np.hypot(x - BOAT_AT[0], y - BOAT_AT[1]), np.hypot(x - JETTY_AT[0] + 0.16, y - JETTY_AT[1] + 0.06))
        if abs(on_ground(x, y) - WATER) < 0.07 and away > 0.30:
            rocks.append((x, y, on_ground(x, y) + 0.01, rng.uniform(0.03, 0.085)))
    bearings = np.radians(np.arange(-62, 118, 12.0))
    posts = [
        (x, y, on_ground(x, y))
        for x, y in (TOWER_AT + 0.185 * np.stack([np.cos(bearings), np.sin(bearings)], -1)).tolist()
        if on_ground(x, y) > WATER + 0.12
    ]
    stones = [(x, y, on_ground(x, y), rng.uniform(0.014, 0.021)) for x, y in path]
    rows = (np.array(row, np.float32).reshape(len(row), -1) for row in (pines, trees, rocks, posts, stones))
    return Island(heights, *rows)


def _path() -> list[Point]:
    """Stepping stones from the jetty past the cottage's door to the tower's."""
    corners = np.array([JETTY_AT, (-0.36, -0.16), (-0.10, 0.12), (0.14, 0.10), (0.39, 0.13)])
    return [
        tuple(float(v) for v in a + (b - a) * s)  # type: ignore[misc]
        for a, b in itertools.pairwise(corners)
        for s in np.arange(0, 1, 0.045 / np.linalg.norm(b - a))
    ]


def island_picture(island: Island, camera: Camera, subpixels: int) -> np.ndarray:
    """Renders uint8 [H, W, 4] with a transparent background and RGB not premultiplied."""
    feet = np.array([ground(island.heights, *TOWER_AT), ground(island.heights, *COTTAGE_AT)], np.float64)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)
    mean = np.zeros((camera.height, camera.width, 4))
    fill_picture(island, feet, np.ascontiguousarray(camera.world_T_camera, np.float64), lens, subpixels, mean)
    straight = mean[..., :3] / np.maximum(mean[..., 3:], 1e-6)
    return np.rint(np.concatenate([straight, mean[..., 3:]], -1) * 255).astype(np.uint8)
