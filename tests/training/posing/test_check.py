"""The check of photographs: spoilt versions of a capture come out worse, and what to take again is named."""

import json
import shutil
from collections.abc import Callable
from math import comb
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from baker.commands.make import main as snerg_make
from console import Notice, UserError
from tests.training.posing.rooms import cameras, photograph, texture
from training.posing import mapping
from training.posing.check import Verdict, check
from training.posing.photograph import read_photograph, sharpness
from training.posing.prepare import blurred
from training.scenes.sources import require_source

COUNT, DARK, STRANGER = 12, 5, 12


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Verdict, str]]:
    """Verdicts and pages of a capture and of spoilt versions of it."""
    good = [Image.fromarray(photograph(camera)) for camera in cameras(COUNT)]
    blurred = [picture.filter(ImageFilter.GaussianBlur(2)) for picture in good]
    jumping = [picture.point(lambda value: int(value * 0.45)) if i % 2 else picture for i, picture in enumerate(good)]
    odd = [picture.point(lambda value: int(value * 0.6)) if i == DARK else picture for i, picture in enumerate(good)]
    odd.append(Image.fromarray(photograph(cameras(3)[1], walls=7)))
    versions = {"good": good, "blurred": blurred, "third": good[::3], "jumping": jumping, "odd": odd}
    found = {}
    for name, pictures in versions.items():
        folder = tmp_path_factory.mktemp(name)
        for i, picture in enumerate(pictures):
            picture.save(folder / f"p{i:02d}.png")
        if name == "third":
            shutil.copy(folder / "p00.png", folder / "q\n\x1b[7m.png")
        page = folder / "out/check.html"
        found[name] = check(require_source(folder), page, 60), page.read_text()
    return found


def figures_of(captures: dict[str, tuple[Verdict, str]], name: str, figure: str) -> np.ndarray:
    return np.array([photograph[figure] for photograph in captures[name][0].figures["photographs"]])


@pytest.mark.slow
def test_spoilt_versions_of_a_capture_come_out_worse(captures: dict[str, tuple[Verdict, str]]):
    found = {name: verdict.figures for name, (verdict, _) in captures.items()}
    good = found["good"]
    assert not captures["good"][0].retake and good["connected"] == 1
    assert all(found[name]["expected_psnr"] < good["expected_psnr"] - 0.2 for name in ("blurred", "third", "jumping"))
    soft, sharp = (np.median(figures_of(captures, name, "sharpness")) for name in ("blurred", "good"))
    assert soft < 0.5 * sharp


@pytest.mark.slow
def test_exposures_are_those_that_the_photographs_had(captures: dict[str, tuple[Verdict, str]]):
    x = figures_of(captures, "jumping", "exposure")
    np.testing.assert_allclose(x[1::2] - x[::2], np.log(0.45), atol=0.08)
    assert np.abs(figures_of(captures, "good", "exposure")).max() < 0.05


@pytest.mark.slow
def test_what_to_take_again_is_named_with_its_reason_on_one_page(captures: dict[str, tuple[Verdict, str]]):
    verdict, page = captures["odd"]
    assert set(verdict.retake) == {f"p{DARK:02d}.png", f"p{STRANGER}.png"}
    assert "darker" in verdict.retake[f"p{DARK:02d}.png"] and "overlap" in verdict.retake[f"p{STRANGER}.png"]
    assert page.count("<figure") == COUNT + 1 and page.count('class="again"') == 2
    assert 'src="data:' in page and "http" not in page and "does not overlap" in page
    assert any(line.startswith("take again p12.png") for line in verdict.lines())
    few, _ = captures["third"]
    assert "too few to find camera poses: at least 8 are needed" in few.lines()
    assert "left out q \N{REPLACEMENT CHARACTER}[7m.png: the same as p00.png" in few.lines()
    assert not set(few.retake) & set(few.figures["set_aside"])
    found = json.loads(json.dumps(verdict.figures))
    assert list(found["weakly_connected"]) == [f"p{STRANGER}.png"]
    assert list(found["differently_exposed"]) == [f"p{DARK:02d}.png"]
    assert not found["set_aside"] and len(found["photographs"]) == COUNT + 1 and 0 < found["overlap"] <= 1


def test_snerg_make_checks_and_stops(tmp_path: Path, refused: Callable[..., str]):
    (tmp_path / "photos").mkdir()
    words = [tmp_path / "photos", "--out", tmp_path / "out"]
    assert "empty" in refused(snerg_make, *words, "--check") and not (tmp_path / "out").exists()
    assert "--json: needs --check" in refused(snerg_make, *words, "--json", "-")
    for name in ("a.png", "b.png"):
        Image.new("RGB", (32, 32)).save(tmp_path / "photos" / name)
    assert "at least 8, found 1, without b.png (the same as a.png)" in refused(snerg_make, *words, "--check")
    (tmp_path / "photos/c.dng").touch()
    with pytest.warns(Notice, match="1 DNG picture, a format that is not read"), pytest.raises(UserError):
        check(require_source(tmp_path / "photos"), tmp_path / "check.html", 60)


def test_a_missing_package_is_named(tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "photos").mkdir()
    Image.new("RGB", (32, 32)).save(tmp_path / "photos/a.png")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "snerg[poses]" in refused(snerg_make, tmp_path / "photos", "--out", tmp_path / "out", "--check")
    assert not (tmp_path / "out").exists()


def test_a_blurred_picture_is_told_from_plain_ones_and_from_pictures_of_other_things():
    walls = [texture(seed)[:200, :300].mean(axis=-1) / 255 for seed in range(12)]
    sharp = Image.fromarray((walls[4] * 255).astype(np.uint8))
    walls[4] = np.asarray(sharp.filter(ImageFilter.GaussianBlur(3))) / 255.0
    walls[7] = walls[7] * 0.2 + 0.5  # little contrast is no blur
    moved = np.cumsum(walls[9], axis=1)
    # nor a sharp edge sharpness
    walls[9] = np.pad((moved[:, 16:] - moved[:, :-16]) / 16, ((0, 0), (0, 16)), mode="edge")
    assert [i for i, bad in enumerate(blurred([sharpness(wall) for wall in walls])) if bad] == [4, 9]
    assert not any(blurred([1.0] * 6 + [0.05] * 6))  # half of them: these show something else


def test_pictures_of_one_lens_share_a_camera_and_exif_says_its_focal_length(tmp_path: Path):
    for name, focal in (("a", 26), ("b", 26), ("c", 52)):
        exif = Image.Exif()
        exif[0x010F], exif[0x0110] = "Make", "Model"
        exif.get_ifd(0x8769)[0xA405] = focal
        Image.new("RGB", (120, 90)).save(tmp_path / f"{name}.jpg", exif=exif)
    a, b, c = (read_photograph(tmp_path / f"{name}.jpg") for name in "abc")
    assert a.camera == b.camera != c.camera
    assert [a.focal, c.focal] == pytest.approx([26 * 150 / 43.27, 52 * 150 / 43.27], rel=1e-3)


def test_few_pictures_are_all_matched_and_of_many_those_that_look_alike(monkeypatch: pytest.MonkeyPatch):
    """A walk once around something: its end looks like its beginning."""
    monkeypatch.setattr(mapping, "LARGEST", 50)
    overlap, chosen_pairs = mapping.OVERLAP, mapping.chosen_pairs
    count, rng = 60, np.random.default_rng(0)
    world = rng.integers(0, 256, (count * 10, 128), np.uint8)
    around = np.concatenate([world, world])
    descriptors = [around[10 * i : 10 * i + 50] for i in range(count)]
    pairs = set(chosen_pairs(descriptors))
    assert {(i, i + step) for i in range(count - overlap) for step in range(1, overlap + 1)} <= pairs
    assert {(0, count - 1), (1, count - 2)} <= pairs  # which are far from one another in their order
    assert len(pairs) <= mapping.how_many_pairs(count) and mapping.how_many_pairs(50) == comb(50, 2)
    assert len(pairs) < 0.6 * comb(count, 2) and all(i < j for i, j in pairs)
    assert chosen_pairs([np.zeros((0, 128), np.uint8)] * 3)  # nothing to see, but neighbours
