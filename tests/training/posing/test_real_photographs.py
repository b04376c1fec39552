"""Why no poses are found, and what is left out, of photographs that people took (the folder that SNERG_DATA names)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import pytest
from PIL import Image, ImageFilter

from console import UserError
from training.posing import find, rejection_report
from training.posing.find import posed_scene
from training.scenes import load_scene

pytest.importorskip("pycolmap", reason="finding poses needs pycolmap (the extra poses)")

FOX, FERN, MARY = "transforms_json/fox/images", "nerf_llff_data/fern/images_4", "real_360/mary_rose/images_4"
SIDE = 480


def taken(real_data: Path, into: Path, scene: str, which: Sequence[int]) -> None:
    """Copies of photographs of a scene, SIDE pixels at most."""
    into.mkdir(exist_ok=True)
    files = sorted((real_data / scene).iterdir())
    for i in which:
        with Image.open(files[i], formats=["JPEG", "PNG"]) as picture:
            picture.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
            picture.convert("RGB").save(into / f"{scene.split('/')[1]}{i:02d}.jpg", quality=92)


def test_photographs_that_share_nothing_are_refused_with_a_table(real_data: Path, tmp_path: Path) -> None:
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    for name, scene in (("fox", FOX), ("fern", FERN)):
        with Image.open(sorted((real_data / scene).iterdir())[3], formats=["JPEG", "PNG"]) as picture:
            w, h = (n // 2 for n in picture.size)
            for i in range(4):  # its quarters
                at = (i % 2 * w, i // 2 * h)
                picture.convert("RGB").crop((*at, at[0] + w, at[1] + h)).save(
                    photographs / f"{name}{i}.jpg", quality=92
                )
    with pytest.raises(UserError, match=r"do not overlap enough.* match no other: fern0\.jpg, fern1\.jpg"):
        posed_scene(photographs, tmp_path / "out")
    table = (tmp_path / "out" / find.WORK / rejection_report.TABLE).read_text().splitlines()
    assert len(table) == 9 and all(line.split()[2] == "no" for line in table[1:])


@pytest.mark.slow
def test_of_two_places_the_larger_is_made_and_blurred_and_repeated_pictures_are_named(
    real_data: Path, tmp_path: Path
) -> None:
    photographs = tmp_path / "photographs"
    taken(real_data, photographs, FERN, range(9))
    taken(real_data, photographs, MARY, (0, 30))
    (photographs / "twice.jpg").write_bytes((photographs / "fern04.jpg").read_bytes())
    with Image.open(photographs / "fern06.jpg", formats=["JPEG"]) as picture:
        picture.filter(ImageFilter.GaussianBlur(8)).save(photographs / "shaken.jpg")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = posed_scene(photographs, tmp_path / "out")
    told = "\n".join(str(warning.message) for warning in caught)
    assert "twice.jpg = fern04.jpg" in told and "blurred (shaken.jpg)" in told
    assert "mary_rose00.jpg, mary_rose30.jpg" in told
    names = {view.name for views in load_scene(scene).splits.values() for view in views}
    assert {Path(name).stem for name in names} == {f"fern{i:02d}" for i in range(9)}


@pytest.mark.slow
def test_three_photographs_are_too_few(real_data: Path, tmp_path: Path) -> None:
    taken(real_data, tmp_path / "photographs", FERN, range(3))
    with pytest.raises(UserError, match=r"too few photographs to find camera poses .*at least 8, found 3"):
        posed_scene(tmp_path / "photographs", tmp_path / "out")
    assert not (tmp_path / "out").exists()
