"""Pixels of photographs that are too many or too big to be careless with."""

import dataclasses
import mmap
import tracemalloc
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from console import Notice
from training import dataset as datasets
from training.dataset import MOST_RAYS, make_dataset, row_step_for
from training.marching import GridBox, to_grid
from training.scenes import Photograph, Scene, load_pixels, pixels
from training.scenes.pictures import PictureLoader, as_floats, decoded, shrink


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


def test_opaque_photographs_are_never_held_with_alpha(big: Path, procedural_scene: Scene) -> None:
    photograph = procedural_scene.splits["train"][0]
    camera = dataclasses.replace(photograph.camera, width=3000, height=2000)
    opaque = Photograph("a", camera, PictureLoader(big, (3000, 2000), (3000, 2000)))
    scene = dataclasses.replace(procedural_scene, splits={"train": (opaque,)})
    assert not pixels.may_be_transparent([opaque]) and pixels.may_be_transparent([photograph])
    tracemalloc.start()
    dataset = make_dataset(scene)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert dataset.pixels.shape == (6_000_000, 3) and peak < 12 * 6e6
    photograph = dataclasses.replace(photograph, load=lambda: np.ones((48, 48, 4), np.float32))
    dataset = make_dataset(dataclasses.replace(procedural_scene, splits={"train": (photograph,) * 2}))
    assert dataset.pixels.shape == (2 * 48 * 48, 3), "alpha that is 1 everywhere is left out, too"


def in_a_file(array: np.ndarray) -> bool:
    base = array
    while isinstance(base, np.ndarray) and base.base is not None:
        base = base.base
    return isinstance(base, mmap.mmap)


def test_photographs_that_memory_does_not_hold_lie_in_a_file_of_the_run(procedural_scene, tmp_path, monkeypatch):
    photographs, size = procedural_scene.splits["train"], 12 * 48 * 48 * 4
    in_memory = load_pixels(photographs, folder=tmp_path / "run")
    assert not in_a_file(in_memory) and not (tmp_path / "run").exists()
    monkeypatch.setattr(pixels, "free_memory", lambda: 2 * size)
    on_disk = load_pixels(photographs, folder=tmp_path / "run")
    assert in_a_file(on_disk) and np.array_equal(on_disk, in_memory)
    assert not list((tmp_path / "run").iterdir()), "the file has no name, and is gone with the process"
    dataset = make_dataset(procedural_scene, folder=tmp_path / "run")
    assert np.array_equal(np.asarray(dataset.pixels), in_memory)


def test_more_pixels_than_ids_are_thinned_out_by_rows_and_a_line_says_so(procedural_scene: Scene) -> None:
    photograph = procedural_scene.splits["train"][0]
    camera = dataclasses.replace(photograph.camera, width=4000, height=3000)
    many = (dataclasses.replace(photograph, camera=camera),) * 300
    scene = dataclasses.replace(procedural_scene, splits={"train": many})
    with pytest.warns(Notice, match=r"3,600,000,000 pixels .* one row in 2 .* --downscale 2"):
        step = row_step_for(scene)
    assert pixels.pixel_counts([p.camera for p in many], step).sum() == 1_800_000_000 < MOST_RAYS
    assert row_step_for(procedural_scene) == 1


def test_rays_of_thinned_photographs_go_through_the_pixels_whose_colours_they_have(procedural_scene, monkeypatch):
    whole = make_dataset(procedural_scene)
    monkeypatch.setattr(datasets, "MOST_RAYS", whole.count // 5 + 1000)
    with pytest.warns(Notice, match="one row in 5"):
        thin = make_dataset(procedural_scene)
    assert thin.count == 12 * 48 * 10
    ids = np.random.default_rng(0).integers(0, thin.count, 200).astype(np.int32)
    view, rest = ids // (48 * 10), ids % (48 * 10)
    there = (view * 48 * 48 + rest // 48 * 5 * 48 + rest % 48).astype(np.int32)
    (rays, colours), (expected, truth) = thin.rays_at(jnp.asarray(ids)), whole.rays_at(jnp.asarray(there))
    for found, wanted in zip((*rays, colours), (*expected, truth), strict=True):
        np.testing.assert_array_equal(np.asarray(found), np.asarray(wanted))

    fused = pytest.importorskip("training.multires.fused.rays", reason="pip install 'snerg[train]'")
    low, high = procedural_scene.aabb
    layout = GridBox(jnp.asarray(low, np.float32), jnp.asarray((high - low) / 8, np.float32), jnp.full(3, 8))
    batch = fused.empty_batch(len(ids), 0.0)
    batch.background[:] = thin.background
    fused.fill_batch(fused.photographs_of(thin), ids.astype(np.int64), np.float64(low), np.float64((high - low) / 8),
                     np.array([8, 8, 8], np.int32), batch, 0, len(ids))  # fmt: skip
    np.testing.assert_allclose(batch.directions, to_grid(layout, expected).directions, atol=1e-5)
    np.testing.assert_allclose(batch.target, truth, atol=1e-6)
