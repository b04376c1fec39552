"""Two arrangements that ask for what the demo scene hardly does: `glass`, of gloss and transparency, and `wires`, of thin things.

Both lie within +-1.25 on each axis, z up, as still_life does, and are deterministic by seed; seed 0 was chosen by eye.
glass: mirrors, panes and balls of tinted glass (not refracting) that stand behind one another on a dark polished disc.
wires: a cage of rods as thin as a pixel of 400 x 400 pictures, with rings, a coil, a net and beads on strings within.
"""

import numpy as np

from tools.procedural.shading import Material, Thing
from tools.procedural.shapes import Disc, Implicit, Rod, Sphere, box_distance, torus_distance
from tools.procedural.still_life import FLOOR, TURNTABLE, bands, gradient, linear, point, rotation, tiles, turned

PANES, BALLS = 7, 8
BARS, HOOPS, STRINGS, MESHES = 28, 5, 9, 9
BAR, WIRE, CORD = 0.0085, 0.006, 0.005  # radii
CAGE = 0.92  # its radius


def glass(seed: int = 0) -> list[Thing]:
    """A ring of tinted panes around mirrors and balls of glass."""
    rng = np.random.default_rng(seed)
    turn = 0.0 if seed == 0 else float(rng.random())
    colours = [turned(linear(c), turn) for c in ("#e4572e", "#f0b429", "#17a398", "#3d6bd6", "#8a4fbf", "#d6457f")]
    ink, slate, cream = (turned(linear(c), turn) for c in ("#20242c", "#39424f", "#efe6d4"))
    chrome, gold = Material(linear("#dfe3e8"), f0=0.75, metal=True), Material(linear("#f2c066"), f0=0.8, metal=True)
    box = Implicit(point(-0.10, 0.02, 0.2), rotation(0.35, 0.0), 0.37, box_distance(np.full(3, 0.2, np.float32), 0.02))
    things = [
        Thing(Disc(TURNTABLE, FLOOR - 0.08, FLOOR), Material(tiles(seed + 3, slate, ink, ink), f0=0.06)),
        Thing(Sphere(point(-0.10, 0.02, 0.4 + 0.27), 0.27), chrome),
        Thing(box, Material(bands(box, cream, ink, 0.1), f0=0.04)),
        Thing(Sphere(point(0.42, -0.34, 0.2), 0.2), gold),
        Thing(Sphere(point(0.36, 0.46, 0.25), 0.25), Material(colours[0], f0=0.35)),
    ]
    for i in range(PANES):
        angle = 2 * np.pi * (i + 0.3) / PANES
        half = np.array([0.23, 0.012, 0.30 + 0.05 * (i % 3)], np.float32)
        place = point(0.86 * np.cos(angle), 0.86 * np.sin(angle), float(half[2]) + 0.01)
        shape = Implicit(
            place, rotation(angle + np.pi / 2 + 0.25, 0.0), float(np.linalg.norm(half)), box_distance(half, 0.01)
        )
        things.append(Thing(shape, Material(colours[i % len(colours)], f0=0.06, opacity=0.38)))
    for i in range(BALLS):
        angle, radius = 2 * np.pi * i / BALLS + 0.2, 0.09 + 0.02 * (i % 3)
        place = point(0.58 * np.cos(angle), 0.58 * np.sin(angle), radius + (0.0 if i % 2 else 0.62))
        colour = colours[(2 * i + 1) % len(colours)]
        things.append(Thing(Sphere(place, radius), Material(colour, f0=0.08, opacity=0.3 + 0.1 * (i % 3))))
        if i % 2 == 0:
            things.append(Thing(Rod(point(float(place[0]), float(place[1]), 0.0), place - [0, 0, radius], 0.008), gold))  # type: ignore[arg-type]
    return things


def wires(seed: int = 0) -> list[Thing]:
    """A round cage, and what hangs and stands in it."""
    rng = np.random.default_rng(seed)
    turn = 0.0 if seed == 0 else float(rng.random())
    colours = [turned(linear(c), turn) for c in ("#e4572e", "#f0b429", "#17a398", "#7b3f8c")]
    cream, wood = turned(linear("#e8dcc2"), turn), turned(linear("#7a4a2b"), turn)
    iron, brass = Material(turned(linear("#2b3038"), turn), f0=0.1), Material(linear("#f2c066"), f0=0.8, metal=True)
    twine = Material(turned(linear("#b9763a"), turn), f0=0.03)
    top = point(0.0, 0.0, 1.72)
    things = [Thing(Disc(1.05, FLOOR - 0.08, FLOOR), Material(tiles(seed + 5, cream, wood, wood), f0=0.03))]
    for i in range(BARS):
        angle = 2 * np.pi * i / BARS
        x, y = CAGE * np.cos(angle), CAGE * np.sin(angle)
        things.append(Thing(Rod(point(x, y, 0.0), point(x, y, 1.2), BAR), iron))
        things.append(Thing(Rod(point(x, y, 1.2), top, BAR), iron))
    for i in range(HOOPS):
        shape = Implicit(
            point(0, 0, 0.08 + 0.28 * i), np.eye(3, dtype=np.float32), CAGE + 0.03, torus_distance(CAGE, WIRE)
        )
        things.append(Thing(shape, brass))
    things += _net(twine)
    for i in range(STRINGS):
        angle, reach = 2 * np.pi * i / STRINGS + 0.3, 0.30 + 0.22 * (i % 3)
        x, y = reach * np.cos(angle), reach * np.sin(angle)
        low = 0.5 + 0.09 * (i % 4)
        things.append(Thing(Rod(point(x, y, low), point(x, y, 1.72 - 0.52 * reach / CAGE), CORD), twine))
        for j in range(3):
            bead = gradient(colours, (i + j / 3) / STRINGS)
            things.append(Thing(Sphere(point(x, y, low + 0.11 * j), 0.035 - 0.006 * j), Material(bead, f0=0.09)))
    for i in range(4):  # rings that lean against one another
        shape = Implicit(
            point(0.0, 0.0, 0.24), rotation(0.8 * i, 1.2 - 0.25 * i), 0.26, torus_distance(0.23 - 0.012 * i, WIRE)
        )
        things.append(Thing(shape, brass if i % 2 else Material(colours[i], f0=0.1)))
    return things


def _net(material: Material) -> list[Thing]:
    """A sagging square net across the cage: straight pieces of cord between its knots."""
    side = np.linspace(-0.56, 0.56, MESHES)
    x, y = np.meshgrid(side, side, indexing="ij")
    height = 0.50 - 0.16 * np.cos(0.5 * np.pi * x / 0.56) * np.cos(0.5 * np.pi * y / 0.56)
    knots = np.stack([x, y, FLOOR + height], -1).astype(np.float32)
    pieces = [(knots[i, j], knots[i + 1, j]) for i in range(MESHES - 1) for j in range(MESHES)]
    pieces += [(knots[i, j], knots[i, j + 1]) for i in range(MESHES) for j in range(MESHES - 1)]
    return [Thing(Rod(a, b, CORD), material) for a, b in pieces]
