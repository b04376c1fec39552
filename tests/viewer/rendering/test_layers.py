"""Depth, normals and opacity as numbers, measured on scenes whose geometry is known by formula."""

import numpy as np
import pytest

from tests.scenepack.volumes import PLANE, centres, plane_pack, solid_pack
from tests.viewer.rendering.shapes import shapes_pack
from viewer.rendering.camera import ViewCamera, orbit_path
from viewer.rendering.layers import depth_along_axis, linear_rgb, straight_rgba, unit_normals
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

SIDE = 56
RADIUS, GREY = 0.6, (127, 127, 127)


def seen(
    renderer: OffscreenRenderer, camera: ViewCamera, samples: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth [h, w], normals [h, w, 3] and opacity [h, w]."""
    depth = renderer.render_raw(camera, RenderSettings(mode="depth", raw=True, samples=samples))
    normals = renderer.render_raw(camera, RenderSettings(mode="normals", raw=True, samples=samples))
    return depth_along_axis(depth, camera, renderer.pack), unit_normals(normals), depth[..., 3]


def unprojected(depth: np.ndarray, camera: ViewCamera) -> np.ndarray:
    """Points [h, w, 3] in the camera's grid frame, by a pinhole camera and depth along the axis."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    in_camera = np.stack([(x - camera.cx) / camera.fx, -(y - camera.cy) / camera.fy, -np.ones_like(x)], -1)
    return (in_camera * depth[..., None]) @ camera.grid_T_camera[:3, :3].T + camera.position


@pytest.mark.parametrize("samples", [1, 3])
def test_depth_unprojects_onto_the_ball_that_was_drawn_and_normals_point_out_of_it(offscreen, samples):
    x, y, z = centres(SIDE)
    renderer = offscreen(solid_pack((RADIUS - np.sqrt(x**2 + y**2 + z**2)) * SIDE / 2, GREY))
    camera = ViewCamera.look_at((0.9, 1.1, 1.6), (0.1, 0, 0), (0, 1, 0), 60, (64, 48))
    depth, normals, alpha = seen(renderer, camera, samples)
    points = unprojected(depth, camera)
    # Rays that graze the ball see its haze rather than its surface.
    rays = camera.position - points
    facing = np.sum(points * rays, -1) / np.maximum(np.linalg.norm(rays, axis=-1), 1e-9)
    solid = (alpha > 0.98) & (facing > 0.5 * RADIUS)
    assert solid.sum() > 200
    distance = np.linalg.norm(points[solid], axis=-1)
    assert np.abs(distance - RADIUS).max() < 2 / SIDE  # a voxel
    cosine = np.sum(normals[solid] * points[solid], -1) / distance
    assert cosine.min() > 0.95
    empty = alpha == 0
    assert empty.any() and not depth[empty].any() and not normals[empty].any()


def test_forward_facing_packs_have_the_depth_and_the_normals_of_the_world_that_was_warped(offscreen) -> None:
    (n, d), pack = PLANE, plane_pack(SIDE, GREY)
    camera = orbit_path(pack, 1, 40, (60, 44))[0]
    depth, normals, alpha = seen(offscreen(pack), camera)
    solid = alpha > 0.98
    assert solid.mean() > 0.5
    points = unprojected(depth, camera)[solid] @ pack.worldspace_T_opengl[:3, :3].T
    off = np.abs(points @ n - d) / np.linalg.norm(n)
    assert np.median(off) < 0.05 and np.percentile(off, 95) < 0.12  # a voxel there is 0.1 deep
    facing = normals[solid] @ (pack.worldspace_T_opengl[:3, :3].T @ n) / np.linalg.norm(n)
    assert np.median(facing) > 0.99


def test_the_view_mlp_sees_the_background_that_is_left_out(offscreen) -> None:
    """What it adds was learnt over a background, so that over the same one nothing changes but what no opacity can hold."""
    renderer = offscreen(shapes_pack())
    camera = ViewCamera.orbit(renderer.pack, 30, size=(80, 60))
    raw = renderer.render_raw(camera, RenderSettings(raw=True))
    over = raw[..., :3] + (1 - raw[..., 3:])
    away = np.abs(over - renderer.render_float(camera))[raw[..., 3] > 0.99]
    assert away.max() < 0.01
    assert np.all(raw[..., :3] <= raw[..., 3:] + 1e-6) and raw.min() >= 0


def test_light_is_decoded_before_opacity_is_multiplied_in() -> None:
    raw = np.array([[[0.25, 0.5, 0.0, 0.5]]], np.float32)
    assert np.allclose(linear_rgb(raw), [[[0.5 * 0.21404114, 0.5, 0.0]]], atol=1e-6)
    assert straight_rgba(raw).tolist() == [[[128, 255, 0, 128]]]
