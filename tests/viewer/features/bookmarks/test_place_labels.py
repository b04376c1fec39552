"""Annotated places in saved pictures: their numbers and titles, where they are seen and only there."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenepack import load_pack, save_pack
from tests.viewer.rendering.test_depth_of_field import FAR_BAR, NEAR_BAR, bars
from tests.viewer.waiting import live
from viewer.app.application import App
from viewer.commands import render
from viewer.core.annotations import Annotations, Bookmark
from viewer.core.pose import project
from viewer.features.bookmarks.bookmarks import RIM, with_places
from viewer.rendering.camera import ViewCamera
from viewer.rendering.settings import RenderSettings

NEAR = Bookmark("Near bar", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), point=(-0.3, 0.0, NEAR_BAR + 0.05))
FAR = Bookmark("Ferne Stange, 遠い棒", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), point=(0.4, 0.2, FAR_BAR + 0.05))
BEHIND = Bookmark("Hidden", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), point=(0.4, -0.3, -0.98))
VIEW = Bookmark("No place", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0))
ANNOTATIONS = Annotations(bookmarks=(VIEW, NEAR, FAR, BEHIND))
WORDS = ["--eye", "0,0,3", "--target", "0,0,0", "--fov", "40", "--size", "240x160"]
CAMERA = ViewCamera.look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), fov_degrees=40.0, size=(240, 160))


def discs(picture: np.ndarray) -> list[bool]:
    """Whether the rim of a disc is around each of the three places."""
    rim = np.abs(picture.astype(int) - RIM[:3]).max(axis=2) < 60
    pixels, _ = project(CAMERA, np.array([NEAR.point, FAR.point, BEHIND.point]))
    return [bool(rim[int(y) - 10 : int(y) + 10, int(x) - 10 : int(x) + 10].sum() > 8) for x, y in pixels]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_pack(bars(), tmp_path / "bars")
    app = App()
    app.annotations.folder = tmp_path
    app.show(load_pack(tmp_path / "bars"), tmp_path / "bars")
    app.annotations.current = ANNOTATIONS
    app.annotations.save_now()
    return tmp_path / "bars"


def test_places_that_are_seen_are_numbered_and_titled_and_the_rest_is_as_it_was(folder: Path, tmp_path: Path) -> None:
    def rendered(name: str, *more: str) -> Path:
        assert render.main([str(folder), "--out", str(tmp_path / name), *WORDS, *more]) == 0
        return tmp_path / name

    plain, places = (np.asarray(Image.open(rendered(*words))) for words in (("a.png",), ("b.png", "--places")))
    assert discs(places) == [True, True, False] and discs(plain) == [False] * 3
    changed = (plain != places).any(axis=2)
    assert 200 < changed.sum() < 0.25 * changed.size
    layers = rendered("layers", "--places", "--mode", "rgb,depth")
    rgb, depth = (np.asarray(Image.open(layers / f"view_{mode}.png")) for mode in ("rgb", "depth"))
    assert discs(rgb) == [True, True, False] and discs(depth) == [False] * 3


def test_a_film_and_a_saved_view_of_the_window_have_them_where_that_is_wanted(offscreen, app, folder, tmp_path):
    offscreen(app, load_pack(folder), folder)
    app.filming.size = (240, 160)
    for wanted in (False, True):
        app.filming.annotated = wanted
        app.filming.still(app, tmp_path / "a.png", CAMERA)
        live(app, lambda: app.filming.export is None)
        assert discs(np.asarray(Image.open(tmp_path / "a.png"))) == [wanted, wanted, False]


def test_a_transparent_picture_has_none(folder: Path, tmp_path: Path, capsys) -> None:
    words = ["--out", str(tmp_path / "a.png"), *WORDS, "--places", "--background", "transparent"]
    assert render.main([str(folder), *words]) == 2
    assert "--places" in capsys.readouterr().err


def test_titles_stay_within_the_picture_and_are_cut_where_they_are_long() -> None:
    long = Annotations(bookmarks=(Bookmark("W" * 100, (0, 0, 3), (0, 0, 0), point=(0.4, 0.2, FAR_BAR + 0.05)),))
    white = np.full((160, 240, 3), 255, np.uint8)
    changed = np.argwhere((with_places(white, CAMERA, bars(), RenderSettings(), long) != 255).any(axis=2))
    assert 40 < np.ptp(changed[:, 1]) < 0.55 * 240
