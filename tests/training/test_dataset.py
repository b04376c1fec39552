"""Rays: NumPy and JAX agree, lenses are undone, the NDC warp is NeRF's. Pixels: too many or too big to be careless with."""

import dataclasses
import mmap
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from console import Notice, collect_notices
from tests.training.reconstructions import ndc_points
from training import dataset as datasets
from training.dataset import MOST_RAYS, OPAQUE, evenly_spread, make_dataset, row_step_for
from training.marching import GridBox, to_grid
from training.method import Rays
from training.multires.fused import rays as fused
from training.recorder import render_photograph
from training.scenes import Camera, Photograph, Scene, load_pixels, pixels
from training.scenes import scene as numpy_rays
from training.scenes.lens import MODELS
from training.scenes.pictures import PictureLoader, as_floats, decoded, shrink

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
    rays, colours = jax.jit(lambda d, ids: (d.geometry_at(ids), d.colours_at(ids)))(dataset, jnp.arange(dataset.count))
    for one, other in zip(rays, dataset.view_rays(camera), strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5)
    assert colours.shape == (1200, 3)


def test_colours_are_composited_over_the_background():
    dataset = make_dataset(scene_of(looking_down(), background=(0.0, 1.0, 0.0)))
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
    with collect_notices() as notices:
        make_dataset(scene)
    assert notices == ([f"here: {OPAQUE}"] if opaque else []) and "is trained and baked with it" in OPAQUE


@pytest.mark.parametrize("most, side", [(None, 48), (48 * 48, 48), (2000, 24), (300, 16), (1, 1)])
def test_of_a_large_photograph_some_pixels_are_compared_and_none_is_shrunk(scene, dataset, most, side):
    camera = scene.splits["test"][0].camera

    def render(state: Any, rays: Rays) -> SimpleNamespace:
        return SimpleNamespace(rgb=0.5 + 0.5 * np.sin(40 * np.asarray(rays.viewdirs)))  # the colour of its direction

    picture = render(None, dataset.view_rays(camera)).rgb.reshape(camera.height, camera.width, 3)
    opaque = np.concatenate([picture, np.ones_like(picture[..., :1])], -1)
    photograph: Any = SimpleNamespace(camera=camera, load=lambda: opaque)
    method: Any = SimpleNamespace(render=render)
    rendered, truth = render_photograph(method, None, dataset, photograph, most)
    assert rendered.shape == truth.shape == (side, side, 3) and picture.std() > 0.3
    np.testing.assert_allclose(rendered, truth, atol=1e-6)


@pytest.fixture(scope="module")
def big(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A JPEG of 6 megapixels."""
    path = tmp_path_factory.mktemp("big") / "a.jpg"
    ramp = np.add.outer(np.arange(2000) // 8, np.arange(3000) // 12).astype(np.uint8)
    Image.fromarray(np.stack([ramp, ramp.T.reshape(2000, 3000), 255 - ramp], axis=-1)).save(path, quality=60)
    return path


@pytest.mark.parametrize(("size", "most"), [((3000, 2000), 8), ((1500, 1000), 16), ((601, 401), 40)])
def test_a_big_photograph_is_decoded_without_floats_of_all_of_it(big: Path, size: tuple[int, int], most: int) -> None:
    load = PictureLoader(big, (3000, 2000), size)
    tracemalloc.start()
    found = load.pixels()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < most * 6e6  # as floats of four channels: 16 bytes a pixel, and again for each operation
    expected = np.rint(shrink(as_floats(decoded(big)), *size) * 255)[..., :3]
    assert found.dtype == np.uint8 and found.shape == (*size[::-1], 3)
    apart = np.abs(found - expected)
    assert apart.max() <= 1 and apart.mean() < 1e-4, "halves may round apart where bands weigh cells that they share"
    assert size == (601, 401) or not apart.any()


def test_opaque_photographs_are_never_held_with_alpha(big: Path, scene: Scene) -> None:
    photograph = scene.splits["train"][0]
    camera = dataclasses.replace(photograph.camera, width=3000, height=2000)
    opaque = Photograph("a", camera, PictureLoader(big, (3000, 2000), (3000, 2000)))
    large = dataclasses.replace(scene, splits={"train": (opaque,)})
    assert not pixels.may_be_transparent([opaque]) and pixels.may_be_transparent([photograph])
    tracemalloc.start()
    dataset = make_dataset(large)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert dataset.pixels.shape == (6_000_000, 3) and peak < 12 * 6e6
    photograph = dataclasses.replace(photograph, load=lambda: np.ones((48, 48, 4), np.float32))
    dataset = make_dataset(dataclasses.replace(scene, splits={"train": (photograph,) * 2}))
    assert dataset.pixels.shape == (2 * 48 * 48, 3), "alpha that is 1 everywhere is left out, too"


def in_a_file(array: np.ndarray) -> bool:
    base = array
    while isinstance(base, np.ndarray) and base.base is not None:
        base = base.base
    return isinstance(base, mmap.mmap)


def test_photographs_that_memory_does_not_hold_lie_in_a_file_of_the_run(scene, tmp_path, monkeypatch):
    photographs, size = scene.splits["train"], 12 * 48 * 48 * 4
    in_memory = load_pixels(photographs, folder=tmp_path / "run")
    assert not in_a_file(in_memory) and not (tmp_path / "run").exists()
    monkeypatch.setattr(pixels, "free_memory", lambda: 2 * size)
    on_disk = load_pixels(photographs, folder=tmp_path / "run")
    assert in_a_file(on_disk) and np.array_equal(on_disk, in_memory)
    assert not list((tmp_path / "run").iterdir()), "the file has no name, and is gone with the process"
    dataset = make_dataset(scene, folder=tmp_path / "run")
    assert np.array_equal(np.asarray(dataset.pixels), in_memory)


def test_more_pixels_than_ids_are_thinned_out_by_rows_and_a_line_says_so(scene: Scene) -> None:
    photograph = scene.splits["train"][0]
    camera = dataclasses.replace(photograph.camera, width=4000, height=3000)
    many = (dataclasses.replace(photograph, camera=camera),) * 300
    large = dataclasses.replace(scene, splits={"train": many})
    with pytest.warns(Notice, match=r"3,600,000,000 pixels .* one row in 2 .* --downscale 2"):
        step = row_step_for(large)
    assert pixels.pixel_counts([p.camera for p in many], step).sum() == 1_800_000_000 < MOST_RAYS
    assert row_step_for(scene) == 1


@pytest.mark.slow
def test_rays_of_thinned_photographs_go_through_the_pixels_whose_colours_they_have(scene, monkeypatch):
    whole = make_dataset(scene)
    monkeypatch.setattr(datasets, "MOST_RAYS", whole.count // 5 + 1000)
    with pytest.warns(Notice, match="one row in 5"):
        thin = make_dataset(scene)
    assert thin.count == 12 * 48 * 10
    ids = np.random.default_rng(0).integers(0, thin.count, 200).astype(np.int32)
    view, rest = ids // (48 * 10), ids % (48 * 10)
    there = (view * 48 * 48 + rest // 48 * 5 * 48 + rest % 48).astype(np.int32)
    rays, colours = thin.geometry_at(jnp.asarray(ids)), thin.colours_at(jnp.asarray(ids))
    expected, truth = whole.geometry_at(jnp.asarray(there)), whole.colours_at(jnp.asarray(there))
    for found, wanted in zip((*rays, colours), (*expected, truth), strict=True):
        np.testing.assert_array_equal(np.asarray(found), np.asarray(wanted))

    low, high = scene.aabb
    layout = GridBox(jnp.asarray(low, np.float32), jnp.asarray((high - low) / 8, np.float32), jnp.full(3, 8))
    batch = fused.empty_batch(len(ids), 0.0)
    batch.background[:] = thin.background
    fused.fill_batch(fused.photographs_of(thin), ids.astype(np.int64), np.float64(low), np.float64((high - low) / 8),
                     np.array([8, 8, 8], np.int32), batch, 0, len(ids))  # fmt: skip
    np.testing.assert_allclose(batch.directions, to_grid(layout, expected).directions, atol=1e-5)
    np.testing.assert_allclose(batch.target, truth, atol=1e-6)
