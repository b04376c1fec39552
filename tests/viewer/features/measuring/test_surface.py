"""Points on surfaces: on a scene of known sizes they lie where the sizes say, to a fraction of a voxel."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from scenepack import Pack
from tests.scenepack.volumes import cube_pack
from tests.viewer.conftest import toy_pack
from viewer.core.pose import project
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.measuring.surface import surface_at
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

SIDE, BLOCK = 64, 14
VOXEL = 2.0 / SIDE
LOW, HIGH = np.array([11, 9, 17]), np.array([52, 31, 47])  # voxels of the block's corners
SIZE = (800, 600)


def block_pack() -> Pack:
    """A solid block of known corners in the box of -1 … 1."""
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    (x0, y0, z0), (x1, y1, z1) = LOW, HIGH
    rgba[z0:z1, y0:y1, x0:x1] = (160, 90, 60, 255)
    return cube_pack(rgba, BLOCK)


def corner(*high: int) -> np.ndarray:
    """A corner of the block, grid frame: 1 for its far side along an axis."""
    return -1.0 + VOXEL * np.where(high, HIGH, LOW)


@pytest.fixture(scope="module")
def block() -> Pack:
    return block_pack()


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 70), (33, 12), (150, 35), (245, 35)])
def test_on_a_face_a_point_lies_on_it_from_any_side(block: Pack, azimuth: float, elevation: float) -> None:
    camera = ViewCamera.orbit(block, azimuth, elevation, size=SIZE)
    rng, faces = np.random.default_rng(3), 0
    for axis, side in itertools.product(range(3), range(2)):
        outwards = np.eye(3)[axis] * (2 * side - 1)
        middle = 0.5 * (corner(0, 0, 0) + corner(1, 1, 1))
        middle[axis] = corner(1, 1, 1)[axis] if side else corner(0, 0, 0)[axis]
        towards = camera.position - middle
        if towards @ outwards < 0.4 * np.linalg.norm(towards):
            continue
        faces += 1
        for share in rng.uniform(-0.4, 0.4, (6, 3)):
            target = middle + share * (corner(1, 1, 1) - corner(0, 0, 0)) * (np.arange(3) != axis)
            hit = surface_at(block, camera, RenderSettings(), *project(camera, target[None])[0][0])
            assert hit is not None
            assert np.linalg.norm(hit.point - target) < 0.2 * VOXEL
            assert hit.distance == pytest.approx(np.linalg.norm(target - camera.position), abs=0.2 * VOXEL)
    assert faces >= 1


def test_crop_and_near_plane_hide_what_they_hide_in_the_picture(block: Pack) -> None:
    camera = ViewCamera.look_at((0.0, 0.0, 4.0), (0.0, -0.4, 0.0), size=SIZE)
    hit = surface_at(block, camera, RenderSettings(), 400.0, 300.0)
    assert hit is not None and abs(hit.point[2] - corner(1, 1, 1)[2]) < 0.2 * VOXEL
    cut = RenderSettings(crop=((-1.0, -1.0, -1.0), (1.0, 1.0, 0.1)))
    hit = surface_at(block, camera, cut, 400.0, 300.0)
    assert hit is not None and abs(hit.point[2] - 0.1) < 0.6 * VOXEL
    hit = surface_at(block, camera, RenderSettings(near=4.2), 400.0, 300.0)
    assert hit is not None and hit.distance >= 4.2 - 1e-9
    assert surface_at(block, camera, RenderSettings(near=9.0), 400.0, 300.0) is None


@pytest.mark.parametrize("ndc", [False, True])
def test_there_is_a_surface_where_the_renderer_draws_something(ctx, ndc: bool) -> None:
    pack = toy_pack(ndc=ndc, view_mlp=False)
    camera = orbit_camera_for(pack).camera((96, 72))
    with OffscreenRenderer(pack, ctx=ctx) as renderer:
        alpha = renderer.render_float(camera, RenderSettings(mode="alpha"))[..., 0]
    met = 0
    for y, x in itertools.product(range(2, 72, 7), range(2, 96, 7)):
        hit = surface_at(pack, camera, RenderSettings(), x + 0.5, y + 0.5)
        if alpha[y, x] > 0.98 or alpha[y, x] < 0.02:
            assert (hit is not None) == (alpha[y, x] > 0.5)
        if hit is not None:
            met += 1
            assert np.allclose(project(camera, hit.point[None])[0][0], (x + 0.5, y + 0.5), atol=1e-3)
    assert met > 10


def test_a_forward_facing_point_is_found_again_from_elsewhere() -> None:
    pack = toy_pack(ndc=True, view_mlp=False)
    rig = orbit_camera_for(pack)
    camera = rig.camera((400, 300))
    hit = surface_at(pack, camera, RenderSettings(), 190.0, 170.0)
    assert hit is not None
    moved = camera.grid_T_camera.copy()
    moved[:3, 3] += (0.05, 0.02, 0.0)
    other = replace(camera, grid_T_camera=moved)
    (x, y), (ahead,) = project(other, hit.point[None])[0][0], project(other, hit.point[None])[1]
    again = surface_at(pack, other, RenderSettings(), float(x), float(y))
    assert ahead and again is not None
    assert np.linalg.norm(again.point - hit.point) < 0.1 * hit.distance
