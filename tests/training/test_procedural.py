"""The procedural scene: deterministic, inside its box, and glossy."""

from __future__ import annotations

import numpy as np
import pytest

from training.scenes.procedural import picture, spread_cameras, still_life
from training.scenes.procedural.shapes import Disc, Implicit, Rod, Sphere, dot, torus_distance

CAMERA = spread_cameras(12, 32, 0.0)[4]


def test_the_same_seed_draws_the_same_picture_and_another_seed_another_one():
    first = picture(still_life(0), CAMERA, 1)
    np.testing.assert_array_equal(first, picture(still_life(0), CAMERA, 1))
    assert np.abs(first.astype(int) - picture(still_life(1), CAMERA, 1)).max() > 50


def test_everything_lies_within_a_cube_of_1_3():
    for thing in still_life(0) + still_life(5):
        centre, radius = thing.shape.bound
        if isinstance(thing.shape, Disc):
            assert thing.shape.radius < 1.3 and thing.shape.bottom > -1.3
        elif isinstance(thing.shape, Rod):
            assert np.abs([thing.shape.a, thing.shape.b]).max() + thing.shape.radius < 1.3
        else:
            assert (np.abs(centre) + radius < 1.3).all()


def test_the_background_is_transparent_and_edges_are_smooth():
    drawn = picture(still_life(0), CAMERA, 3)
    alpha = drawn[..., 3]
    assert (alpha == 0).any() and (alpha == 255).any() and ((alpha > 0) & (alpha < 255)).any()


@pytest.mark.parametrize(
    "shape",
    [
        Sphere(np.array([0.1, 0.2, 0.3], np.float32), 0.5),
        Rod(np.array([0, 0, -0.4], np.float32), np.array([0.2, 0.1, 0.4], np.float32), 0.2),
        Disc(0.8, -0.2, 0.1),
        Implicit(np.zeros(3, np.float32), np.eye(3, dtype=np.float32), 0.7, torus_distance(0.4, 0.2)),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_rays_hit_shapes_on_their_surface_facing_the_eye(shape):
    rng = np.random.default_rng(0)
    eye = np.array([0.5, -2.0, 1.5], np.float32)
    d = rng.uniform(-0.4, 0.4, (400, 3)).astype(np.float32) - eye
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = np.broadcast_to(eye, d.shape)
    t = shape.hit(o, d)
    hit = np.isfinite(t)
    assert 0.2 < hit.mean() <= 1
    p = o[hit] + t[hit, None] * d[hit]
    n = shape.normal(p)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-2)
    assert (dot(n, d[hit]) < 1e-2).mean() > 0.99
    # a little before the hit lies outside every surface: a ray from there hits again right away
    again = shape.hit(p - 0.05 * d[hit], d[hit])
    np.testing.assert_allclose(again, 0.05, atol=5e-3)


def test_light_is_full_in_the_open_and_gone_behind_a_ball():
    ball = Sphere(np.array([0, 0, 1], np.float32), 0.5)
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 0, 3]], np.float32)
    np.testing.assert_allclose(ball.lit(points, np.array([0, 0, 1], np.float32), 0.1), [0, 1, 1], atol=1e-6)
