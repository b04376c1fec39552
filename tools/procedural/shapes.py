"""Shapes with closed-form or sphere-traced hits, and how each of them shades the others.

Notation: o, d [N, 3] ray origins and unit directions; t [N] distance to the first hit, inf where there is
none; p, n [N, 3] surface points and outward unit normals; l [3] unit direction to the light, w its angular
radius. float32 throughout; world units, z up.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

INFINITY = np.float32(np.inf)
MISS = np.float32(1e-4)  # hits nearer than this are the surface the ray starts on


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Inner product over the last axis."""
    return np.einsum("...i,...i->...", a, b)


def sphere_hit(o: np.ndarray, d: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """t [N] where rays enter a sphere; inf where they miss it or start behind it."""
    oc = o - centre
    b = dot(oc, d)
    h = b * b - (dot(oc, oc) - np.float32(radius * radius))
    t = -b - np.sqrt(np.maximum(h, 0))
    return np.where((h > 0) & (t > MISS), t, INFINITY)


def penumbra(gap: np.ndarray, ahead: np.ndarray, radius: float, w: float) -> np.ndarray:
    """Share of the light that passes an occluder of this radius whose edge the shadow ray clears by `gap`.

    ahead [N]: distance along the ray to the closest approach; the light's disc has radius w * ahead there,
    and an occluder smaller than that disc hides only a part of it.
    """
    spread = np.float32(w) * np.maximum(ahead, 1e-3)
    covered = np.clip(0.5 - 0.5 * gap / spread, 0, 1)
    covered = covered * covered * (3 - 2 * covered) * np.minimum(1, radius / spread)
    return np.where(ahead > 0, 1 - covered, 1)


@dataclass(frozen=True)
class Sphere:
    """A ball. centre [3], radius."""

    centre: np.ndarray
    radius: float

    @property
    def bound(self) -> tuple[np.ndarray, float]:
        """A sphere (centre, radius) around the shape."""
        return self.centre, self.radius

    def hit(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        return sphere_hit(o, d, self.centre, self.radius)

    def normal(self, p: np.ndarray) -> np.ndarray:
        return (p - self.centre) / np.float32(self.radius)

    def lit(self, p: np.ndarray, light: np.ndarray, w: float) -> np.ndarray:
        """Share [N] of the light that reaches p past this shape."""
        oc = self.centre - p
        ahead = dot(oc, light)
        distance = np.sqrt(np.maximum(dot(oc, oc) - ahead * ahead, 0))
        return penumbra(distance - np.float32(self.radius), ahead, self.radius, w)


@dataclass(frozen=True)
class Rod:
    """A capsule: every point within `radius` of the segment from a to b."""

    a: np.ndarray
    b: np.ndarray
    radius: float

    @property
    def bound(self) -> tuple[np.ndarray, float]:
        return (self.a + self.b) / 2, float(np.linalg.norm(self.b - self.a)) / 2 + self.radius

    def hit(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        ba, oa = self.b - self.a, o - self.a
        length2, ba_d, ba_oa = np.dot(ba, ba), d @ ba, oa @ ba
        a = length2 - ba_d * ba_d
        b = length2 * dot(d, oa) - ba_oa * ba_d
        c = length2 * dot(oa, oa) - ba_oa * ba_oa - np.float32(self.radius**2) * length2
        h = b * b - a * c
        t = (-b - np.sqrt(np.maximum(h, 0))) / np.maximum(a, 1e-9)
        along = ba_oa + t * ba_d
        side = np.where((h > 0) & (along > 0) & (along < length2) & (t > MISS), t, INFINITY)
        caps = np.minimum(sphere_hit(o, d, self.a, self.radius), sphere_hit(o, d, self.b, self.radius))
        return np.minimum(side, np.where(h > 0, caps, INFINITY))

    def normal(self, p: np.ndarray) -> np.ndarray:
        ba = self.b - self.a
        along = np.clip((p - self.a) @ ba / np.dot(ba, ba), 0, 1)
        return (p - self.a - along[:, None] * ba) / np.float32(self.radius)

    def lit(self, p: np.ndarray, light: np.ndarray, w: float) -> np.ndarray:
        ba, ap = self.b - self.a, p - self.a
        length2, ba_l = np.dot(ba, ba), np.dot(ba, light)
        denominator = max(float(length2 - ba_l * ba_l), 1e-9)
        along = np.clip((ap @ ba - ba_l * (ap @ light)) / denominator, 0, 1)
        oc = along[:, None] * ba - ap
        ahead = oc @ light
        distance = np.sqrt(np.maximum(dot(oc, oc) - ahead * ahead, 0))
        return penumbra(distance - np.float32(self.radius), ahead, self.radius, w)


@dataclass(frozen=True)
class Disc:
    """A flat cylinder, axis z, from z = bottom to z = top; it casts no shadow on what stands on it."""

    radius: float
    bottom: float
    top: float

    @property
    def bound(self) -> tuple[np.ndarray, float]:
        half = (self.top - self.bottom) / 2
        centre = np.array([0, 0, self.bottom + half], np.float32)
        return centre, float(np.hypot(self.radius, half))

    def hit(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        dz = np.where(np.abs(d[:, 2]) < 1e-6, np.float32(1e-6), d[:, 2])
        level = np.where(dz < 0, np.float32(self.top), np.float32(self.bottom))
        t_cap = (level - o[:, 2]) / dz
        at = o[:, :2] + t_cap[:, None] * d[:, :2]
        cap = np.where((dot(at, at) < self.radius**2) & (t_cap > MISS), t_cap, INFINITY)
        a, b = np.maximum(dot(d[:, :2], d[:, :2]), 1e-9), dot(o[:, :2], d[:, :2])
        h = b * b - a * (dot(o[:, :2], o[:, :2]) - np.float32(self.radius**2))
        t_side = (-b - np.sqrt(np.maximum(h, 0))) / a
        z = o[:, 2] + t_side * d[:, 2]
        on_side = (h > 0) & (z > self.bottom) & (z < self.top) & (t_side > MISS)
        return np.minimum(cap, np.where(on_side, t_side, INFINITY))

    def normal(self, p: np.ndarray) -> np.ndarray:
        side = np.hypot(p[:, 0], p[:, 1]) > self.radius - 1e-3
        inside = (p[:, 2] < self.top - 1e-3) & (p[:, 2] > self.bottom + 1e-3)
        up = np.where(p[:, 2] > (self.top + self.bottom) / 2, np.float32(1), np.float32(-1))
        flat = np.stack([np.zeros_like(up), np.zeros_like(up), up], -1)
        round_ = np.concatenate([p[:, :2] / np.float32(self.radius), np.zeros_like(p[:, :1])], -1)
        return np.where((side & inside)[:, None], round_, flat)


@dataclass(frozen=True)
class Implicit:
    """A shape known by its signed distance in its own frame: shape_R_world [3, 3] rows are its axes.

    distance: p [N, 3] in the shape's frame -> [N]. size: radius of a sphere about centre that holds it.
    """

    centre: np.ndarray
    shape_R_world: np.ndarray
    size: float
    distance: Callable[[np.ndarray], np.ndarray]

    @property
    def bound(self) -> tuple[np.ndarray, float]:
        return self.centre, self.size

    def local(self, p: np.ndarray) -> np.ndarray:
        """World points in the shape's frame."""
        return (p - self.centre) @ self.shape_R_world.T

    def hit(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        oc = self.local(o)
        dl = d @ self.shape_R_world.T
        b = dot(oc, dl)
        h = b * b - dot(oc, oc) + np.float32(self.size**2)
        root = np.sqrt(np.maximum(h, 0))
        t, end = np.maximum(-b - root, 0), -b + root
        result = np.full(len(o), INFINITY, np.float32)
        live = np.flatnonzero((h > 0) & (end > 0))
        for _ in range(56):
            if not len(live):
                break
            step = self.distance(oc[live] + t[live, None] * dl[live])
            done = step < 4e-4
            result[live[done]] = t[live[done]]
            t[live] += np.maximum(step, 4e-4)
            live = live[~done & (t[live] < end[live])]
        return result

    def normal(self, p: np.ndarray) -> np.ndarray:
        q, step = self.local(p), np.float32(2e-3)
        axes = np.eye(3, dtype=np.float32) * step
        gradient = np.stack([self.distance(q + e) - self.distance(q - e) for e in axes], -1)
        gradient /= np.maximum(np.linalg.norm(gradient, axis=-1, keepdims=True), 1e-9)
        return gradient @ self.shape_R_world

    def lit(self, p: np.ndarray, light: np.ndarray, w: float) -> np.ndarray:
        oc = self.centre - p
        ahead = dot(oc, light)
        distance = np.sqrt(np.maximum(dot(oc, oc) - ahead * ahead, 0))
        result = np.ones(len(p), np.float32)
        near = (ahead > -self.size) & (distance < self.size + w * np.maximum(ahead, 0))
        live = np.flatnonzero(near)
        q, dl = self.local(p), self.shape_R_world @ light
        t = np.maximum(ahead - self.size, 0.02).astype(np.float32)
        for _ in range(24):
            if not len(live):
                break
            gap = self.distance(q[live] + t[live, None] * dl)
            seen = np.clip(0.5 + 0.5 * gap / (np.float32(w) * t[live]), 0, 1)
            result[live] = np.minimum(result[live], seen * seen * (3 - 2 * seen))
            t[live] += np.clip(gap, 0.015, 0.15)
            live = live[(t[live] < ahead[live] + self.size) & (result[live] > 0.003)]
        return result


Shape = Sphere | Rod | Disc | Implicit


def torus_distance(ring: float, tube: float) -> Callable[[np.ndarray], np.ndarray]:
    """Signed distance of a torus about z: ring the radius of its centre line, tube that of its cross-section."""
    return lambda q: np.hypot(np.hypot(q[:, 0], q[:, 1]) - np.float32(ring), q[:, 2]) - np.float32(tube)


def box_distance(half: np.ndarray, rounding: float) -> Callable[[np.ndarray], np.ndarray]:
    """Signed distance of a box of these half sides with its edges rounded."""

    def distance(q: np.ndarray) -> np.ndarray:
        beyond = np.abs(q) - (half - np.float32(rounding))
        outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
        return outside + np.minimum(beyond.max(axis=-1), 0) - np.float32(rounding)

    return distance
