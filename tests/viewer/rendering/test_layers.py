"""Depth, normals and opacity as numbers, and looks, measured where geometry and colours are known by formula."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenepack.volumes import PLANE, centres, plane_pack, solid_pack
from tests.viewer.rendering.shapes import shapes_pack
from viewer.rendering.camera import ViewCamera, orbit_path
from viewer.rendering.layers import depth_along_axis, linear_rgb, straight_rgba, unit_normals
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import Backdrop, Look, RenderSettings

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


DARK = (0.1, 0.2, 0.3)


def looked(colour: np.ndarray, look: Look) -> np.ndarray:
    """sRGB [..., 3] with a look."""
    light = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4) * look.gain
    grey = light @ np.array([0.2126, 0.7152, 0.0722])
    light = np.clip(grey[..., None] + look.saturation * (light - grey[..., None]), 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(
    ("kind", "look"),
    [("shapes", Look(-2.0, 0.7, -0.4)), ("shapes", Look(saturation=0.0)), ("ndc_shapes", Look(0.3, -1.0, 1.0, 2.0))],
)
def test_a_look_changes_opaque_colours_by_the_formula_and_leaves_the_background_alone(request, offscreen, kind, look):
    pack = request.getfixturevalue(kind)
    renderer = offscreen(pack)
    camera = ViewCamera.look_at((0, 0, 0), (0.2, 0.1, 4), mirrored=True) if pack.ndc else ViewCamera.orbit(pack, 35)
    camera = camera.resized(96, 72)
    for mode in ("normal", "diffuse"):
        plain = RenderSettings(mode=mode, background=DARK)
        before, after = (renderer.render_float(camera, each) for each in (plain, replace(plain, look=look)))
        alpha = renderer.render_float(camera, RenderSettings(mode="alpha"))[..., 0]
        solid, empty = alpha > 0.996, alpha == 0
        off = np.abs(after[solid] - looked(before[solid], look))
        assert solid.mean() > 0.05 and off.max() < 0.016  # 1/255 of the light is left
        assert np.array_equal(after[empty], before[empty])
    for mode in ("depth", "alpha", "macroblocks", "features"):
        shown = [renderer.render(camera, RenderSettings(mode=mode, look=each)) for each in (None, look)]
        assert np.array_equal(*shown)


def test_the_plain_look_changes_nothing_what_lies_behind_has_none_and_a_transparent_picture_has_it(shapes, offscreen):
    renderer, camera = offscreen(shapes), ViewCamera.orbit(shapes, 35, size=(96, 72))
    plain = RenderSettings(background=DARK)
    same = np.abs(renderer.render_float(camera, plain) - renderer.render_float(camera, replace(plain, look=Look())))
    assert same.max() < 2e-3
    wanted = replace(plain, look=Look(1.0, 0.5), backdrop=Backdrop("gradient", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    before, after = (renderer.render(camera, each) for each in (replace(wanted, look=None), wanted))
    empty = renderer.render(camera, RenderSettings(mode="alpha"))[..., 0] == 0
    assert np.array_equal(before[empty], after[empty]) and np.abs(before.astype(int) - after).mean() > 5
    wanted = RenderSettings(look=Look(-0.5, 0.5, 0.0, 1.2))
    rgba = straight_rgba(renderer.render_raw(camera, replace(wanted, raw=True))).astype(float) / 255
    over = rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]
    off = 255 * np.abs(over - renderer.render_float(camera, wanted))
    assert np.percentile(off, 99) < 2
