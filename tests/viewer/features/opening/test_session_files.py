"""Sessions: what was open comes back, with cameras, cuts and marks, wherever the file and its packs are moved together."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenepack import Pack, load_pack, save_pack
from scenepack.placement import NOT_MOVED
from tests.viewer.conftest import toy_pack
from tests.viewer.core.test_annotations import ANNOTATIONS, LINE, VIEW
from tests.viewer.waiting import there, until
from viewer.app.application import App
from viewer.core.annotations import Annotations, Scale
from viewer.features.crop import crop
from viewer.features.opening import session
from viewer.features.opening.opening import choose
from viewer.features.opening.session import joined, load_session


@pytest.fixture
def packs(tmp_path: Path, pack: Pack) -> list[Path]:
    folder = tmp_path / "project"
    for i, name in enumerate(("first", "second", "third")):
        save_pack(toy_pack(seed=i, view_mlp=False) if i else pack, folder / name)
    return [folder / name for name in ("first", "second", "third")]


def settle(app: App) -> None:
    until(lambda: app.tick(0.01) or app.loading is None)


def arranged(packs: list[Path]) -> App:
    """Three packs open, the last of them shown, each seen from elsewhere."""
    app = App()
    for i, path in enumerate(packs):
        app.show(load_pack(path), path)
        rig = app.open_scene.rig
        rig.orbit(0.2 + 0.3 * i, 0.1)
        rig.shown = rig.goal
        rig.fov = 30.0 + i
    app.open_scene.rig.set_orthographic(True)
    app.set(crop=crop.placed(app.open_scene.pack, np.zeros(3), np.ones(3)), near=0.25)
    app.annotations.current = ANNOTATIONS
    app.interface.page = "measure"
    return app


def test_all_of_it_comes_back_elsewhere(packs: list[Path], tmp_path: Path):
    before = arranged(packs)
    file = packs[0].parent / f"a{session.SESSION_SUFFIX}"
    before.run("save-session")
    assert before.file_request is not None
    before.file_request.then(file)
    assert [entry["path"] for entry in json.loads(file.read_text())["packs"]] == ["third", "first", "second"]
    moved = packs[0].parent.rename(tmp_path / "moved")
    app = App()
    app.run("open")
    there(app.open_prompt).type(str(moved / file.name))
    choose(app)
    settle(app)
    assert not app.messages.dialogs
    assert app.open_scene.path == moved / "third" and app.interface.page == "measure"
    assert [scene.name for scene in app.open_packs.packs] == ["first", "second"]
    assert np.allclose(app.open_scene.rig.matrix, before.open_scene.rig.matrix, atol=1e-9)
    assert app.open_scene.rig.orthographic and app.open_scene.rig.fov == before.open_scene.rig.fov
    assert np.allclose(there(app.settings.crop), there(before.settings.crop)) and app.settings.near == 0.25
    assert app.annotations.current == ANNOTATIONS
    for _ in range(2):
        before.open_packs.switch(before, 1)
        app.open_packs.switch(app, 1)
        assert app.open_scene.name == before.open_scene.name
        assert np.allclose(app.open_scene.rig.matrix, before.open_scene.rig.matrix, atol=1e-9)


def test_marks_are_added_and_none_is_lost():
    moved = NOT_MOVED.levelled(np.array([0.1, 0.9, 0.0]), np.zeros(3))
    own = Annotations(Scale(3.0, "ft"), (LINE,), (replace(VIEW, name="Mine"),), placement=moved)
    both = joined(own, ANNOTATIONS)
    assert both.scale == own.scale and both.placement == moved and both.measurements == ANNOTATIONS.measurements
    assert both.bookmarks == (*own.bookmarks, *ANNOTATIONS.bookmarks)
    assert joined(both, ANNOTATIONS) == both and joined(Annotations(), ANNOTATIONS) == ANNOTATIONS


def test_a_bad_file_is_told_and_changes_nothing(packs: list[Path], tmp_path: Path):
    app = App()
    app.show(load_pack(packs[0]), packs[0])
    (tmp_path / "bad.snerg").write_text('{"snerg_session": 9}')
    app.drop([tmp_path / "bad.snerg"])
    (dialog,) = app.messages.dialogs
    assert "bad.snerg" in dialog.text and "newer" in dialog.text
    assert app.open_scene.path == packs[0] and app.loading is None


def test_a_pack_that_is_gone_is_told_and_those_before_it_stay_open(packs: list[Path], tmp_path: Path):
    app = arranged(packs)
    file = packs[0].parent / "a.snerg"
    app.sessions.save(app, file)
    packs[1].rename(tmp_path / "gone")
    again = App()
    again.drop([file])
    settle(again)
    assert len(again.messages.dialogs) == 1 and "second" in again.messages.dialogs[0].title
    assert again.scene is not None and again.scene.name == "first"


def test_the_last_session_is_kept_and_offered(packs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "user" / "last.snerg"
    app = arranged(packs)
    app.sessions.begin(file)
    assert app.sessions.last is None
    monkeypatch.setattr(session, "REST_S", 0.05)
    until(lambda: app.tick(0.01) or file.exists())
    app.open_scene.rig.orbit(0.4, 0.0)
    app.open_scene.rig.shown = app.open_scene.rig.goal
    here = app.open_scene.rig.matrix
    app.sessions.finish(app)
    app.annotations.close_pack()
    again = App()
    again.sessions.begin(file)
    assert again.sessions.last is not None and again.sessions.last.title == "third, first and 1 more"
    again.run("last-session")
    settle(again)
    assert np.allclose(again.open_scene.rig.matrix, here, atol=1e-9)
    again.sessions.finish(again)
    assert load_session(file).title == "third, first and 1 more"
    packs[2].rename(tmp_path / "gone")
    third = App()
    third.sessions.begin(file)
    assert third.sessions.last is None  # what it showed is not there any more
    file.write_text("{")
    third.sessions.begin(file)
    assert third.sessions.last is None and not third.messages.dialogs
