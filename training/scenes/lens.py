"""Lenses: one definition of every lens model, for NumPy, JAX and Numba.

Notation: (x, y, z) a direction in camera axes (OpenGL: y up, z back). (a, b) image coordinates of an ideal lens, y down; with
t the angle from the optical axis, and f the angle around it:

    0  perspective      (a, b) = tan t (cos f, sin f) = (x, -y) / -z
    1  fisheye          (a, b) = t (cos f, sin f)
    2  equirectangular  (a, b) = longitude and latitude (down), radians

(u, v) the same as the lens made them, r^2 = a^2 + b^2:

    radial = (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) / (1 + q1 r^2 + q2 r^4 + q3 r^6)
    u = a radial + 2 p1 a b + p2 (r^2 + 2 a^2) + s1 r^2
    v = b radial + p1 (r^2 + 2 b^2) + 2 p2 a b + s2 r^2

A lens shows nothing where r is beyond its reach, above and below the poles of a panorama, and where Newton's method finds no
(a, b). A lens is (k1, k2, p1, p2), where it is perspective and needs no more, or (*COEFFICIENTS, number of the projection).
MODELS has COLMAP's models as such lenses: OpenCV's k4, k5, k6 of FULL_OPENCV are q1, q2, q3 here.
"""

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from scenepack.cameras import EQUIRECTANGULAR, FISHEYE, LENS_SIZE, PERSPECTIVE, projection_of

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "q1", "q2", "q3", "s1", "s2")
PROJECTION, REACH = LENS_SIZE - 1, LENS_SIZE  # where these stand in whole_lens
TOLERANCE = 1e-3  # of (u, v): where Newton's method stops farther away, the lens shows nothing
NEWTON_STEPS = 10
NO_END = 1e6  # how far a lens reaches that never folds over
POLE = 1.5707964  # of a panorama, above and below which it shows nothing
FOLDS = 1e-6  # a determinant squared, below which a step of Newton's method goes nowhere

Lens = tuple[float, ...]
NO_DISTORTION: Lens = (0.0, 0.0, 0.0, 0.0)


class Model(NamedTuple):
    """The parameters of a lens model by name, in COLMAP's order; "f" is both focal lengths."""

    projection: int
    parameters: tuple[str, ...]

    def lens(self, values: Mapping[str, float]) -> Lens:
        """The lens with these coefficients, those that are not named 0."""
        whole = tuple(float(values.get(name, 0.0)) for name in COEFFICIENTS)
        return (*whole, float(self.projection)) if self.projection or any(whole[4:]) else whole[:4]

    def intrinsics(self, values: Mapping[str, float], width: float, height: float) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy of a picture of that size; a panorama shows all directions, whatever is named."""
        if self.projection == EQUIRECTANGULAR:
            return width / (2.0 * np.pi), height / np.pi, 0.5 * width, 0.5 * height
        fx = values["f"] if "f" in values else values["fx"]
        return fx, values.get("fy", fx), values["cx"], values["cy"]


MODELS = {
    name: Model(projection, tuple(parameters.split()))
    for name, projection, parameters in (
        ("SIMPLE_PINHOLE", PERSPECTIVE, "f cx cy"),
        ("PINHOLE", PERSPECTIVE, "fx fy cx cy"),
        ("SIMPLE_RADIAL", PERSPECTIVE, "f cx cy k1"),
        ("RADIAL", PERSPECTIVE, "f cx cy k1 k2"),
        ("OPENCV", PERSPECTIVE, "fx fy cx cy k1 k2 p1 p2"),
        ("FULL_OPENCV", PERSPECTIVE, "fx fy cx cy k1 k2 p1 p2 k3 q1 q2 q3"),
        ("SIMPLE_FISHEYE", FISHEYE, "f cx cy"),
        ("FISHEYE", FISHEYE, "fx fy cx cy"),
        ("SIMPLE_RADIAL_FISHEYE", FISHEYE, "f cx cy k1"),
        ("RADIAL_FISHEYE", FISHEYE, "f cx cy k1 k2"),
        ("OPENCV_FISHEYE", FISHEYE, "fx fy cx cy k1 k2 k3 k4"),
        ("THIN_PRISM_FISHEYE", FISHEYE, "fx fy cx cy k1 k2 p1 p2 k3 k4 s1 s2"),
        ("EQUIRECTANGULAR", EQUIRECTANGULAR, "w h"),
    )
}


class LensFunctions(NamedTuple):
    """Functions of arrays of any shape, or, compiled by Numba, of numbers. lens: such arrays, or numbers, of whole_lens."""

    distort: Callable[..., Any]  # (a, b, lens) -> (u, v)
    # (u, v, lens, steps) -> (a, b, whether the lens shows them), by Newton's method from (u, v)
    undistort: Callable[..., Any]
    direction: Callable[..., Any]  # (a, b, projection) -> (x, y, z): of perspective z = -1, else of unit length
    ideal: Callable[..., Any]  # (x, y, z, projection) -> (a, b)


def lens_functions(xp: ModuleType = np, compiled: Callable[[Any], Any] | None = None) -> LensFunctions:
    """The same functions for another array library (xp), or compiled for numbers."""
    where = xp.where if compiled is None else compiled(lambda condition, yes, no: yes if condition else no)
    compiled = compiled or (lambda function: function)

    @compiled
    def radial(r2, lens):
        over = 1.0 + r2 * (lens[0] + r2 * (lens[1] + r2 * (lens[4] + r2 * lens[5])))
        under = 1.0 + r2 * (lens[6] + r2 * (lens[7] + r2 * lens[8]))
        over_slope = lens[0] + r2 * (2.0 * lens[1] + r2 * (3.0 * lens[4] + r2 * 4.0 * lens[5]))
        under_slope = lens[6] + r2 * (2.0 * lens[7] + r2 * 3.0 * lens[8])
        ratio = over / under
        return ratio, 2.0 * (over_slope - ratio * under_slope) / under

    @compiled
    def distort(a, b, lens):
        r2 = a * a + b * b
        ratio, _ = radial(r2, lens)
        u = a * ratio + 2.0 * lens[2] * a * b + lens[3] * (r2 + 2.0 * a * a) + lens[9] * r2
        v = b * ratio + lens[2] * (r2 + 2.0 * b * b) + 2.0 * lens[3] * a * b + lens[10] * r2
        return u, v

    @compiled
    def undistort(u, v, lens, steps):
        p1, p2, s1, s2 = lens[2], lens[3], lens[9], lens[10]
        a, b, du, dv = u, v, 0.0 * u, 0.0 * v
        for _ in range(steps):
            ratio, slope = radial(a * a + b * b, lens)
            at_u, at_v = distort(a, b, lens)
            du, dv = at_u - u, at_v - v
            ua = ratio + a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a + 2.0 * s1 * a
            vb = ratio + b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a + 2.0 * s2 * b
            across = a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b
            ub, va = across + 2.0 * s1 * b, across + 2.0 * s2 * a
            determinant = ua * vb - ub * va
            step = determinant / (determinant * determinant + FOLDS)  # where the lens folds over, stay
            a, b = a - step * (vb * du - ub * dv), b - step * (ua * dv - va * du)
        known = (du * du + dv * dv < TOLERANCE**2) & (a * a + b * b < lens[REACH] * lens[REACH])
        return a, b, known & (abs(b) <= where(lens[PROJECTION] == EQUIRECTANGULAR, POLE, NO_END))

    @compiled
    def direction(a, b, projection):
        t = xp.sqrt(a * a + b * b)
        around = xp.sinc(t / np.pi)
        is_fisheye, is_flat = projection == FISHEYE, projection == PERSPECTIVE
        x = where(is_flat, a, where(is_fisheye, around * a, xp.sin(a) * xp.cos(b)))
        y = where(is_flat, -b, where(is_fisheye, -around * b, -xp.sin(b)))
        z = where(is_flat, -1.0, -where(is_fisheye, xp.cos(t), xp.cos(a) * xp.cos(b)))
        return x, y, z

    @compiled
    def ideal(x, y, z, projection):
        aside = xp.sqrt(x * x + y * y)
        of_fisheye, of_flat = xp.arctan2(aside, -z) / xp.maximum(aside, 1e-12), 1.0 / where(z < 0.0, -z, 1.0)
        scale = where(projection == FISHEYE, of_fisheye, of_flat)
        is_round = projection == EQUIRECTANGULAR
        a = where(is_round, xp.arctan2(x, -z), scale * x)
        return a, where(is_round, -xp.arctan2(y, xp.sqrt(x * x + z * z)), -scale * y)

    return LensFunctions(distort, undistort, direction, ideal)


NUMPY = lens_functions()


def whole_lens(lens: Lens) -> Lens:
    """A lens by all its LENS_SIZE numbers, and its reach: up to which r what is farther out is seen farther out, the smallest
    root of d(r radial)/dr; NO_END where there is none."""
    k1, k2, _, _, k3, k4, q1, q2, q3, *_ = whole = (*lens, *(0.0,) * (LENS_SIZE - len(lens)))
    over, under = np.poly1d([k4, 0, k3, 0, k2, 0, k1, 0, 1, 0]), np.poly1d([q3, 0, q2, 0, q1, 0, 1])
    roots = [*under.roots, *(over.deriv() * under - over * under.deriv()).roots]
    ends = [float(root.real) for root in roots if abs(root.imag) < 1e-9 and root.real > 0]
    return (*whole, min([*ends, np.pi if projection_of(lens) == FISHEYE else NO_END]))


def shows(u: np.ndarray, v: np.ndarray, lens: Lens) -> np.ndarray:
    """Whether a lens shows anything at (u, v): bool, any shape."""
    return NUMPY.undistort(np.asarray(u, np.float64), np.asarray(v, np.float64), whole_lens(lens), NEWTON_STEPS)[2]


def directions_at(u: np.ndarray, v: np.ndarray, lens: Lens) -> np.ndarray:
    """Directions float64 [..., 3] in camera axes of what a lens shows at (u, v); of a perspective lens one unit deep."""
    a, b = np.asarray(u, np.float64), np.asarray(v, np.float64)
    if any(lens[:PROJECTION]):
        a, b, _ = NUMPY.undistort(a, b, whole_lens(lens), NEWTON_STEPS)
    return np.stack(NUMPY.direction(a, b, projection_of(lens)), axis=-1)


def image_of(directions: np.ndarray, lens: Lens) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(u, v) at which a lens shows directions [..., 3] in camera axes, and whether it shows them at all."""
    x, y, z = np.moveaxis(directions, -1, 0)
    projection, whole = projection_of(lens), whole_lens(lens)
    a, b = NUMPY.ideal(x, y, z, projection)
    shown = np.hypot(a, b) < whole[REACH]
    return *NUMPY.distort(a, b, whole), shown & (z < -1e-6) if projection == PERSPECTIVE else shown
