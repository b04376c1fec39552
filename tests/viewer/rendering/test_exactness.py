"""Every marcher but `paper` gives the picture that taking every sample gives (docs/rendering.md, "Marchers")."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from console import UserError
from scenepack import Pack, load_pack
from tests.reference_marcher import render_reference
from tests.scenepack.random_packs import packs, random_pack
from tests.viewer.rendering.pictures import assert_exact, assert_same_picture
from tests.viewer.rendering.shapes import BALL, FLOOR, SKY
from training.scenes.lens import MODELS
from viewer.features.measuring.surface import surface_at
from viewer.rendering.camera import ViewCamera, is_mirrored, ray_through
from viewer.rendering.layers import depth_along_axis, unit_normals
from viewer.rendering.settings import Mode, RenderSettings

SIZE = (40, 30)
LENSES = {
    "fisheye": MODELS["THIN_PRISM_FISHEYE"].lens({"k1": -0.03, "k3": 0.0005, "p1": 0.002, "s1": -0.001}),
    "panorama": MODELS["EQUIRECTANGULAR"].lens({}),
    "rational": MODELS["FULL_OPENCV"].lens(
        {"k1": 0.09, "k3": 0.01, "p2": -0.004, "q1": 0.03, "q2": -0.01, "q3": 0.002}
    ),
    "opencv": (0.09, -0.03, 0.004, -0.006),
    "folding over": (-0.9, 0.0, 0.0, 0.0),  # shows nothing beyond 0.41 from its axis
}


def random_camera(rng: np.random.Generator, pack: Pack) -> ViewCamera:
    """Outside, close by or within the grid; now and then along an axis, or grazing a face."""
    high = np.asarray(pack.grid_size) * pack.voxel_size
    kind = rng.choice(["outside", "inside", "axis", "grazing"])
    target = pack.min_xyz + high * rng.uniform(0.2, 0.8, 3)
    if kind == "inside":
        eye = pack.min_xyz + high * rng.uniform(0.05, 0.95, 3)
    elif kind == "outside":
        eye = target + rng.normal(size=3) * rng.choice([1.0, 4.0])
    else:
        axis = rng.integers(3)
        step = np.zeros(3)
        step[axis] = rng.choice([-3.0, 3.0])
        if kind == "grazing":  # along a face of the grid, a hundredth of a voxel inside of it
            side = (axis + 1) % 3
            near = 0.01 * pack.voxel_size
            target[side] = pack.min_xyz[side] + rng.choice([near, high[side] - near])
        eye = target + step
    # An odd number of pixels has its middle one look exactly along the axis.
    size = (SIZE[0] + 1, SIZE[1] + 1) if kind in ("axis", "grazing") else SIZE
    up = (0.0, 1.0, 0.0) if abs(eye[1] - target[1]) < 2.9 else (0.0, 0.0, 1.0)
    return ViewCamera.look_at(eye, target, up, float(rng.choice([8.0, 45.0, 95.0])), size, mirrored=is_mirrored(pack))


def forward_facing_camera(rng: np.random.Generator) -> ViewCamera:
    """Somewhere around where photographs of an NDC scene are taken, also past the warp's near plane."""
    eye = np.array([*rng.uniform(-0.5, 0.5, 2), rng.choice([-0.3, 0.0, 0.5, 1.5])])
    ahead = eye + np.array([*rng.uniform(-1.0, 1.0, 2), 4.0])
    return ViewCamera.look_at(eye, ahead, fov_degrees=55, size=SIZE, mirrored=True)


@settings(max_examples=10, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], print_blob=True)
@given(pack=packs(ndc=None), seed=st.integers(0, 2**32 - 1))
def test_exact_is_every_sample_on_random_packs_from_anywhere_whatever_is_cut_off(offscreen, pack: Pack, seed: int):
    rng, renderer = np.random.default_rng(seed), offscreen(pack)
    high = np.asarray(pack.grid_size) * pack.voxel_size
    corners = pack.min_xyz + high * np.sort(rng.uniform(0, 1, (2, 3)), axis=0)
    crop = (tuple(corners[0].tolist()), tuple(corners[1].tolist()))
    wanted = RenderSettings(crop=crop, near=float(rng.uniform(0, 1.5)), background=(0.2, 0.0, 0.7))
    camera = forward_facing_camera(rng) if pack.ndc else random_camera(rng, pack)
    if not pack.ndc and rng.random() < 0.4:
        # all of the grid is seen by parallel rays, or a part of it from amid the grid
        camera = camera.as_orthographic(high.max() * float(rng.choice([0.3, 1.8])))
    assert_exact(renderer, camera)
    assert_exact(renderer, camera, wanted)
    assert_exact(renderer, replace(camera, ray_near=float(rng.uniform(0, 1.5))), replace(wanted, near=0.0))


@pytest.mark.parametrize("block_size", [5, 15])
def test_block_sizes_that_cells_do_not_divide_lose_nothing(offscreen, block_size: int) -> None:
    rng = np.random.default_rng(block_size)
    pack = random_pack(rng, block_size=block_size, grid_blocks=(3, 2, 3), style="borders", occupancy=0.05)
    renderer = offscreen(pack)
    for _ in range(3):
        assert_exact(renderer, random_camera(rng, pack))


@pytest.mark.parametrize("ndc", [False, True])
def test_diffuse_features_and_alpha_modes_show_what_the_reference_accumulates(request, offscreen, ndc):
    pack: Pack = request.getfixturevalue("ndc_shapes" if ndc else "shapes")
    camera = forward_facing_camera(np.random.default_rng(3)) if ndc else ViewCamera.orbit(pack, 40, size=SIZE)
    reference = render_reference(pack, camera)
    renderer = offscreen(pack)
    expected: dict[Mode, np.ndarray] = {
        "diffuse": reference.diffuse,
        "features": reference.features[..., :3],
        "alpha": np.repeat(reference.alpha[..., None], 3, axis=2),
    }
    for mode, picture in expected.items():
        for marcher in ("brute", "exact"):
            shown = renderer.render_float(camera, RenderSettings(mode=mode, marcher=marcher))
            assert_same_picture(shown, picture, f"{mode} by {marcher}")


@pytest.mark.parametrize("name", LENSES)
def test_every_lens_sees_the_same_rays(shapes: Pack, offscreen, name: str) -> None:
    camera = ViewCamera.orbit(shapes, 40, 20, 1.0, 60, SIZE)
    focal = SIZE[0] / (2 * np.pi if name == "panorama" else 3.4)  # a fisheye that sees more than a half space
    focal = camera.fx if name == "opencv" else focal  # which is not defined that far from the axis
    assert_exact(offscreen(shapes), replace(camera, fx=focal, fy=focal, distortion=LENSES[name]))


def test_a_lens_bends_the_same_rays_of_a_forward_facing_pack_which_has_no_orthographic_view(offscreen, ndc_shapes):
    camera = forward_facing_camera(np.random.default_rng(3))
    assert_exact(offscreen(ndc_shapes), replace(camera, distortion=LENSES["opencv"]))
    with pytest.raises(UserError, match="no orthographic view"):
        offscreen(ndc_shapes).render(camera.as_orthographic(2.0))


def test_a_pack_made_elsewhere_matches_the_reference(offscreen, real_data) -> None:
    pack = load_pack(real_data / "packs/flowerbangle_480")
    renderer = offscreen(pack)
    for azimuth, elevation, distance in ((200, 60, 0.9), (95, 2, 0.35)):
        assert_exact(renderer, ViewCamera.orbit(pack, azimuth, elevation, distance, size=(48, 36)))


# Contracted packs: every marcher against the reference, and depth, normals and framing of known things


VOXEL = 4.0 / 128  # of the fixture, in contracted space
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
    "lens": replace(inside, distortion=LENSES["opencv"]),
    "photograph": replace(outside, ray_near=2.0, near=0.5),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_exact_takes_every_sample(offscreen, surroundings: Pack, name: str) -> None:
    renderer, blue = offscreen(surroundings), RenderSettings(background=(0.2, 0.0, 0.7))
    assert_exact(renderer, CAMERAS[name], RenderSettings(), name)
    assert_exact(renderer, CAMERAS[name], replace(blue, surroundings=False), f"{name}, inner")
    crop = ((-0.9, -0.83, -1.4), (1.7, 0.4, 0.9))  # no face lies on the floor, where a sample may be on either side
    assert_exact(renderer, CAMERAS[name], replace(blue, crop=crop, near=0.4), f"{name}, cut")


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
            inner = surface_at(surroundings, camera, RenderSettings(surroundings=False), x + 0.5, y + 0.5)
            assert inner is None or np.abs(inner.point).max() <= 1.001
            turned.append(np.degrees(np.arccos(np.clip(normals[y, x] @ normal, -1, 1))))
            checked, farthest = checked + 1, max(farthest, w)
    assert checked > 30 and farthest > 3
    assert np.median(turned) < 8
