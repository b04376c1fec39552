"""Choosing photographs in the list and in the scene, and their thumbnails."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from baker.baking.to_pack import with_pictures
from scenepack import load_pack, save_pack
from scenepack.cameras import PICTURE, has_picture, picture_of, picture_uri
from tests.scenepack.helpers import read_json
from tests.viewer.scenes import photographed
from tests.viewer.waiting import not_none, until
from training.scenes import load_scene
from viewer.features.photographs import photographs as thumbnails_module
from viewer.features.photographs.photographs import Photographs, Thumbnails, psnr

PER_SPLIT = 24


@pytest.fixture(scope="module")
def many(tmp_path_factory, pack):
    """A pack with more photographs than the list has rows."""
    return photographed(pack, tmp_path_factory.mktemp("scene") / "toy_scene", PER_SPLIT)


@pytest.fixture
def ui(offscreen, app, many, pack_folder):
    app.interface.page = "photographs"
    return offscreen(app, many, pack_folder)


def ready(photographs: Photographs) -> Thumbnails:
    thumbnails = Thumbnails(photographs)
    until(lambda: thumbnails.finished)
    return thumbnails


def test_thumbnails_are_the_photographs_shrunk(many):
    thumbnails = ready(Photographs(many))
    assert not thumbnails.problem and len(thumbnails.boxes) == 2 * PER_SPLIT
    for index in (0, 2 * PER_SPLIT - 1):
        x, y, w, h = thumbnails.boxes[index]
        full = Image.fromarray(thumbnails.photographs.pixels(index)).resize((w, h), Image.Resampling.BOX)
        difference = np.abs(thumbnails.sheet[y : y + h, x : x + w].astype(int) - np.asarray(full))
        assert difference.mean() < 2


@pytest.mark.parametrize(("largest", "cell"), [(448, 64), (128, 32)])
def test_the_sheet_never_outgrows_its_bound(many, monkeypatch, largest, cell):
    monkeypatch.setattr(thumbnails_module, "LARGEST_SHEET", largest)
    thumbnails = ready(Photographs(many))
    assert thumbnails.cell == cell and max(thumbnails.sheet.shape) <= largest
    assert len(thumbnails.boxes) == min(2 * PER_SPLIT, (largest // cell) ** 2)


def test_one_broken_photograph_leaves_the_others(pack, tmp_path):
    known = photographed(pack, tmp_path / "scene")
    photographs = Photographs(known)
    photographs.photograph(0)  # the scene is read before the picture breaks
    (tmp_path / "scene" / "train" / "r_1.png").write_bytes(b"no picture")
    thumbnails = ready(photographs)
    assert set(thumbnails.boxes) == {0, 2, 3, 4, 5} and "r_1.png" in thumbnails.problem


def rows_in_view(ui) -> set[int]:
    """Which photographs are seen in the list."""
    rows = [each for each in ui.widgets("##") if "##shots" in each.window and each.label[2:].isdigit()]
    return {int(row.label[2:]) for row in rows if row.in_view}


def test_the_list_scrolls_to_what_was_chosen_by_keys(ui, app):
    ui.settle()
    assert 0 in rows_in_view(ui) and 40 not in rows_in_view(ui)
    app.gallery.stand_in(app, 40)
    ui.settle()
    assert 40 in rows_in_view(ui) and 0 not in rows_in_view(ui)
    before = rows_in_view(ui)
    app.gallery.step(app, -1)  # in view already: nothing jumps
    ui.settle()
    assert rows_in_view(ui) == before


def test_what_was_chosen_stays_chosen_and_steps_keep_to_the_split(ui, app):
    comparison, gallery = app.comparison, app.gallery
    gallery.stand_in(app, 3)
    ui.settle()
    ui.drag([(100.0, 300.0), (160.0, 320.0)])
    assert comparison.against == "" and gallery.chosen == 3
    gallery.step(app, 1)
    assert gallery.chosen == 4
    gallery.split_shown = "test"
    gallery.step(app, -1)
    assert gallery.photographs.shots[gallery.chosen].split == "test"
    gallery.stand_in(app, 0)
    assert gallery.split_shown == ""  # what is chosen can be seen in the list


ELSEWHERE = {"scene": "/home/ann/captures/shelf"}


def test_copies_are_the_photographs_shrunk_and_survive_every_way_a_pack_goes(known_pack, tmp_path):
    scene = load_scene(known_pack.metadata["provenance"]["scene"])
    save_pack(with_pictures(known_pack, scene, 48).with_metadata(provenance=ELSEWHERE), tmp_path / "a.zip")
    save_pack(load_pack(tmp_path / "a.zip"), tmp_path / "b", codec="webp")
    there, travelled = Photographs(known_pack), Photographs(load_pack(tmp_path / "b"))
    assert there.reachable and not travelled.reachable and travelled.any_pictures
    for index in range(len(there.shots)):
        small = Image.fromarray(there.pixels(index)).resize((48, 48), Image.Resampling.BOX)
        assert psnr(travelled.pixels(index), np.asarray(small)) > 34
    assert read_json(tmp_path / "b")["snerg"]["cameras"][0][PICTURE]


def test_a_pack_without_its_photographs_shows_their_places_and_no_error(offscreen, app, known_pack, pack_folder):
    app.interface.page, app.gallery.frusta = "photographs", True
    ui = offscreen(app, known_pack.with_metadata(provenance=ELSEWHERE), pack_folder)
    assert app.gallery.thumbnails is None and not app.gallery.photographs.any_pictures
    before = app.scene.rig.held
    assert app.run("next-photo")
    ui.settle()
    assert app.scene.rig.held is not before and app.gallery.chosen == 0
    assert app.comparison.against == "" and not app.messages.dialogs


def test_copies_never_outgrow_what_was_asked():
    pixels = np.random.default_rng(0).integers(0, 255, (60, 90, 3), np.uint8)
    for most, shape in ((30, (20, 30, 3)), (300, (60, 90, 3))):
        assert not_none(picture_of({PICTURE: picture_uri(pixels, most)})).shape == shape


def test_the_demo_brings_all_its_photographs_and_stays_small(offscreen, app, demo):
    pack = load_pack(demo)
    assert len(pack.metadata["cameras"]) == 112 and all(has_picture(entry) for entry in pack.metadata["cameras"])
    assert demo.stat().st_size < 8e6
    app.interface.page = "photographs"
    ui = offscreen(app, pack, demo)
    assert len(app.gallery.thumbnails.boxes) == 112 and not app.gallery.thumbnails.problem
    app.gallery.stand_in(app, 3)
    ui.settle()
    assert app.comparison.against == "photograph" and app.comparison.psnr_size == (200, 200)  # the copy's
    assert not app.messages.dialogs and app.comparison.psnr_db > 25  # the photograph is of this view, not of another
    app.scene.rig.remember()
    app.scene.rig.hold(replace(app.gallery.photographs.shots[9].view))
    ui.settle()
    assert app.comparison.psnr_db < 20
