"""Lens models: COLMAP's show points where pycolmap does; transforms.json names the same; all engines cast the same rays."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pycolmap
import pytest

from tests.training.reconstructions import FLIP, LENSES, SIZE, ball, write_colmap
from tests.training.test_captures import circle, write_transforms
from tests.training.test_dataset import scene_of
from training.dataset import make_dataset
from training.multires.fused.rays import _through_lens
from training.scenes.colmap_files import read_reconstruction
from training.scenes.lens import (
    EQUIRECTANGULAR,
    FISHEYE,
    MODELS,
    REACH,
    directions_at,
    image_of,
    projection_of,
    whole_lens,
)
from training.scenes.read import load_scene
from training.scenes.scene import Camera, camera_rays, pixels_of, shown_pixels
from training.scenes.transforms import read_camera

KEYS = {"q1": "k4", "q2": "k5", "q3": "k6", "s1": "sx1", "s2": "sy1", "f": "fl_x", "fx": "fl_x", "fy": "fl_y"}


def as_transforms(model: str) -> dict[str, object]:
    """The keys of transforms.json for one of LENSES."""
    named = dict(zip(MODELS[model].parameters, LENSES[model], strict=True))
    if model != "FULL_OPENCV" and "s1" not in named:
        named = {name: value for name, value in named.items() if not name.startswith(("q", "s"))}
    return {"camera_model": model, "w": SIZE[0], "h": SIZE[1]} | {KEYS.get(k, k): v for k, v in named.items()}


@pytest.mark.parametrize("model", MODELS)
def test_points_are_seen_where_colmap_sees_them(tmp_path: Path, model: str):
    points = ball(60, radius=2.5)  # up to the corners of the pictures
    found = read_reconstruction(write_colmap(tmp_path, circle(3), points, (model,)) / "sparse/0")
    lens = pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=LENSES[model])
    seen = 0
    for camera in found.cameras:
        local = (points - camera.world_T_camera[:3, 3]) @ camera.world_T_camera[:3, :3] @ FLIP[:3, :3]
        ahead = local[:, 2] > 0.3
        expected = np.array([lens.img_from_cam(one) for one in local[ahead]])
        pixels, shown = pixels_of(camera, points[ahead])
        np.testing.assert_allclose(pixels[shown], expected[shown], atol=1e-9)
        seen += shown.sum()
        origins, directions = camera_rays(camera, *expected[shown].T)
        away = points[ahead][shown] - origins
        np.testing.assert_allclose(directions, away / np.linalg.norm(away, axis=-1, keepdims=True), atol=1e-9)
        again = read_camera(np.eye(4), as_transforms(model), SIZE, "here")
        assert again.distortion == pytest.approx(camera.distortion)
    assert seen > 60


@pytest.mark.parametrize("model", ["OPENCV_FISHEYE", "THIN_PRISM_FISHEYE", "EQUIRECTANGULAR"])
def test_lenses_that_see_behind_themselves_show_all_directions_once(model: str):
    lens = MODELS[model].lens(dict(zip(MODELS[model].parameters, LENSES[model], strict=True)))
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    u, v, shown = image_of(directions, lens)
    shown &= np.arccos(-directions[:, 2]) < 0.9 * whole_lens(lens)[REACH]  # where it folds over, nothing is exact
    assert (shown & (directions[:, 2] > 0.1)).any() and (shown.all() or projection_of(lens) == FISHEYE)
    np.testing.assert_allclose(directions_at(u[shown], v[shown], lens), directions[shown], atol=1e-6)


@pytest.mark.parametrize("model", ["PINHOLE", "FULL_OPENCV", "THIN_PRISM_FISHEYE", "EQUIRECTANGULAR"])
def test_the_compiled_engine_casts_the_same_rays(model: str):
    lens = MODELS[model].lens(dict(zip(MODELS[model].parameters, LENSES[model], strict=True)))
    for u, v in ((0.0, 0.0), (0.3, -0.4), (-0.6, 0.2)):
        expected = directions_at(np.array(u), np.array(v), lens)
        *direction, shown = _through_lens(u, v, np.array(whole_lens(lens)))
        np.testing.assert_allclose(direction, expected, atol=1e-6)
        assert shown


def test_where_a_lens_shows_nothing_rays_end_at_once_in_training_and_in_evaluation():
    lens = MODELS["OPENCV_FISHEYE"].lens({"k1": -0.2})  # the picture ends at 1.29 from the axis, with 0.86
    camera = Camera(np.eye(4), 40, 40, 20.0, 20.0, 20.0, 20.0, lens)
    y, x = np.mgrid[:40, :40] + 0.5
    radius = np.hypot(x - 20, y - 20) / 20
    shown = shown_pixels(camera)
    assert shown[radius < 0.84].all() and not shown[radius > 0.87].any()
    dataset = make_dataset(scene_of(camera))
    for rays in (dataset.geometry_at(jnp.arange(1600)), dataset.view_rays(camera)):
        ends_at_once = np.asarray(rays.near >= rays.far).reshape(40, 40)
        assert ends_at_once[radius > 0.87].all() and not ends_at_once[radius < 0.84].any()


def test_a_panorama_is_read_whatever_focal_length_is_named_and_is_fisheye_is_opencvs(tmp_path: Path):
    panorama = write_transforms(tmp_path / "a", circle(9), size=SIZE, lens={}, camera_model="EQUIRECTANGULAR", fl_x=7)
    fisheye = write_transforms(tmp_path / "b", circle(9), size=SIZE, lens={}, is_fisheye=True, fl_x=20)
    for path, projection, fx in ((panorama, EQUIRECTANGULAR, SIZE[0] / (2 * np.pi)), (fisheye, FISHEYE, 20)):
        for downscale in (1, 2):
            camera = load_scene(path, downscale=downscale).splits["train"][0].camera
            assert projection_of(camera.distortion) == projection and camera.fx == pytest.approx(fx / downscale)
