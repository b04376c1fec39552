"""The arrangement: a spiral of beads on brass pins round a still life of glossy things, on a tiled turntable.

Everything lies within +-1.25 on each axis, so that a voxel grid of a cube of +-1.3 resolves it well.
Training frame, z up. The seed turns the hues, the tiles and the places of the small things; the
composition stays.
"""

import colorsys
from collections.abc import Callable

import numpy as np

from tools.procedural.shading import Material, Thing
from tools.procedural.shapes import Disc, Implicit, Rod, Sphere, box_distance, torus_distance

FLOOR = -0.72  # z of the turntable's top
TURNTABLE = 1.22  # its radius
BEADS = 20


def linear(hexadecimal: str) -> np.ndarray:
    """An sRGB colour "#rrggbb" as linear float32 [3]."""
    srgb = np.array([int(hexadecimal[i : i + 2], 16) for i in (1, 3, 5)], np.float32) / 255
    return np.where(srgb < 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(np.float32)


def turned(colour: np.ndarray, turn: float) -> np.ndarray:
    """A linear colour with its hue turned by so much of the circle."""
    hue, lightness, saturation = colorsys.rgb_to_hls(*map(float, colour))
    return np.array(colorsys.hls_to_rgb((hue + turn) % 1, lightness, saturation), np.float32)


def gradient(stops: list[np.ndarray], at: float) -> np.ndarray:
    """The colour at 0 <= at <= 1 of evenly spaced stops."""
    position = at * (len(stops) - 1)
    low = min(int(position), len(stops) - 2)
    return (stops[low] + (position - low) * (stops[low + 1] - stops[low])).astype(np.float32)


def value_noise(seed: int) -> Callable[[np.ndarray], np.ndarray]:
    """Smooth noise [0, 1] of the plane with features of size 1, periodic in 64: [N, 2] -> [N]."""
    lattice = np.random.default_rng(seed).random((64, 64), np.float32)

    def noise(xy: np.ndarray) -> np.ndarray:
        cell = np.floor(xy).astype(np.int64)
        f = (xy - cell).astype(np.float32)
        f = f * f * (3 - 2 * f)
        x0, y0 = cell[:, 0] % 64, cell[:, 1] % 64
        x1, y1 = (x0 + 1) % 64, (y0 + 1) % 64
        low = lattice[x0, y0] * (1 - f[:, 0]) + lattice[x1, y0] * f[:, 0]
        high = lattice[x0, y1] * (1 - f[:, 0]) + lattice[x1, y1] * f[:, 0]
        return low * (1 - f[:, 1]) + high * f[:, 1]

    return noise


def tiles(seed: int, light: np.ndarray, dark: np.ndarray, rim: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """The turntable's pattern: checkered stone with a little grain inside a plain border; the side is of wood."""
    noise = value_noise(seed)

    def albedo(p: np.ndarray) -> np.ndarray:
        xy = p[:, :2]
        radius = np.hypot(xy[:, 0], xy[:, 1])
        grain = 0.78 + 0.30 * noise(xy * 9 + 20) + 0.16 * noise(xy * 31 + 7)
        odd = (np.floor(xy[:, 0] / 0.2) + np.floor(xy[:, 1] / 0.2)) % 2 == 0
        colour = np.where(odd[:, None], light, dark) * grain[:, None].astype(np.float32)
        border = (radius > TURNTABLE - 0.14) & (radius < TURNTABLE - 0.10)
        colour = np.where(border[:, None], rim, colour)
        colour = np.where((radius >= TURNTABLE - 0.10)[:, None], dark * grain[:, None], colour)
        angle = np.arctan2(xy[:, 1], xy[:, 0])
        wood = rim * (0.7 + 0.5 * noise(np.stack([angle * 7, p[:, 2] * 90], -1) + 11))[:, None]
        return np.where((p[:, 2] < FLOOR - 2e-3)[:, None], wood, colour).astype(np.float32)

    return albedo


def bands(shape: Implicit, one: np.ndarray, two: np.ndarray, width: float) -> Callable[[np.ndarray], np.ndarray]:
    """A checker of cubes of this width in the shape's own frame."""

    def albedo(p: np.ndarray) -> np.ndarray:
        odd = np.floor(shape.local(p) / width + 0.5).sum(-1) % 2 == 0
        return np.where(odd[:, None], one, two)

    return albedo


def rotation(yaw: float, tilt: float) -> np.ndarray:
    """shape_R_world of a shape tilted about its x axis, then turned about z (radians)."""
    cy, sy, ct, st = np.cos(yaw), np.sin(yaw), np.cos(tilt), np.sin(tilt)
    world_R_turned = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    turned_R_shape = np.array([[1, 0, 0], [0, ct, -st], [0, st, ct]])
    return (world_R_turned @ turned_R_shape).T.astype(np.float32)


def point(x: float, y: float, height: float) -> np.ndarray:
    """A place `height` above the turntable, float32 [3]."""
    return np.array([x, y, FLOOR + height], np.float32)


def still_life(seed: int = 0) -> list[Thing]:
    """All things of the scene, deterministic by seed; seed 0 is the one whose colours were chosen by eye."""
    rng = np.random.default_rng(seed)
    turn = 0.0 if seed == 0 else float(rng.random())
    ink, cream, coral, gold, teal, plum = (
        turned(linear(c), turn) for c in ("#2f4858", "#f1e6d0", "#e4572e", "#f0b429", "#17a398", "#7b3f8c")
    )
    brass = Material(linear("#f2c066"), f0=0.8, metal=True)
    wood = turned(linear("#7a4a2b"), turn)

    torus = Implicit(point(0.42, 0.34, 0.40), rotation(0.5, 1.25), 0.41, torus_distance(0.305, 0.095))
    box = Implicit(
        point(0.30, -0.45, 0.23), rotation(0.45, 0.0), 0.42, box_distance(np.full(3, 0.23, np.float32), 0.035)
    )
    things = [
        Thing(Disc(TURNTABLE, FLOOR - 0.10, FLOOR), Material(tiles(seed, cream, ink, wood), f0=0.02)),
        Thing(Sphere(point(-0.36, 0.10, 0.42), 0.42), Material(coral, f0=0.08)),
        Thing(torus, Material(teal, f0=0.09)),
        Thing(box, Material(bands(box, cream, plum, 0.155), f0=0.04)),
        Thing(Sphere(point(0.30, -0.45, 0.46 + 0.15), 0.15), brass),
        Thing(Sphere(point(-0.30, -0.56, 0.17), 0.17), Material(gold, f0=0.08)),
        Thing(Sphere(point(-0.02, -0.78, 0.09), 0.09), Material(teal, f0=0.09)),
        Thing(Sphere(point(-0.06, 0.66, 0.12), 0.12), Material(plum, f0=0.09)),
    ]
    start = float(rng.random()) * 2 * np.pi if seed else 2.3
    for i in range(BEADS):
        share = i / (BEADS - 1)
        angle = start + share * np.radians(325)
        height = 0.16 + 1.16 * share**1.1
        x, y = 0.98 * np.cos(angle), 0.98 * np.sin(angle)
        bead = gradient([coral, gold, cream, teal, plum], share)
        things.append(Thing(Rod(point(x, y, 0.0), point(x, y, height), 0.015), brass))
        things.append(Thing(Sphere(point(x, y, height), 0.075), Material(bead, f0=0.09)))
    return things
