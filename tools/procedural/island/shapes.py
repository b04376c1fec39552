"""The island as a signed distance field: how far a point is from it, and what it is made of there.

Notation: a point is (x, y, z), z up, the water's surface at z = WATER. Distances are lower bounds, as sphere tracing needs
(Hart, "Sphere tracing", 1996): a shape that is bent or cut returns a little less than its distance. Everything is scalar and
compiled by numba; `Island` holds the arrays that say where things stand (island/__init__.py fills them).
"""

# pyright: reportCallIssue=false

from math import atan2, cos, floor, hypot, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

WATER = -0.30  # z of the sea
BASE_RADIUS, BASE_BOTTOM = 1.26, -0.47
SPAN = 1.4  # the height map covers [-SPAN, SPAN]²

NOTHING, SEA, RIM, GROUND, TOWER, IRON, GLASS, RED, WALL, TILES, WOOD, PINE, LEAVES, TRUNK, SAIL, HULL, STONE, LAMP = (
    range(18)
)

TOWER_AT = (0.40, 0.28)
COTTAGE_AT = (-0.12, 0.40)
BOAT_AT = (-0.78, -0.52)
JETTY_AT = (-0.38, -0.47)  # its landward end
JETTY_LENGTH = 0.34


class Island(NamedTuple):
    """heights float32 [N, N] (y, x), z of the ground over [-SPAN, SPAN]². The others float32 rows, z of the ground included:

    pines (x, y, z, height, radius), trees (x, y, z, height, radius), rocks (x, y, z, radius), posts (x, y, z) of the fence,
    in order; stones (x, y, z, radius) of the path.
    """

    heights: np.ndarray
    pines: np.ndarray
    trees: np.ndarray
    rocks: np.ndarray
    posts: np.ndarray
    stones: np.ndarray


@njit(nogil=True, cache=True, inline="always")
def hashed(i: int, j: int, k: int) -> float:
    """A number in [0, 1) for each triple of integers."""
    n = (i * 374761393 + j * 668265263 + k * 2147483647) & 0xFFFFFFFF
    n = ((n ^ (n >> 13)) * 1274126177) & 0xFFFFFFFF
    return ((n ^ (n >> 16)) & 0xFFFFFF) / 16777216.0


@njit(nogil=True, cache=True)
def noise(x: float, y: float, z: float) -> float:
    """Smooth value noise in [0, 1], about one feature a unit."""
    i, j, k = floor(x), floor(y), floor(z)
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    total = 0.0
    for c in range(8):
        a, b, d = c & 1, (c >> 1) & 1, c >> 2
        weight = (u if a else 1 - u) * (v if b else 1 - v) * (w if d else 1 - w)
        total += weight * hashed(int(i) + a, int(j) + b, int(k) + d)
    return total


@njit(nogil=True, cache=True)
def rough(x: float, y: float, z: float) -> float:
    """Four octaves of noise, about 0 ... 1."""
    return (noise(x, y, z) + 0.5 * noise(2.1 * x, 2.1 * y, 2.1 * z + 7) + 0.25 * noise(4.3 * x, 4.3 * y, 4.3 * z + 3)
            + 0.12 * noise(8.9 * x, 8.9 * y, 8.9 * z + 1)) / 1.87  # fmt: skip


@njit(nogil=True, cache=True)
def ground(heights: np.ndarray, x: float, y: float) -> float:
    """z of the ground, linear between the height map's points; far below beyond it."""
    n = heights.shape[0]
    u, v = (x + SPAN) / (2 * SPAN) * (n - 1), (y + SPAN) / (2 * SPAN) * (n - 1)
    i, j = floor(u), floor(v)
    if i < 0 or j < 0 or i >= n - 1 or j >= n - 1:
        return -1.0
    a, b = u - i, v - j
    low = heights[j, i] * (1 - a) + heights[j, i + 1] * a
    high = heights[j + 1, i] * (1 - a) + heights[j + 1, i + 1] * a
    return low * (1 - b) + high * b


@njit(nogil=True, cache=True, inline="always")
def box(x: float, y: float, z: float, a: float, b: float, c: float) -> float:
    """Distance to a box of half sides a, b, c around the origin."""
    dx, dy, dz = abs(x) - a, abs(y) - b, abs(z) - c
    outside = sqrt(max(dx, 0.0) ** 2 + max(dy, 0.0) ** 2 + max(dz, 0.0) ** 2)
    return outside + min(max(dx, max(dy, dz)), 0.0)


@njit(nogil=True, cache=True, inline="always")
def tube(q: float, z: float, radius: float, half: float) -> float:
    """Distance to a cylinder around z, q from the axis."""
    dq, dz = q - radius, abs(z) - half
    return sqrt(max(dq, 0.0) ** 2 + max(dz, 0.0) ** 2) + min(max(dq, dz), 0.0)


@njit(nogil=True, cache=True, inline="always")
def cone(q: float, z: float, radius: float, height: float) -> float:
    """Distance to a cone that stands on z = 0."""
    return max((q * height + (z - height) * radius) / sqrt(height * height + radius * radius), -z)


@njit(nogil=True, cache=True, inline="always")
def within_sector(x: float, y: float, count: int) -> float:
    """The angle from the middle of the nearest of `count` sectors around z: what stands there stands in each."""
    turn = 2 * pi / count
    angle = atan2(y, x)
    return angle - turn * floor(angle / turn + 0.5)


@njit(nogil=True, cache=True)
def closer(d: float, what: int, best: float, of: int) -> tuple[float, int]:
    """The nearer of two things: its distance, and what it is."""
    return (d, what) if d < best else (best, of)


@njit(nogil=True, cache=True)
def rod(px: float, py: float, pz: float, a: np.ndarray, b: np.ndarray, lift: float, radius: float) -> float:
    """Distance to the segment between two points [3], `lift` above them."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = px - a[0], py - a[1], pz - a[2] - lift
    t = min(max((wx * ux + wy * uy + wz * uz) / (ux * ux + uy * uy + uz * uz), 0.0), 1.0)
    return sqrt((wx - t * ux) ** 2 + (wy - t * uy) ** 2 + (wz - t * uz) ** 2) - radius


@njit(nogil=True, cache=True)
def lighthouse(x: float, y: float, z: float, best: float, of: int) -> tuple[float, int]:
    """The tower, its foot at z = 0: walls, gallery with a railing, lantern, roof."""
    q = hypot(x, y)
    around = max(q - 0.16, max(z - 0.96, -z - 0.1))
    if around > best:
        return best, of
    d = max(0.98 * (q - (0.118 - 0.065 * z)), max(z - 0.62, -z - 0.1))
    best, of = closer(d, TOWER, best, of)
    d = min(tube(q, z - 0.03, 0.132, 0.03), tube(q, z - 0.628, 0.112, 0.014))
    d = min(d, tube(q, z - 0.60, 0.096, 0.02))
    best, of = closer(d, STONE, best, of)
    angle = within_sector(x, y, 12)
    d = tube(hypot(q * cos(angle) - 0.102, q * sin(angle)), z - 0.67, 0.0042, 0.035)
    d = min(d, min(hypot(q - 0.102, z - 0.704), hypot(q - 0.102, z - 0.676)) - 0.0045)
    angle = within_sector(x, y, 6)
    d = min(d, tube(hypot(q * cos(angle) - 0.058, q * sin(angle)), z - 0.70, 0.006, 0.06))
    best, of = closer(d, IRON, best, of)
    d = tube(q, z - 0.70, 0.055, 0.058)
    best, of = closer(d, GLASS, best, of)
    d = min(cone(q, z - 0.755, 0.082, 0.085), tube(q, z - 0.757, 0.082, 0.006))
    d = min(d, sqrt(q * q + (z - 0.853) ** 2) - 0.016)
    d = min(d, tube(q, z - 0.89, 0.004, 0.03))
    best, of = closer(d, RED, best, of)
    # A door, and windows that climb around the tower.
    d = box(x, y + 0.116, z - 0.10, 0.026, 0.012, 0.045)
    best, of = closer(d, WOOD, best, of)
    for i in range(3):
        bend = -1.2 + 1.9 * i
        height = 0.20 + 0.14 * i
        at = 0.118 - 0.065 * height
        wx, wy = x * cos(bend) + y * sin(bend), -x * sin(bend) + y * cos(bend)
        d = box(wx - at, wy, z - height, 0.006, 0.014, 0.022)
        best, of = closer(d, GLASS, best, of)
    return best, of


@njit(nogil=True, cache=True)
def cottage(x: float, y: float, z: float, best: float, of: int) -> tuple[float, int]:
    """The keeper's house, its floor at z = 0: walls under a gable along x, chimney, door and windows, a porch."""
    turned = 0.5
    x, y = x * cos(turned) + y * sin(turned), -x * sin(turned) + y * cos(turned)
    if box(x, y, z - 0.1, 0.22, 0.2, 0.2) > best:
        return best, of
    half, deep, high, rise = 0.155, 0.10, 0.115, 0.095
    slope = rise / deep
    lean = sqrt(1 + slope * slope)
    gable = (abs(y) * slope + z - high - rise) / lean
    d = max(max(box(x, y, z - 0.05, half, deep, 0.30), gable), -z - 0.06)
    best, of = closer(d, WALL, best, of)
    shell = abs((abs(y) * slope + z - high - rise - 0.012) / lean) - 0.009
    d = max(max(shell, abs(x) - half - 0.022), max(abs(y) - deep - 0.026, high - 0.035 - z))
    best, of = closer(d, TILES, best, of)
    d = box(x - 0.085, y + 0.02, z - 0.22, 0.018, 0.018, 0.05)
    d = min(d, box(x - 0.085, y + 0.02, z - 0.268, 0.024, 0.024, 0.006))
    d = min(d, box(x, y, z - 0.0, half + 0.012, deep + 0.012, 0.014))
    best, of = closer(d, STONE, best, of)
    d = box(x + 0.01, y + deep, z - 0.05, 0.024, 0.006, 0.042)
    best, of = closer(d, WOOD, best, of)
    d = 1.0
    for side in (-1.0, 1.0):
        for across in (-0.095, 0.095):
            d = min(d, box(x - across, y - side * deep, z - 0.068, 0.022, 0.005, 0.024))
        d = min(d, box(x - side * half, y, z - 0.085, 0.005, 0.02, 0.024))
    best, of = closer(d, GLASS, best, of)
    return best, of


@njit(nogil=True, cache=True)
def boat(x: float, y: float, z: float, best: float, of: int) -> tuple[float, int]:
    """A small sailing boat that floats at z = 0."""
    turned = 0.9
    x, y = x * cos(turned) + y * sin(turned), -x * sin(turned) + y * cos(turned)
    if box(x, y, z - 0.19, 0.17, 0.07, 0.25) > best:
        return best, of
    outer = (sqrt((x / 0.145) ** 2 + (y / 0.052) ** 2 + ((z - 0.035) / 0.055) ** 2) - 1) * 0.05
    inner = (sqrt((x / 0.13) ** 2 + (y / 0.042) ** 2 + ((z - 0.04) / 0.045) ** 2) - 1) * 0.04
    d = 0.8 * max(max(outer, z - 0.035), -inner)
    best, of = closer(d, HULL, best, of)
    d = tube(hypot(x - 0.015, y), z - 0.20, 0.0055, 0.20)
    d = min(d, box(x + 0.05, y, z - 0.075, 0.07, 0.005, 0.005))
    d = min(d, box(x + 0.03, y, z - 0.028, 0.012, 0.045, 0.006))
    best, of = closer(d, WOOD, best, of)
    # Two sails, bellied by the wind: a triangle behind the mast, a smaller one before it.
    belly = 0.018 * sin(pi * min(max((z - 0.08) / 0.3, 0.0), 1.0))
    d = max(abs(y - belly) - 0.0055, max(x - 0.005, 0.085 - z))
    d = max(d, (-(x - 0.005) * 0.29 + (z - 0.375) * 0.115) / 0.312)
    jib = max(abs(y - 0.6 * belly) - 0.0055, max(0.028 - x, 0.075 - z))
    jib = max(jib, ((x - 0.028) * 0.24 + (z - 0.315) * 0.1) / 0.26)
    d = 0.9 * min(d, jib)
    best, of = closer(d, SAIL, best, of)
    return best, of


@njit(nogil=True, cache=True)
def jetty(x: float, y: float, z: float, best: float, of: int) -> tuple[float, int]:
    """A jetty over the water: it begins at JETTY_AT and goes along (-cos, -sin) of its bearing."""
    bearing = 0.35
    u = -(x - JETTY_AT[0]) * cos(bearing) - (y - JETTY_AT[1]) * sin(bearing)
    v = (x - JETTY_AT[0]) * sin(bearing) - (y - JETTY_AT[1]) * cos(bearing)
    top = z - WATER - 0.055
    if box(u - 0.5 * JETTY_LENGTH, v, top, 0.5 * JETTY_LENGTH + 0.06, 0.09, 0.16) > best:
        return best, of
    plank = abs(u / 0.034 - floor(u / 0.034) - 0.5) * 0.034  # from the middle of a plank
    d = max(box(u - 0.5 * JETTY_LENGTH, v, top, 0.5 * JETTY_LENGTH, 0.05, 0.008), 0.7 * (plank - 0.0145))
    d = min(d, box(u - 0.5 * JETTY_LENGTH, abs(v) - 0.036, top + 0.012, 0.5 * JETTY_LENGTH, 0.006, 0.008))
    near = min(max(floor(u / 0.11 + 0.5), 0.0), 3.0) * 0.11 + 0.006
    d = min(d, tube(hypot(u - near, abs(v) - 0.05), top + 0.03, 0.011, 0.085))
    best, of = closer(d, WOOD, best, of)
    return best, of


@njit(nogil=True, cache=True)
def plants(island: Island, x: float, y: float, z: float, best: float, of: int) -> tuple[float, int]:
    """Pines, round trees, rocks, the fence and the stones of the path."""
    for i in range(island.pines.shape[0]):
        px, py, pz, high, wide = island.pines[i]
        q, up = hypot(x - px, y - py), z - pz
        if max(q - wide, max(up - high, -up)) > best:
            continue
        d = tube(q, up - 0.1 * high, 0.09 * wide, 0.12 * high)
        best, of = closer(d, TRUNK, best, of)
        ragged = 1 + 0.10 * sin(9 * atan2(y - py, x - px) + 40 * up + i)
        for k in range(3):
            foot = (0.16 + 0.24 * k) * high
            d = 0.75 * cone(q, up - foot, wide * (1 - 0.26 * k) * ragged, (0.46 - 0.04 * k) * high)
            best, of = closer(d, PINE, best, of)
    for i in range(island.trees.shape[0]):
        px, py, pz, high, wide = island.trees[i]
        q, up = hypot(x - px, y - py), z - pz
        if max(q - 1.5 * wide, max(up - high - wide, -up)) > best:
            continue
        d = tube(q, up - 0.3 * high, 0.13 * wide, 0.34 * high)
        best, of = closer(d, TRUNK, best, of)
        for k in range(5):
            a = 2.4 * k + i
            cx, cy, cz = px + 0.5 * wide * cos(a), py + 0.5 * wide * sin(a), pz + high * (0.78 + 0.07 * (k % 3))
            d = sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2) - 0.66 * wide
            if d < best + 0.02:
                d = 0.7 * (d - 0.035 * (rough(26 * x, 26 * y, 26 * z) - 0.5))
            best, of = closer(d, LEAVES, best, of)
    for i in range(island.rocks.shape[0]):
        px, py, pz, radius = island.rocks[i]
        d = sqrt((x - px) ** 2 + (y - py) ** 2 + 2.2 * (z - pz) ** 2) - radius
        if d < best + 0.03:
            d = 0.62 * (d - 0.45 * radius * (rough(9 * x + i, 9 * y, 9 * z) - 0.5))
        best, of = closer(d, STONE, best, of)
    for i in range(island.stones.shape[0]):
        px, py, pz, radius = island.stones[i]
        d = tube(hypot(x - px, y - py), z - pz, radius, 0.009)
        best, of = closer(d, STONE, best, of)
    for i in range(island.posts.shape[0]):
        post = island.posts[i]
        if hypot(x - post[0], y - post[1]) - 0.14 > best:
            continue
        d = tube(hypot(x - post[0], y - post[1]), z - post[2] - 0.03, 0.0085, 0.05)
        if i and hypot(post[0] - island.posts[i - 1, 0], post[1] - island.posts[i - 1, 1]) < 0.16:
            d = min(d, rod(x, y, z, island.posts[i - 1], post, 0.03, 0.005))
            d = min(d, rod(x, y, z, island.posts[i - 1], post, 0.06, 0.005))
        best, of = closer(d, WOOD, best, of)
    return best, of


@njit(nogil=True, cache=True)
def nearest(island: Island, heights_at: np.ndarray, x: float, y: float, z: float) -> tuple[float, int]:
    """A lower bound of the distance to the island, and what is nearest.

    heights_at: z of the ground at the foot of tower and cottage.
    """
    q = hypot(x, y)
    best, of = max(z - WATER, max(q - BASE_RADIUS + 0.06, BASE_BOTTOM - z)), SEA
    d = tube(q, z - 0.5 * (BASE_BOTTOM + WATER) - 0.008, BASE_RADIUS, 0.5 * (WATER - BASE_BOTTOM) + 0.02)
    d = max(d, BASE_RADIUS - 0.06 - q)
    best, of = closer(d, RIM, best, of)
    if q < 1.15:
        d = max(0.45 * (z - ground(island.heights, x, y)), BASE_BOTTOM + 0.02 - z)
        best, of = closer(d, GROUND, best, of)
    best, of = lighthouse(x - TOWER_AT[0], y - TOWER_AT[1], z - heights_at[0], best, of)
    best, of = cottage(x - COTTAGE_AT[0], y - COTTAGE_AT[1], z - heights_at[1], best, of)
    best, of = boat(x - BOAT_AT[0], y - BOAT_AT[1], z - WATER, best, of)
    best, of = jetty(x, y, z, best, of)
    return plants(island, x, y, z, best, of)
