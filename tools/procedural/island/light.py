"""From a ray to a colour: sphere tracing, sun with soft shadows, open sky, and gloss where there is water, glass or paint.

Notation: as in shapes.py; n the unit normal, v the unit direction from the surface to the eye. Colours are linear until
`shown`. Only the sky and the sun are mirrored, not the island: a mirrored island is a second one below the water, which
no field of this paper can tell from a real one.
"""

# pyright: reportCallIssue=false

from math import atan2, exp, floor, hypot, sqrt

import numpy as np
from numba import njit

from tools.procedural.island import shapes

SUN = (0.5213, -0.4561, 0.7212)  # unit direction to the sun
SUN_COLOUR = (2.05, 1.78, 1.38)
SUN_WIDTH = 0.06  # the softness of shadows
STEPS, CLOSE = 160, 4e-4
REACH = 1.44  # radius of a ball around (0, 0, 0.15) that holds everything
SKY, GLOW, BELOW = (0.36, 0.52, 0.80), (0.95, 0.84, 0.72), (0.20, 0.19, 0.16)


@njit(nogil=True, cache=True)
def march(island: shapes.Island, feet: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[float, int]:
    """Distance along the ray to what it hits, and what that is; NOTHING where it misses."""
    b = o[0] * d[0] + o[1] * d[1] + (o[2] - 0.15) * d[2]
    c = o[0] * o[0] + o[1] * o[1] + (o[2] - 0.15) ** 2 - REACH * REACH
    h = b * b - c
    if h <= 0:
        return 0.0, shapes.NOTHING
    root = sqrt(h)
    t, end = max(-b - root, 0.0), -b + root
    for _ in range(STEPS):
        step, of = shapes.nearest(island, feet, o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
        if step < CLOSE:
            return t, of
        t += step
        if t > end:
            break
    return t, shapes.NOTHING


@njit(nogil=True, cache=True)
def sunlight(island: shapes.Island, feet: np.ndarray, x: float, y: float, z: float) -> float:
    """Share of the sun that reaches a point: penumbrae from the closest approach on the way."""
    share, t = 1.0, 0.012
    for _ in range(48):
        step, _of = shapes.nearest(island, feet, x + t * SUN[0], y + t * SUN[1], z + t * SUN[2])
        share = min(share, 0.5 + 0.5 * step / (SUN_WIDTH * t))
        if share < 0.02:
            return 0.0
        t += min(max(step, 0.006), 0.12)
        if z + t * SUN[2] > 1.2 or t > 2.0:
            break
    return share * share * (3 - 2 * share)


@njit(nogil=True, cache=True)
def open_sky(island: shapes.Island, feet: np.ndarray, p: np.ndarray, n: np.ndarray) -> float:
    """How open the surroundings are, 0 ... 1, from five distances along the normal."""
    hidden, weight = 0.0, 1.0
    for i in range(5):
        far = 0.012 + 0.034 * i
        step, _of = shapes.nearest(island, feet, p[0] + far * n[0], p[1] + far * n[1], p[2] + far * n[2])
        hidden += weight * max(far - step, 0.0) / far
        weight *= 0.72
    return max(1.0 - 0.42 * hidden, 0.0)


@njit(nogil=True, cache=True)
def sky(r: np.ndarray, sharpness: float, out: np.ndarray) -> None:
    """The sky along a unit direction, with the sun as a lobe and a few soft clouds."""
    up = max(r[2], 0.0)
    high = sqrt(up)
    cloud = 0.35 * max(shapes.noise(2.2 * r[0] + 5, 2.2 * r[1], 2.0 * r[2]) - 0.45, 0.0)
    lobe = exp(sharpness * (r[0] * SUN[0] + r[1] * SUN[1] + r[2] * SUN[2] - 1))
    for c in range(3):
        above = GLOW[c] + (SKY[c] - GLOW[c]) * high
        out[c] = (above if r[2] > 0 else BELOW[c]) + cloud + 5.0 * lobe * SUN_COLOUR[c] / 2


@njit(nogil=True, cache=True)
def mixed(out: np.ndarray, red: float, green: float, blue: float, share: float) -> None:
    """out towards a colour."""
    share = min(max(share, 0.0), 1.0)
    out[0] += (red - out[0]) * share
    out[1] += (green - out[1]) * share
    out[2] += (blue - out[2]) * share


@njit(nogil=True, cache=True)
def land(p: np.ndarray, n: np.ndarray, out: np.ndarray) -> None:
    """Sand at the water, grass where it is flat, layered rock where it is steep."""
    x, y, z = p[0], p[1], p[2]
    spots = shapes.rough(14 * x, 14 * y, 14 * z)
    layer = shapes.noise(3 * x, 3 * y, 42 * z + 2 * shapes.rough(4 * x, 4 * y, 4 * z))
    out[0], out[1], out[2] = 0.34, 0.29, 0.25
    mixed(out, 0.52, 0.43, 0.34, 1.6 * (layer - 0.4))
    mixed(out, 0.20, 0.18, 0.17, 1.8 * (spots - 0.62))
    flat = (n[2] - 0.62) * 6
    blade = shapes.noise(90 * x, 90 * y, 30 * z)
    meadow = shapes.rough(5 * x + 3, 5 * y, 0.0)
    mixed(out, 0.16 + 0.22 * (meadow - 0.4), 0.33 + 0.10 * (blade - 0.5), 0.075, flat)
    i, j = floor(58 * x), floor(58 * y)
    if flat > 0.9 and shapes.hashed(i, j, 5) > 0.955 and meadow > 0.42:  # flowers
        kind = shapes.hashed(i, j, 6)
        u, v = 58 * x - i - 0.5 + 0.3 * (kind - 0.5), 58 * y - j - 0.5
        if u * u + v * v < 0.11:
            mixed(out, 0.92, 0.80 if kind > 0.4 else 0.25, 0.22 if kind > 0.7 else 0.50, 0.9)
    sand = 1 - (z - shapes.WATER - 0.035 - 0.03 * (spots - 0.5)) * 40
    mixed(out, 0.72 + 0.08 * (spots - 0.5), 0.60, 0.42, sand if n[2] > 0.6 else 0.0)
    mixed(out, 0.36, 0.29, 0.21, 1 - (z - shapes.WATER) * 90)  # wet


@njit(nogil=True, cache=True)
def water(island: shapes.Island, p: np.ndarray, out: np.ndarray) -> None:
    """Turquoise over the shelf, deep blue further out, foam at the shore."""
    deep = shapes.WATER - shapes.ground(island.heights, p[0], p[1])
    ripple = shapes.rough(9 * p[0], 9 * p[1], 1.0)
    out[0], out[1], out[2] = 0.012, 0.075, 0.14
    mixed(out, 0.03, 0.27, 0.30, 1.25 - deep * 7 + 0.3 * (ripple - 0.5))
    mixed(out, 0.16, 0.46, 0.42, 1.0 - deep * 16)
    crest = abs(shapes.noise(16 * p[0] + 3 * ripple, 16 * p[1], 9.0) - 0.5)
    mixed(out, 0.16, 0.42, 0.50, 0.30 - 5 * crest)
    foam = 1 - abs(deep - 0.014 - 0.02 * (ripple - 0.45)) * 75
    second = 1 - abs(deep - 0.062 - 0.03 * (ripple - 0.45)) * 130
    mixed(out, 0.86, 0.90, 0.90, max(foam, 0.55 * second) * 1.2)


@njit(nogil=True, cache=True)
def paint(island: shapes.Island, feet: np.ndarray, of: int, p: np.ndarray, n: np.ndarray, out: np.ndarray) -> float:
    """Albedo into `out`; returns how glossy it is: reflectance at normal incidence, negative for a metal."""
    x, y, z = p[0], p[1], p[2]
    fine = shapes.rough(30 * x, 30 * y, 30 * z)
    if of == shapes.SEA:
        water(island, p, out)
        return 0.06
    if of == shapes.GROUND:
        land(p, n, out)
        return 0.0
    if of == shapes.TOWER:
        band = (z - feet[0]) / 0.125
        red = band - 2 * floor(band / 2) < 1
        out[0], out[1], out[2] = (0.62, 0.045, 0.04) if red else (0.84, 0.82, 0.77)
        mixed(out, 0.45, 0.40, 0.34, 0.9 * (fine - 0.62) + 0.5 * (0.06 - (z - feet[0])) / 0.06)
        return 0.045
    if of in (shapes.RED, shapes.HULL):
        out[0], out[1], out[2] = (0.60, 0.05, 0.04) if of == shapes.RED else (0.80, 0.80, 0.78)
        if of == shapes.HULL and z - shapes.WATER < 0.022:
            out[0], out[1], out[2] = 0.05, 0.13, 0.36
        return 0.06
    if of == shapes.GLASS:
        out[0], out[1], out[2] = 0.05, 0.07, 0.09
        lantern = hypot(x - shapes.TOWER_AT[0], y - shapes.TOWER_AT[1]) < 0.06 and z - feet[0] > 0.5
        if lantern:
            out[0], out[1], out[2] = 0.95, 0.66, 0.22
        return 0.10
    if of == shapes.IRON:
        out[0], out[1], out[2] = 0.06, 0.065, 0.07
        return 0.05
    if of == shapes.WALL:
        out[0], out[1], out[2] = 0.86, 0.80, 0.68
        mixed(out, 0.55, 0.47, 0.36, 0.8 * (fine - 0.6))
        return 0.0
    if of == shapes.TILES:
        u = (x - shapes.COTTAGE_AT[0]) * 0.8776 + (y - shapes.COTTAGE_AT[1]) * 0.4794
        row = floor((z - feet[1]) / 0.0155)
        column = floor(u / 0.024 + (0.5 if row % 2 else 0.0))
        shade = shapes.hashed(int(row), int(column), 3)
        out[0], out[1], out[2] = 0.52 + 0.16 * (shade - 0.5), 0.17 + 0.06 * (shade - 0.5), 0.09
        edge = (z - feet[1]) / 0.0155 - row
        mixed(out, 0.16, 0.06, 0.04, 0.75 if edge < 0.16 else 0.0)
        return 0.03
    if of == shapes.WOOD:
        out[0], out[1], out[2] = 0.36, 0.23, 0.13
        mixed(out, 0.20, 0.13, 0.08, 1.4 * (shapes.noise(60 * x, 60 * y, 9 * z) - 0.5))
        return 0.0
    if of == shapes.RIM:
        grain = shapes.noise(8 * hypot(x, y), 2.5 * atan2(y, x), 60 * z)
        out[0], out[1], out[2] = 0.23 + 0.10 * grain, 0.12 + 0.06 * grain, 0.06
        return 0.05
    if of == shapes.PINE:
        out[0], out[1], out[2] = 0.05 + 0.06 * (fine - 0.4), 0.19 + 0.14 * (fine - 0.5), 0.075
        return 0.0
    if of == shapes.LEAVES:
        kind = shapes.hashed(floor(3 * x + 20), floor(3 * y + 20), 1)
        out[0], out[1], out[2] = 0.22 + 0.34 * kind * kind, 0.30 - 0.06 * kind, 0.06
        mixed(out, 0.10, 0.20, 0.04, 1.4 * (fine - 0.5))
        return 0.0
    if of == shapes.TRUNK:
        out[0], out[1], out[2] = 0.20, 0.13, 0.08
        return 0.0
    if of == shapes.SAIL:
        out[0], out[1], out[2] = 0.90, 0.87, 0.79
        seam = z / 0.055 - floor(z / 0.055)
        mixed(out, 0.70, 0.66, 0.58, 0.5 if seam < 0.07 else 0.0)
        return 0.0
    out[0], out[1], out[2] = 0.44 + 0.2 * (fine - 0.5), 0.42 + 0.2 * (fine - 0.5), 0.39 + 0.18 * (fine - 0.5)
    mixed(out, 0.16, 0.22, 0.10, (1 - (z - shapes.WATER) * 30) if of == shapes.STONE else 0.0)  # weed at the water
    return 0.0


@njit(nogil=True, cache=True)
def normal_at(island: shapes.Island, feet: np.ndarray, of: int, p: np.ndarray, n: np.ndarray) -> None:
    """The unit normal into `n`: the field's gradient, with ripples on the sea."""
    if of == shapes.SEA and p[2] > shapes.WATER - 2e-3:
        for axis in range(2):
            low = shapes.rough(7 * (p[0] - 0.02 * (axis == 0)), 7 * (p[1] - 0.02 * (axis == 1)), 2.0)
            high = shapes.rough(7 * (p[0] + 0.02 * (axis == 0)), 7 * (p[1] + 0.02 * (axis == 1)), 2.0)
            n[axis] = -0.16 * (high - low)
        n[2] = 1.0
    else:
        e = 8e-4
        for axis in range(3):
            a, b = e * (axis == 0), e * (axis == 1)
            c = e * (axis == 2)
            high, _ = shapes.nearest(island, feet, p[0] + a, p[1] + b, p[2] + c)
            low, _ = shapes.nearest(island, feet, p[0] - a, p[1] - b, p[2] - c)
            n[axis] = high - low
    length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) + 1e-12
    for c in range(3):
        n[c] /= length


@njit(nogil=True, cache=True)
def shown(linear: float) -> float:
    """Linear light to sRGB in [0, 1], with a shoulder so that highlights roll off instead of clipping."""
    value = linear if linear < 0.6 else 0.6 + 0.4 * (1 - exp(-(linear - 0.6) / 0.4))
    return 12.92 * value if value < 0.0031308 else min(1.055 * value ** (1 / 2.4) - 0.055, 1.0)


@njit(nogil=True, cache=True)
def colour(island: shapes.Island, feet: np.ndarray, o: np.ndarray, d: np.ndarray, out: np.ndarray) -> bool:
    """The display colour that a ray sees into `out` [3]; False where it sees nothing."""
    t, of = march(island, feet, o, d)
    if of == shapes.NOTHING:
        return False
    p, n, r = o + t * d, np.zeros(3), np.zeros(3)
    albedo, mirrored = np.zeros(3), np.zeros(3)
    normal_at(island, feet, of, p, n)
    facing = -(n[0] * d[0] + n[1] * d[1] + n[2] * d[2])
    gloss = paint(island, feet, of, p, n, albedo)
    lit = n[0] * SUN[0] + n[1] * SUN[1] + n[2] * SUN[2]
    thin = of in (shapes.SAIL, shapes.LEAVES, shapes.PINE)
    if thin:
        lit = max(lit, -0.45 * lit) if of == shapes.SAIL else 0.75 * lit + 0.25  # light comes through
    if lit > 0:
        lit *= sunlight(island, feet, p[0] + 0.004 * n[0], p[1] + 0.004 * n[1], p[2] + 0.004 * n[2])
    openness = open_sky(island, feet, p, n)
    side = 0.5 + 0.5 * n[2]
    lantern = of == shapes.GLASS and albedo[0] > 0.5
    for c in range(3):
        around = BELOW[c] * 1.1 + (SKY[c] * 1.05 + 0.10 - BELOW[c] * 1.1) * side
        out[c] = albedo[c] * (0.80 * around * openness + max(lit, 0.0) * SUN_COLOUR[c] + (0.55 if lantern else 0.0))
    if gloss > 0:
        for c in range(3):
            r[c] = d[c] + 2 * facing * n[c]
        sky(r, 220.0 if of == shapes.SEA else 90.0, mirrored)
        fresnel = gloss + (1 - gloss) * (1 - min(max(facing, 0.0), 1.0)) ** 5
        fresnel *= 0.75 if of == shapes.SEA else 1.0
        for c in range(3):
            out[c] = out[c] * (1 - fresnel) + fresnel * mirrored[c] * (0.35 + 0.65 * openness)
    for c in range(3):
        out[c] = shown(out[c])
    return True


@njit(nogil=True, cache=True)
def fill_picture(
    island: shapes.Island,
    feet: np.ndarray,
    world_T_camera: np.ndarray,
    lens: np.ndarray,
    subpixels: int,
    picture: np.ndarray,
) -> None:
    """Fills a picture [H, W, 4] of zeros: premultiplied display colour and coverage.

    lens: fx, fy, cx, cy in pixels.
    """
    o = world_T_camera[:3, 3].copy()
    d, one = np.zeros(3), np.zeros(3)
    for row in range(picture.shape[0]):
        for column in range(picture.shape[1]):
            for k in range(subpixels * subpixels):
                a = (column + (k % subpixels + 0.5) / subpixels - lens[2]) / lens[0]
                b = -(row + (k // subpixels + 0.5) / subpixels - lens[3]) / lens[1]
                length = sqrt(a * a + b * b + 1)
                for c in range(3):
                    d[c] = (a * world_T_camera[c, 0] + b * world_T_camera[c, 1] - world_T_camera[c, 2]) / length
                if colour(island, feet, o, d, one):
                    for c in range(3):
                        picture[row, column, c] += one[c] / (subpixels * subpixels)
                    picture[row, column, 3] += 1.0 / (subpixels * subpixels)
