"""Contracted packs (docs/rendering.md): every marcher against the reference, and depth, normals and framing of known things."""

from dataclasses import replace

import numpy as np
import pytest

from scenepack.pack import Pack
from tests.scenepack.random_packs import random_pack
from tests.viewer.rendering.pictures import assert_exact
from tests.viewer.rendering.shapes import BALL, FLOOR, SKY
from tests.viewer.scenes import with_cameras
from viewer.core.pose import project
from viewer.features.camera.orbit_camera import view_from_within
from viewer.features.measuring.surface import surface_at
from viewer.rendering.camera import ViewCamera, ray_through
from viewer.rendering.layers import depth_along_axis, unit_normals
from viewer.rendering.settings import RenderSettings

SIZE = (40, 30)
VOXEL = 4.0 / 128  # of the fixture, in contracted space
LENS = (0.09, -0.03, 0.004, -0.006)

inside = ViewCamera.look_at((0.5, 0.3, 0.9), (1.75, -0.1, -0.9), fov_degrees=75, size=SIZE)
outside = ViewCamera.look_at((-6.0, 2.5, 5.0), (0.0, 0.0, 0.0), fov_degrees=60, size=SIZE)
CAMERAS = {
    "inside": inside,
    "outside": outside,
    "far away": ViewCamera.look_at((3.0, 15.0, -9.0), (0.0, 0.0, 0.0), fov_degrees=25, size=SIZE),
    "along an axis": ViewCamera.look_at((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), fov_degrees=60, size=(41, 31)),
    "on a side of the cube": ViewCamera.look_at((1.0, 0.0, 0.0), (1.0, 0.0, 1.0), fov_degrees=60, size=(41, 31)),
    "orthographic": ViewCamera.look_at((-3.0, 2.0, 3.0), (0.0, 0.0, 0.0), size=SIZE).as_orthographic(4.0),
    "orthographic from within": inside.as_orthographic(1.0),
    "lens": replace(inside, distortion=LENS),
    "photograph": replace(outside, ray_near=2.0, near=0.5),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_exact_takes_every_sample(offscreen, surroundings: Pack, name: str) -> None:
    renderer = offscreen(surroundings)
    assert_exact(renderer, CAMERAS[name], RenderSettings(), name)
    background = (0.2, 0.0, 0.7)
    assert_exact(renderer, CAMERAS[name], RenderSettings(surroundings=False, background=background), f"{name}, inner")


def test_crop_box_and_near_plane_keep_it_exact(offscreen, surroundings: Pack) -> None:
    wanted = RenderSettings(crop=((-0.9, -0.8, -1.4), (1.7, 0.4, 0.9)), near=0.4, background=(0.2, 0.0, 0.7))
    for name in ("inside", "outside"):
        assert_exact(offscreen(surroundings), CAMERAS[name], wanted, name)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_exact_takes_every_sample_of_random_packs(offscreen, seed: int) -> None:
    """Cubes of any size, in the middle of the grid or not; part of the grid may lie beyond infinity."""
    rng = np.random.default_rng(seed)
    pack = random_pack(rng, grid_blocks=(3, 3, 2), style=str(rng.choice(["noise", "borders", "mixed", "blob"])))
    pack = replace(pack, min_xyz=pack.min_xyz + rng.uniform(-0.3, 0.3, 3))
    renderer = offscreen(pack.with_metadata(contraction=float(rng.uniform(0.3, 0.9))))
    for reach in (0.3, 2.0, 9.0):
        camera = ViewCamera.look_at(reach * rng.normal(size=3), rng.uniform(-0.3, 0.3, 3), fov_degrees=80, size=SIZE)
        assert_exact(renderer, camera, RenderSettings(), f"from {reach}")


@pytest.mark.parametrize("name", ["inside", "outside"])
def test_the_paper_marcher_comes_close(offscreen, surroundings: Pack, name: str) -> None:
    camera = CAMERAS[name].resized(96, 72)
    paper = offscreen(surroundings).render_float(camera, RenderSettings(marcher="paper"))
    exact = offscreen(surroundings).render_float(camera)
    assert 22 < -10 * np.log10(np.mean((paper - exact) ** 2)) < 60


def known_distance(point: np.ndarray, ray: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Of the floor, the ball and the sky, the nearest: its distance along a ray, unit normal, and |x|∞ there."""
    found = []
    t = (FLOOR - point[1]) / ray[1]
    if t > 0:
        found.append((t, np.array([0.0, 1.0, 0.0])))
    for centre, radius, outwards in ((np.array(BALL[:3]), BALL[3], 1.0), (np.zeros(3), SKY, -1.0)):
        towards = point - centre
        half, rest = float(towards @ ray), float(towards @ towards) - radius**2
        if half * half > rest:
            t = -half - outwards * np.sqrt(half * half - rest)
            if t > 0:
                found.append((t, outwards * (towards + t * ray) / radius))
    t, normal = min(found, key=lambda each: each[0])
    return t, normal, float(np.abs(point + t * ray).max())


@pytest.mark.parametrize("name", ["inside", "outside", "orthographic", "lens", "photograph"])
def test_depth_normals_and_picked_points_are_those_of_space(offscreen, surroundings: Pack, name: str) -> None:
    camera = CAMERAS[name].resized(120, 90)
    renderer = offscreen(surroundings)
    depth = depth_along_axis(renderer.render_raw(camera, RenderSettings(mode="depth", raw=True)), camera, surroundings)
    normals = unit_normals(renderer.render_raw(camera, RenderSettings(mode="normals", raw=True)))
    hidden = RenderSettings(crop=((-0.96, FLOOR + 0.05, -0.96), (0.96, 0.96, 0.96)), mode="alpha")
    shapes_there = renderer.render_float(camera, hidden)[..., 0] > 0.0
    checked, farthest, turned = 0, 0.0, []
    for y in range(2, 90, 7):
        for x in range(2, 120, 7):
            start, ray = ray_through(camera, x + 0.5, y + 0.5)
            if shapes_there[y, x]:
                continue
            t, normal, w = known_distance(start, ray)
            ahead = float(ray @ -camera.grid_T_camera[:3, 2])
            if -(ray @ normal) < 0.3 or w > 12:
                continue
            # A voxel of contracted space is up to w^2 voxels long.
            loose = 2.0 * VOXEL * max(w, 1.0) ** 2 / -(ray @ normal)
            assert abs(depth[y, x] / ahead - t) < loose, (x, y)
            hit = surface_at(surroundings, camera, RenderSettings(), x + 0.5, y + 0.5)
            assert hit is not None and abs(hit.distance - t) < loose, (x, y)
            np.testing.assert_allclose(hit.point, start + hit.distance * ray)
            turned.append(np.degrees(np.arccos(np.clip(normals[y, x] @ normal, -1, 1))))
            checked, farthest = checked + 1, max(farthest, w)
    assert checked > 30 and farthest > 3
    assert np.median(turned) < 8


def test_what_is_picked_lies_where_it_is_seen(surroundings: Pack) -> None:
    top = np.array(BALL[:3]) + BALL[3] * np.array([-0.6, 0.48, 0.64])
    (pixel,), _ = project(outside, top[None])
    hit = surface_at(surroundings, outside, RenderSettings(), *pixel)
    assert hit is not None and np.linalg.norm(hit.point - top) < 0.3
    without = surface_at(surroundings, outside, RenderSettings(surroundings=False), *pixel)
    assert without is None or np.abs(without.point).max() <= 1.001


def test_the_viewer_begins_amid_the_photographs_wherever_they_were_taken(surroundings: Pack) -> None:
    """A contracted pack surrounds its cameras, unlike one of an object."""
    views = [ViewCamera.orbit(surroundings, azimuth, distance=5.0) for azimuth in (0, 20, 40)]
    amid = with_cameras(surroundings, views)
    first = view_from_within(amid)
    assert first is not None and np.allclose(first.position, views[1].position)
    assert view_from_within(amid.with_metadata(contraction=None)) is None
