"""Photographs that travel with the pack, small; and packs whose photographs are elsewhere offer nothing that is not there."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from baker.baking.pictures import with_pictures
from scenepack import load_pack, save_pack
from scenepack.pictures import PICTURE, has_picture, picture_of, picture_uri
from tests.viewer.scenes import photographed
from training.scenes import load_scene
from viewer.app.application import App
from viewer.app.commands import run
from viewer.features.photographs.photographs import Photographs, psnr

DEMO = Path(__file__).parents[4] / "viewer" / "demo" / "demo.zip"
ELSEWHERE = {"scene": "/home/ann/captures/shelf"}


@pytest.fixture(scope="module")
def known(tmp_path_factory, pack):
    """A pack whose photographs are on this computer."""
    return photographed(pack, tmp_path_factory.mktemp("scene") / "toy_scene")


@pytest.fixture(scope="module")
def carrying(known):
    """The same pack on another computer, with copies of its photographs."""
    scene = load_scene(known.metadata["provenance"]["scene"])
    return with_pictures(known, scene, 48).with_metadata(provenance=ELSEWHERE)


@pytest.fixture
def bare(known):
    """The same pack on another computer, without."""
    return known.with_metadata(provenance=ELSEWHERE)


def test_copies_are_the_photographs_shrunk_and_survive_every_way_a_pack_goes(known, carrying, tmp_path):
    save_pack(carrying, tmp_path / "a.zip")
    save_pack(load_pack(tmp_path / "a.zip"), tmp_path / "b", codec="webp")
    there, travelled = Photographs(known), Photographs(load_pack(tmp_path / "b"))
    assert there.reachable and not travelled.reachable and travelled.any_pictures
    for index in range(len(there)):
        small = Image.fromarray(there.pixels(index)).resize((48, 48), Image.Resampling.BOX)
        assert psnr(travelled.pixels(index), np.asarray(small)) > 34
    assert json.loads((tmp_path / "b" / "scene_params.json").read_text())["snerg"]["cameras"][0][PICTURE]


def test_standing_in_a_copy_compares_with_it_and_says_so(offscreen, carrying, pack_folder):
    app = App()
    ui = offscreen(app, size=(1180, 900))
    app.show(carrying, pack_folder)
    app.interface.page = "photographs"
    app.gallery.stand_in(app, 0)
    ui.settle()
    assert app.comparison.against == "photograph" and app.comparison.psnr_size == (48, 48)
    assert app.comparison.psnr_db > 25 and not app.messages.dialogs and ui.ctx.error == "GL_NO_ERROR"


def test_a_pack_without_its_photographs_shows_their_places_and_no_error(offscreen, bare, pack_folder):
    app = App()
    ui = offscreen(app, size=(1180, 900))
    app.show(bare, pack_folder)
    app.interface.page, app.gallery.frusta = "photographs", True
    ui.settle()
    assert app.gallery.thumbnails is None and not app.gallery.photographs.any_pictures
    before = app.scene.rig.held
    assert run(app, "next-photo")
    ui.settle()
    assert app.scene.rig.held is not before and app.gallery.chosen == 0
    assert app.comparison.against == "" and not app.messages.dialogs and ui.ctx.error == "GL_NO_ERROR"


def test_copies_never_outgrow_what_was_asked():
    pixels = np.random.default_rng(0).integers(0, 255, (60, 90, 3), np.uint8)
    assert picture_of({PICTURE: picture_uri(pixels, 30)}).shape == (20, 30, 3)
    assert picture_of({PICTURE: picture_uri(pixels, 300)}).shape == (60, 90, 3)


def test_the_demo_brings_all_its_photographs_and_stays_small(offscreen):
    pack = load_pack(DEMO)
    assert len(pack.metadata["cameras"]) == 112 and all(has_picture(entry) for entry in pack.metadata["cameras"])
    assert DEMO.stat().st_size < 8e6
    app = App()
    ui = offscreen(app, size=(1180, 800))
    app.show(pack, DEMO)
    app.interface.page = "photographs"
    ui.settle()
    assert len(app.gallery.thumbnails.boxes) == 112 and not app.gallery.thumbnails.problem
    app.gallery.stand_in(app, 3)
    ui.settle()
    assert app.comparison.psnr_db > 24  # the photograph is of this view, not of another
    app.scene.rig.hold(replace(app.gallery.photographs.shots[9].view), remember=True)
    ui.settle()
    assert app.comparison.psnr_db < 20
