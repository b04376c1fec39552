"""Which photographs are used, and which pairs are matched."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from tests.training.posing.rooms import texture
from training.posing.photograph import read_photograph, sharpness, thumbnail
from training.posing.prepare import blurred, repeated


def test_a_blurred_picture_is_told_from_plain_ones_and_from_pictures_of_other_things():
    walls = [texture(seed)[:200, :300].mean(axis=-1) / 255 for seed in range(12)]
    walls[4] = (
        np.asarray(Image.fromarray((walls[4] * 255).astype(np.uint8)).filter(ImageFilter.GaussianBlur(3))) / 255.0
    )
    walls[7] = walls[7] * 0.2 + 0.5  # little contrast is no blur
    moved = np.cumsum(walls[9], axis=1)
    walls[9] = np.pad(
        (moved[:, 16:] - moved[:, :-16]) / 16, ((0, 0), (0, 16)), mode="edge"
    )  # nor a sharp edge sharpness
    assert [i for i, bad in enumerate(blurred([sharpness(wall) for wall in walls])) if bad] == [4, 9]
    assert not any(blurred([1.0] * 6 + [0.05] * 6))  # half of them: these show something else


def test_repeated_pictures_are_set_aside_and_similar_ones_are_not():
    wall = texture(0).mean(axis=-1) / 255
    views = [wall[:300, :400], wall[:300, :400] + 0.002, wall[:300, 4:404]]
    assert repeated(["a", "b", "c"], [thumbnail(view) for view in views]) == [None, 0, None]
    assert repeated(["a", "b", "a"], [thumbnail(wall[i * 9 :]) for i in range(3)]) == [None, None, 0]


def test_pictures_of_one_lens_share_a_camera_and_exif_says_its_focal_length(tmp_path: Path):
    for name, focal in (("a", 26), ("b", 26), ("c", 52)):
        exif = Image.Exif()
        exif[0x010F], exif[0x0110] = "Make", "Model"
        exif.get_ifd(0x8769)[0xA405] = focal
        Image.new("RGB", (120, 90)).save(tmp_path / f"{name}.jpg", exif=exif)
    a, b, c = (read_photograph(tmp_path / f"{name}.jpg") for name in "abc")
    assert a.camera == b.camera != c.camera
    assert a.focal == pytest.approx(26 * 150 / 43.27, rel=1e-3) and c.focal == pytest.approx(2 * a.focal)


def test_few_pictures_are_all_matched_and_of_many_those_that_look_alike(monkeypatch: pytest.MonkeyPatch):
    """A walk once around something: its end looks like its beginning."""
    pytest.importorskip("pycolmap", reason="matching needs pycolmap (the extra poses)")
    from training.posing import mapping

    monkeypatch.setattr(mapping, "LARGEST", 50)
    overlap, all_pairs, chosen_pairs = mapping.OVERLAP, mapping.all_pairs, mapping.chosen_pairs
    count, rng = 60, np.random.default_rng(0)
    world = rng.integers(0, 256, (count * 10, 128), np.uint8)
    around = np.concatenate([world, world])
    descriptors = [around[10 * i : 10 * i + 50] for i in range(count)]
    pairs = set(chosen_pairs(descriptors))
    assert {(i, i + step) for i in range(count - overlap) for step in range(1, overlap + 1)} <= pairs
    assert {(0, count - 1), (1, count - 2)} <= pairs  # which are far from one another in their order
    assert len(pairs) <= mapping.how_many_pairs(count) and mapping.how_many_pairs(50) == len(all_pairs(50))
    assert len(pairs) < 0.6 * len(all_pairs(count)) and all(i < j for i, j in pairs)
    assert chosen_pairs([np.zeros((0, 128), np.uint8)] * 3)  # nothing to see, but neighbours
