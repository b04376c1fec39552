"""Several open packs: each comes back as it was left, and there is an end to what they may take of memory."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from console import UserError
from scenepack import Pack, load_pack, save_pack
from scenepack.editing import Selection
from scenepack.placement import NOT_MOVED
from tests.fuzz.trees import write_tree
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.conftest import toy_pack
from tests.viewer.core.test_annotations import ANNOTATIONS, LINE, VIEW
from tests.viewer.waiting import at_once, live, not_none
from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.core.annotations import Annotations, Scale
from viewer.core.state import Edits
from viewer.features.crop import crop
from viewer.features.opening import opening as open_packs_module
from viewer.features.opening import session
from viewer.features.opening.opening import MOST_PACKS, OpenPacks, OpenPrompt, bytes_of, choose, path_in, suggestions
from viewer.features.opening.session import joined, load_session
from viewer.rendering.camera import ViewCamera


@pytest.fixture
def three(app):
    """Packs a, b and c, opened in this order."""
    for name in "abc":
        app.show(toy_pack(view_mlp=name != "b"), Path("/scenes") / name)
    return app


def names(app) -> str:
    return app.scene.name + "".join(scene.name for scene in app.open_packs.packs)


def test_the_next_and_the_previous_pack_go_round_and_closing_shows_the_pack_before_and_then_the_start_page(three):
    assert names(three) == "cab"
    seen = ""
    for _ in range(4):
        three.run("next-pack")
        seen += three.scene.name
    assert seen == "abca"
    for _ in range(4):
        three.run("last-pack")
        seen += three.scene.name
    assert seen == "abcacbac"
    three.run("close")
    assert names(three) == "ba"
    three.run("close")
    three.run("close")
    assert three.scene is None and not three.open_packs.packs


def test_a_pack_comes_back_with_its_camera_cuts_and_path(three):
    box = ((-1.0, -1.0, -1.0), (0.5, 0.5, 0.5))
    three.cut(crop=box, near=0.4)
    three.scene.rig.orbit(0.3, 0.1)
    three.filming.add(three)
    rig, goal = three.scene.rig, three.scene.rig.goal
    three.run("next-pack")
    assert three.settings.crop is None and three.settings.near == 0 and not three.filming.path.keyframes
    three.set(mode="alpha", crop=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    three.run("last-pack")
    assert three.scene.rig is rig and rig.goal == goal
    assert (three.settings.crop, three.settings.near, three.settings.mode) == (box, 0.4, "alpha")
    assert len(three.filming.path.keyframes) == 1
    assert rig.history.undo() and three.settings.crop is None  # what is undone is this pack's


def test_what_the_card_refuses_changes_nothing(three, pack_folder):
    three.canvas = FakeCanvas("there is no room")
    three.run("next-pack")
    assert names(three) == "cab" and "no room" in three.messages.dialogs.pop().text
    three.open(pack_folder)
    live(three, lambda: three.loading is None)
    assert names(three) == "cab" and "no room" in three.messages.dialogs[0].text


def test_there_is_an_end_to_what_open_packs_take_but_what_was_erased_and_is_not_saved_stays(three, monkeypatch):
    scene, open_packs = three.scene, OpenPacks()
    erased = replace(scene, edits=Edits(removed=Selection({0: np.ones(1, np.uint8)})))
    for i in range(MOST_PACKS + 1):
        open_packs.keep(three, replace(erased if i < 2 else scene, path=Path(f"/{i}"), name=str(i)))
    assert three.messages.lines[-1].text.startswith("2 was closed")
    assert [each.name for each in open_packs.packs] == ["0", "1", *map(str, range(3, MOST_PACKS + 1))]
    monkeypatch.setattr(open_packs_module, "MOST_BYTES", 3.5 * bytes_of(scene.pack))
    open_packs.keep(three, scene)
    assert [each.name for each in open_packs.packs] == ["0", "1", "c"]
    assert bytes_of(scene.pack) >= np.asarray(scene.pack.atlas_rgba).nbytes


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """A folder with a pack, a zip, a film, a plain folder and what nobody opens."""
    files = dict.fromkeys(("scene.zip", "film.mp4", "notes.txt", "Apples.zip", "a päck/scene_params.json"), b"PK")
    write_tree({**files, "plain/deep": "folder", ".hidden": "folder"}, tmp_path / "shelf")
    return tmp_path / "shelf"


@pytest.mark.parametrize("form", ["{}", " {} \n", "'{}'", '"{}"', "{}\nsecond line"])
def test_a_copied_path_is_found_as_shells_and_file_managers_write_it(shelf, form):
    path = shelf / "a päck"
    assert path_in(form.format(path)) == path
    assert path_in(form.format(path.as_uri())) == path


def test_a_typed_folder_shows_what_of_it_can_be_opened_and_enter_looks_into_a_plain_folder(shelf):
    names = [path.name for path in suggestions(f"{shelf}/", [])]
    assert names == ["a päck", "plain", "Apples.zip", "film.mp4", "scene.zip"]
    assert [path.name for path in suggestions(f"{shelf}/a", [])] == ["a päck", "Apples.zip"]
    assert [path.name for path in suggestions(f"{shelf}/.h", [])] == [".hidden"]
    open_prompt = OpenPrompt([])
    open_prompt.type(f"{shelf}/pl")
    open_prompt.step(1)
    assert open_prompt.take() is None and open_prompt.text == f"{shelf}/plain/"
    open_prompt.type(f"{shelf}/plain/nothing")
    assert open_prompt.take() is None and "nothing" in open_prompt.problem
    open_prompt.type(f"{shelf}/a")
    open_prompt.step(1)
    open_prompt.step(5)
    assert open_prompt.picked == 1
    open_prompt.step(-9)
    assert open_prompt.picked is None


def test_the_question_opens_what_is_chosen_and_remembers_scenes(app, shelf, pack_folder):
    app.run("open")
    app.open_prompt.type(str(pack_folder))
    choose(app)
    assert app.open_prompt is None and app.loading is not None and app.loading.path == pack_folder
    app.opening.cancel(app)
    (shelf / "plain" / "transforms.json").write_text('{"frames": []}')
    app.drop([shelf / "plain"])
    assert app.making.plan is not None and app.preferences.recent_packs() == [(shelf / "plain").resolve()]
    app.making.dismiss()


def test_a_pasted_path_opens_and_a_wrong_one_is_told(app, pack, pack_folder, tmp_path):
    assert COMMANDS["paste"].enabled(app)
    app.clipboard.text = f"{pack_folder}\n"
    app.paste()
    assert app.loading is not None and app.loading.path == pack_folder
    app.opening.cancel(app)
    app.clipboard.text = str(tmp_path / "gone")
    with pytest.raises(UserError, match="nothing at this path"):
        app.paste()
    app.clipboard.text = "no path"
    app.paste()
    assert "no path on the clipboard" in app.messages.toast
    app.show(pack, pack_folder)
    app.clipboard.text = "0, 0, 5,  0 0 0"  # eye and target
    app.paste()
    assert np.allclose(app.scene.rig.matrix[:3], np.eye(4)[:3] + 5.0 * np.outer([0, 0, 1], [0, 0, 0, 1]))


@pytest.fixture
def packs(tmp_path: Path, pack: Pack) -> list[Path]:
    folder = tmp_path / "project"
    for i, name in enumerate(("first", "second", "third")):
        save_pack(toy_pack(seed=i, view_mlp=False) if i else pack, folder / name)
    return [folder / name for name in ("first", "second", "third")]


def arranged(packs: list[Path]) -> App:
    """Three packs open, the last of them shown, each seen from elsewhere."""
    app = App()
    for i, path in enumerate(packs):
        app.show(load_pack(path), path)
        rig = app.open_scene.rig
        at_once(rig.orbit, 0.2 + 0.3 * i, 0.1)
        rig.fov = 30.0 + i
    app.open_scene.rig.set_orthographic(True)
    app.set(crop=crop.placed(app.open_scene.pack, np.zeros(3), np.ones(3)), near=0.25)
    app.annotations.current = ANNOTATIONS
    app.interface.page = "measure"
    return app


def test_a_session_keeps_the_field_of_view_of_the_photograph_that_is_shown(app: App, packs: list[Path]) -> None:
    app.show(load_pack(packs[0]), packs[0])
    app.open_scene.rig.hold(ViewCamera.posed(app.open_scene.rig.matrix, 20.0, (64, 48)))
    assert not_none(session.session_of(app)).packs[0].camera.fov == pytest.approx(20.0)


def test_all_of_it_comes_back_elsewhere(app: App, packs: list[Path], tmp_path: Path):
    before = arranged(packs)
    file = packs[0].parent / f"a{session.SESSION_SUFFIX}"
    before.run("save-session")
    assert before.file_request is not None
    before.file_request.then(file)
    assert [entry["path"] for entry in json.loads(file.read_text())["packs"]] == ["third", "first", "second"]
    moved = packs[0].parent.rename(tmp_path / "moved")
    app.run("open")
    not_none(app.open_prompt).type(str(moved / file.name))
    choose(app)
    live(app, lambda: app.loading is None)
    assert not app.messages.dialogs
    assert app.open_scene.path == moved / "third" and app.interface.page == "measure"
    assert [scene.name for scene in app.open_packs.packs] == ["first", "second"]
    assert np.allclose(app.open_scene.rig.matrix, before.open_scene.rig.matrix, atol=1e-9)
    assert app.open_scene.rig.orthographic and app.open_scene.rig.fov == before.open_scene.rig.fov
    assert np.allclose(not_none(app.settings.crop), not_none(before.settings.crop)) and app.settings.near == 0.25
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


def test_a_bad_file_is_told_and_changes_nothing(app: App, packs: list[Path], tmp_path: Path):
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
    live(again, lambda: again.loading is None)
    assert len(again.messages.dialogs) == 1 and "second" in again.messages.dialogs[0].title
    assert again.scene is not None and again.scene.name == "first"


def test_the_last_session_is_kept_and_offered(packs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "user" / "last.snerg"
    app = arranged(packs)
    app.sessions.begin(file)
    assert app.sessions.last is None
    monkeypatch.setattr(session, "REST_S", 0.05)
    live(app, file.exists)
    at_once(app.open_scene.rig.orbit, 0.4, 0.0)
    here = app.open_scene.rig.matrix
    app.sessions.finish(app)
    app.annotations.close_pack(app)
    again = App()
    again.sessions.begin(file)
    assert again.sessions.last is not None and again.sessions.last.title == "third, first and 1 more"
    again.run("last-session")
    live(again, lambda: again.loading is None)
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
