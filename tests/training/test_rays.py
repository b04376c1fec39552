"""Rays of cameras: NumPy and JAX agree, lenses are undone, the NDC warp is NeRF's."""

import dataclasses
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from console import Notice
from tests.training.reconstructions import ndc_points
from training.dataset import evenly_spread, make_dataset
from training.method import Rays
from training.recorder import render_photograph
from training.scenes import Camera, Photograph, Scene
from training.scenes import scene as numpy_rays
from training.scenes.lens import MODELS

LENS = (0.08, -0.03, 0.002, -0.001)
FISHEYE = MODELS["THIN_PRISM_FISHEYE"].lens({"k1": -0.03, "k3": 0.002, "p1": 0.002, "s1": -0.001})
PANORAMA = MODELS["EQUIRECTANGULAR"].lens({})


def looking_down(distortion=(0.0, 0.0, 0.0, 0.0)) -> Camera:
    return Camera(np.eye(4), 40, 30, 35.0, 36.0, 19.0, 16.0, distortion)


def scene_of(camera: Camera, **changes) -> Scene:
    pixels = np.random.default_rng(0).random((camera.height, camera.width, 4)).astype(np.float32)
    photograph = Photograph("only", camera, lambda: pixels)
    box = np.array([[-1.0] * 3, [1.0] * 3])
    scene = Scene(2.0, 6.0, box, np.eye(4), path=Path("here"), kind="made", splits={"train": (photograph,)})
    return dataclasses.replace(scene, **changes)


@pytest.mark.parametrize("changes", [{}, {"ndc_camera": (40, 30, 35.0), "ndc": True, "near": 0.0, "far": 1.0}])
@pytest.mark.parametrize("lens", [(0.0, 0.0, 0.0, 0.0), LENS, FISHEYE, PANORAMA])
def test_rays_of_training_pixels_are_those_of_the_view(lens, changes):
    camera = looking_down(lens)
    dataset = make_dataset(scene_of(camera, **changes))
    rays, colours = jax.jit(lambda d, ids: d.rays_at(ids))(dataset, jnp.arange(dataset.count))
    for one, other in zip(rays, dataset.view_rays(camera), strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5)
    assert colours.shape == (1200, 3)


def test_a_batch_comes_from_its_key_alone_and_is_composited_over_the_background():
    dataset = make_dataset(scene_of(looking_down(), background=(0.0, 1.0, 0.0)))
    rays, rgb = dataset.batch(jax.random.key(3), 64)
    again, rgb_again = dataset.batch(jax.random.key(3), 64)
    np.testing.assert_array_equal(rgb, rgb_again)
    np.testing.assert_array_equal(rays.directions, again.directions)
    assert rays.origins.shape == (64, 3) and rgb.shape == (64, 3)
    every = dataset.colours_at(jnp.zeros(1, jnp.int32))
    red, green, _, alpha = np.asarray(dataset.pixels[0]) / 255
    np.testing.assert_allclose(every[0, :2], [red * alpha, green * alpha + 1 - alpha], atol=1e-6)


@pytest.mark.parametrize("size, count", [(1, 1), (100, 97), (3000, 952_560), (60_000, 64_000_000), (1000, 2**31 - 1)])
def test_evenly_spread_numbers_leave_no_wide_gaps(size: int, count: int) -> None:
    some = np.sort(evenly_spread(2**40 + 3, size, count).astype(np.int64))
    assert 0 <= some[0] <= some[-1] < count
    assert np.diff(some, append=some[0] + count).max() <= 2.7 * count / size + 1  # random ones: ln(size) times the mean


def test_ndc_rays_start_at_the_near_plane_and_reach_the_far_end_at_one():
    camera = looking_down()
    origins, directions = numpy_rays.camera_rays(camera)
    warped, along = numpy_rays.ndc_rays(origins, directions, 40, 30, 35.0)
    np.testing.assert_allclose(warped[..., 2], -1)
    np.testing.assert_allclose((warped + along)[..., 2], 1)
    # a point on the original ray lies on the warped one, at t' = 1 - near / depth
    depth = 7.0
    points = origins + directions * (depth / -directions[..., 2:])
    expected = warped + (1 - 1 / depth) * along
    np.testing.assert_allclose(ndc_points(points, 40, 30, 35.0), expected, atol=1e-9)
    o, d = numpy_rays.ndc_rays(jnp.asarray(origins), jnp.asarray(directions), 40, 30, 35.0, xp=jnp)
    np.testing.assert_allclose(o, warped, atol=1e-5)
    np.testing.assert_allclose(d, along, atol=1e-5)


@pytest.mark.parametrize("opaque", [True, False])
def test_a_blender_scene_without_alpha_is_told_to_be_trained_with_its_background(opaque: bool) -> None:
    camera = looking_down()
    pixels = np.ones((camera.height, camera.width, 4), np.float32)
    pixels[0, 0, 3] = 1.0 if opaque else 0.0
    scene = scene_of(camera, kind="blender", splits={"train": (Photograph("only", camera, lambda: pixels),)})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make_dataset(scene)
    assert [str(warning.message) for warning in caught if issubclass(warning.category, Notice)] == (
        ["here: the pictures have no alpha; what is behind the object counts as part of the scene and is trained and "
         "baked with it"] if opaque else []
    )  # fmt: skip


class Seer:
    """A method that knows what every ray shows: the colour of its direction."""

    def render(self, state: Any, rays: Rays) -> SimpleNamespace:
        return SimpleNamespace(rgb=0.5 + 0.5 * np.sin(40 * np.asarray(rays.viewdirs)))


@pytest.mark.parametrize("most, side", [(None, 48), (48 * 48, 48), (2000, 24), (300, 16), (1, 1)])
def test_of_a_large_photograph_some_pixels_are_compared_and_none_is_shrunk(procedural_scene, most, side):
    dataset, camera = make_dataset(procedural_scene), procedural_scene.splits["test"][0].camera
    picture = Seer().render(None, dataset.view_rays(camera)).rgb.reshape(camera.height, camera.width, 3)
    opaque = np.concatenate([picture, np.ones_like(picture[..., :1])], -1)
    photograph: Any = SimpleNamespace(camera=camera, load=lambda: opaque)
    rendered, truth = render_photograph(Seer(), None, dataset, photograph, most)  # type: ignore[arg-type]
    assert rendered.shape == truth.shape == (side, side, 3) and picture.std() > 0.3
    np.testing.assert_allclose(rendered, truth, atol=1e-6)
