"""The procedural scene: deterministic, inside its box, and glossy."""

from __future__ import annotations

import numpy as np
import pytest

from tools.procedural import ARRANGEMENTS, picture, spread_cameras, still_life
from tools.procedural.__main__ import procedural
from tools.procedural.shading import Material, Thing, coverage
from tools.procedural.shapes import Disc, Implicit, Rod, Sphere, dot, torus_distance
from tools.procedural.tracing import trace
from training.scenes import load_scene

CAMERA = spread_cameras(12, 32, 0.0)[4]


def test_the_same_seed_draws_the_same_picture_and_another_seed_another_one():
    first = picture(still_life(0), CAMERA, 1)
    np.testing.assert_array_equal(first, picture(still_life(0), CAMERA, 1))
    assert np.abs(first.astype(int) - picture(still_life(1), CAMERA, 1)).max() > 50


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


def test_glass_is_composited_over_what_is_behind_it_and_over_nothing():
    """Along one ray: two panes, and a ball that is not of glass behind them or not."""
    eye, ahead = np.zeros((1, 3), np.float32), np.array([[0.0, 1.0, 0.0]], np.float32)
    panes = [
        Thing(Sphere(np.array([0, y, 0], np.float32), 0.2), Material(np.full(3, c, np.float32), f0=0.04, opacity=0.4))
        for y, c in ((2.0, 0.2), (3.0, 0.6))
    ]
    ball = Thing(Sphere(np.array([0, 5, 0], np.float32), 0.5), Material(np.array([0.7, 0.1, 0.1], np.float32)))
    hidden = float(coverage(panes[0].material, np.array([[0.0, -1.0, 0.0]]), -ahead)[0])
    assert hidden == pytest.approx(0.4 + 0.6 * 0.04)
    one, both = trace(panes[:1], eye, ahead)[0], trace(panes, eye, ahead)[0]
    assert one[3] == pytest.approx(hidden) and both[3] == pytest.approx(1 - (1 - hidden) ** 2)
    whole = trace([*panes, ball], eye, ahead)[0]
    assert whole[3] == pytest.approx(1.0)
    behind = (whole[:3] - both[:3]) / (1 - hidden) ** 2
    assert behind[0] > behind[1] + 0.1, "the ball is seen through both"
    covered = trace([Thing(panes[0].shape, Material(panes[0].material.colour(eye)[0], f0=0.04)), ball], eye, ahead)[0]
    assert covered[3] == 1 and np.abs(covered[:3] - whole[:3]).max() > 0.02


def test_glass_and_wires_stress_what_they_are_for():
    glass, wires = (picture(ARRANGEMENTS[name](0), CAMERA, 2)[..., 3] for name in ("glass", "wires"))
    half = (glass > 40) & (glass < 215)
    inside = half[1:-1, 1:-1] & half[:-2, 1:-1] & half[2:, 1:-1] & half[1:-1, :-2] & half[1:-1, 2:]
    assert inside.any(), "more than edges let light through"
    rods = [thing.shape.radius for thing in ARRANGEMENTS["wires"](0) if isinstance(thing.shape, Rod)]
    across_400 = max(rods) * 2 * 400 / (2 * 4.03 * np.tan(0.5 * 0.6911112))
    assert len(rods) > 150 and across_400 < 2.5, "pixels"
    assert np.mean((wires > 0) & (wires < 255)) > 2 * np.mean((glass > 0) & (glass < 255) & ~half)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["glass", "wires"])
def test_the_program_writes_each_arrangement(name, tmp_path):
    procedural(tmp_path / "a", scene=name, size=16, views=2, subpixels=1)
    assert {split: len(views) for split, views in load_scene(tmp_path / "a").splits.items()} == {"train": 2, "test": 2}
    procedural(tmp_path / "b", size=16, views=2, subpixels=1)
    drawn = [load_scene(tmp_path / folder).splits["train"][0].load() for folder in "ab"]
    assert not np.array_equal(*drawn), "it is not the demo's"
