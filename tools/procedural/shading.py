"""Light and materials: a studio with a warm key light, a cool sky and two soft boxes that glossy things mirror.

Notation: p, n [N, 3] surface points and normals; v [N, 3] unit direction from the surface to the eye; r
its mirror image; albedo [N, 3] linear; f0 reflectance at normal incidence (Schlick). Colours are linear
until `display`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tools.procedural.shapes import Disc, Shape, dot


def unit(*xyz: float) -> np.ndarray:
    """A unit vector, float32 [3]."""
    vector = np.array(xyz, np.float32)
    return vector / np.linalg.norm(vector)


KEY = unit(0.55, -0.35, 0.85)  # direction to the key light
KEY_COLOUR = np.array([1.62, 1.46, 1.22], np.float32)
KEY_RADIUS = 0.16  # angular radius in radians: the softness of shadows
SKY, HORIZON, GROUND = (np.array(c, np.float32) for c in ((0.50, 0.62, 0.80), (0.80, 0.74, 0.68), (0.34, 0.27, 0.22)))
BOXES = (  # direction, sharpness and colour of the soft boxes seen in reflections
    (unit(0.55, -0.35, 0.85), 90.0, np.array([11.0, 10.2, 9.0], np.float32)),
    (unit(-0.75, 0.5, 0.45), 26.0, np.array([1.6, 2.2, 3.0], np.float32)),
    (unit(-0.2, -0.9, 0.25), 40.0, np.array([2.6, 1.7, 1.3], np.float32)),
)


@dataclass(frozen=True)
class Material:
    """albedo: linear colour [3], or a pattern p [N, 3] -> [N, 3]. f0, and whether it is a metal (tinted mirror). opacity: of
    what does not mirror; below 1 it is tinted glass, which does not refract."""

    albedo: np.ndarray | Callable[[np.ndarray], np.ndarray]
    f0: float = 0.05
    metal: bool = False
    opacity: float = 1.0

    def colour(self, p: np.ndarray) -> np.ndarray:
        """Linear albedo [N, 3] at p."""
        return self.albedo(p) if callable(self.albedo) else np.broadcast_to(self.albedo, p.shape)


@dataclass(frozen=True)
class Thing:
    """A shape and what it is made of."""

    shape: Shape
    material: Material


def environment(r: np.ndarray) -> np.ndarray:
    """The studio seen along unit directions r [N, 3]: smooth sky, floor bounce and soft boxes; linear [N, 3]."""
    up = r[:, 2:3]
    down = np.clip(0.15 - 1.3 * up, 0, 1)
    colour = HORIZON + (SKY - HORIZON) * np.clip(up, 0, 1) + (GROUND - HORIZON) * (down * down * (3 - 2 * down))
    for direction, sharpness, tint in BOXES:
        # a Phong lobe: (r . l)^s, so highlights slide over the surface as the eye moves
        lobe = np.clip(r @ direction, 0, 1)
        colour = colour + np.exp(np.float32(sharpness) * (lobe - 1))[:, None] * tint
    return colour


def key_light(things: Sequence[Thing], p: np.ndarray, skip: int) -> np.ndarray:
    """Share [N] of the key light that reaches p past all things but number `skip`, which shades itself by n . l."""
    share = np.ones(len(p), np.float32)
    for index, thing in enumerate(things):
        if index != skip and not isinstance(thing.shape, Disc):
            lit, opacity = thing.shape.lit(p, KEY, KEY_RADIUS), np.float32(thing.material.opacity)
            share = share * (lit if opacity == 1 else 1 - opacity * (1 - lit))
    return share


def ambient(things: Sequence[Thing], p: np.ndarray, n: np.ndarray, skip: int) -> np.ndarray:
    """Light from the sky and the ground [N, 3], less what nearby things hide (each taken as its bounding ball)."""
    open_sky = np.ones(len(p), np.float32)
    for index, thing in enumerate(things):
        centre, radius = thing.shape.bound
        if index == skip or isinstance(thing.shape, Disc) or radius < 0.06 or thing.material.opacity < 1:
            continue
        solid = 0.8 * radius if hasattr(thing.shape, "centre") else 0.1 * radius  # a rod hides little
        to = centre - p
        distance2 = np.maximum(dot(to, to), solid * solid)
        facing = np.clip(dot(n, to) / np.sqrt(distance2), 0, 1)
        open_sky = open_sky * (1 - facing * solid * solid / distance2)
    mix = (0.5 + 0.5 * n[:, 2:3]).astype(np.float32)
    return (0.62 * (GROUND + (SKY * 1.15 - GROUND) * mix)) * open_sky[:, None]


def shade(things: Sequence[Thing], index: int, p: np.ndarray, n: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Linear colour [N, 3] of thing number `index` at p seen from v."""
    material = things[index].material
    albedo = material.colour(p)
    sun = np.clip(n @ KEY, 0, 1)
    seen = np.ones(len(p), np.float32)  # where the surface faces away, sun is 0 already
    facing = sun > 0
    seen[facing] = key_light(things, p[facing] + 2e-3 * n[facing], index)
    sky = ambient(things, p, n, index)
    cosine = np.clip(dot(n, v), 0, 1)
    fresnel = (material.f0 + (1 - material.f0) * (1 - cosine) ** 5)[:, None]
    mirrored = environment(2 * dot(n, v)[:, None] * n - v)
    # what hides the sky hides its mirror image too
    mirrored = mirrored * np.clip(0.4 + 1.3 * sky.mean(-1, keepdims=True), 0, 1) * (0.55 + 0.45 * seen[:, None])
    if material.metal:
        return albedo * (mirrored * 1.05 + 0.35 * sky + 0.35 * (sun * seen)[:, None] * KEY_COLOUR)
    diffuse = albedo * (sky + (sun * seen)[:, None] * KEY_COLOUR)
    return diffuse * (1 - fresnel) + fresnel * mirrored


def coverage(material: Material, n: np.ndarray, v: np.ndarray) -> np.ndarray:
    """How much [N] of what is behind a thing it hides: glass hides more the flatter it is looked at."""
    cosine = np.clip(dot(n, v), 0, 1)
    fresnel = material.f0 + (1 - material.f0) * (1 - cosine) ** 5
    return (material.opacity + (1 - material.opacity) * fresnel).astype(np.float32)


def display(linear: np.ndarray) -> np.ndarray:
    """Linear light to sRGB in [0, 1], with a shoulder so that highlights roll off instead of clipping."""
    shouldered = np.where(linear < 0.6, linear, 0.6 + 0.4 * (1 - np.exp(-(linear - 0.6) / 0.4)))
    low = shouldered * 12.92
    return np.where(shouldered < 0.0031308, low, 1.055 * np.maximum(shouldered, 1e-6) ** (1 / 2.4) - 0.055)
