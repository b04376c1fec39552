"""The check of photographs: spoilt versions of a capture come out worse, and what to take again is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from tests.training.posing.rooms import cameras, photograph
from training.posing.check import Verdict, check
from training.scenes.sources import require_source

COUNT, DARK, STRANGER = 12, 5, 12


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Verdict, str]]:
    """Verdicts and pages of a capture and of spoilt versions of it."""
    good = [Image.fromarray(photograph(camera)) for camera in cameras(COUNT)]
    blurred = [picture.filter(ImageFilter.GaussianBlur(2)) for picture in good]
    jumping = [
        picture.point(lambda value, i=i: int(value * (0.45 if i % 2 else 1.0))) for i, picture in enumerate(good)
    ]
    odd = [picture.point(lambda value: int(value * 0.6)) if i == DARK else picture for i, picture in enumerate(good)]
    odd.append(Image.fromarray(photograph(cameras(3)[1], walls=7)))
    versions = {"good": good, "blurred": blurred, "third": good[::3], "jumping": jumping, "odd": odd}
    found = {}
    for name, pictures in versions.items():
        folder = tmp_path_factory.mktemp(name)
        for i, picture in enumerate(pictures):
            picture.save(folder / f"p{i:02d}.png")
        page = folder / "out/check.html"
        found[name] = check(require_source(folder), page, 60), page.read_text()
    return found


def test_spoilt_versions_of_a_capture_come_out_worse(captures: dict[str, tuple[Verdict, str]]):
    good = captures["good"][0]
    assert not good.retake and good.connected == 1 and good.score > 40
    assert all(captures[name][0].score < 0.8 * good.score for name in ("blurred", "third", "jumping"))
    assert np.median(captures["blurred"][0].sharpness) < 0.5 * np.median(good.sharpness)


def test_exposures_are_those_that_the_photographs_had(captures: dict[str, tuple[Verdict, str]]):
    x = captures["jumping"][0].exposure
    np.testing.assert_allclose(x[1::2] - x[::2], np.log(0.45), atol=0.08)
    assert np.abs(captures["good"][0].exposure).max() < 0.05


def test_what_to_take_again_is_named_with_its_reason_on_one_page(captures: dict[str, tuple[Verdict, str]]):
    verdict, page = captures["odd"]
    assert set(verdict.retake) == {f"p{DARK:02d}.png", f"p{STRANGER}.png"}
    assert "darker" in verdict.retake[f"p{DARK:02d}.png"] and "overlap" in verdict.retake[f"p{STRANGER}.png"]
    assert page.count("<figure") == COUNT + 1 and page.count('class="again"') == 2
    assert 'src="data:' in page and "http" not in page and "does not overlap" in page
    assert any(line.startswith("take again p12.png") for line in verdict.lines())
    found = json.loads(json.dumps(verdict.as_json()))
    assert list(found["weakly_connected"]) == [f"p{STRANGER}.png"] and list(found["differently_exposed"]) == [
        f"p{DARK:02d}.png"
    ]
    assert not found["set_aside"] and len(found["photographs"]) == COUNT + 1 and 0 < found["overlap"] <= 1


def test_snerg_make_checks_and_stops(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    from baker.commands.make import main

    (tmp_path / "photos").mkdir()
    assert main([str(tmp_path / "photos"), "--out", str(tmp_path / "out"), "--check"]) == 2
    assert "empty" in capsys.readouterr().err and not (tmp_path / "out").exists()
    assert main([str(tmp_path / "photos"), "--out", str(tmp_path / "out"), "--json", "-"]) == 2
    assert "--json: needs --check" in capsys.readouterr().err


def test_a_missing_package_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    from baker.commands.make import main

    (tmp_path / "photos").mkdir()
    Image.new("RGB", (32, 32)).save(tmp_path / "photos/a.png")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main([str(tmp_path / "photos"), "--out", str(tmp_path / "out"), "--check"]) == 2
    assert "snerg[poses]" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_copies_of_an_llff_scene_s_photographs_are_not_checked_beside_them(tmp_path: Path):
    (tmp_path / "poses_bounds.npy").touch()
    for folder in ("images_4", "images_8"):
        (tmp_path / folder).mkdir()
        Image.new("RGB", (32, 32)).save(tmp_path / folder / "a.png")
    assert require_source(tmp_path).files == (tmp_path / "images_4/a.png",)
