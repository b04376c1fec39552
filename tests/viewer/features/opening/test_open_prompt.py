"""One question for all that can be opened: paths as people copy them, what was opened lately, what lies at hand."""

from pathlib import Path

import pytest

from console import UserError
from viewer.app.commands import COMMANDS, run
from viewer.features.opening.open_prompt import OpenPrompt, choose, path_in, suggestions


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """A folder with a pack, a zip, a film, a plain folder and what nobody opens."""
    (tmp_path / "a päck").mkdir()
    (tmp_path / "a päck" / "scene_params.json").write_text("{}")
    (tmp_path / "plain" / "deep").mkdir(parents=True)
    (tmp_path / ".hidden").mkdir()
    for name in ("scene.zip", "film.mp4", "notes.txt", "Apples.zip"):
        (tmp_path / name).write_bytes(b"PK")
    return tmp_path


@pytest.mark.parametrize("form", ["{}", " {} \n", "'{}'", '"{}"', "{}\nsecond line"])
def test_a_copied_path_is_found_as_shells_and_file_managers_write_it(shelf, form):
    path = shelf / "a päck"
    assert path_in(form.format(path)) == path
    assert path_in(form.format(path.as_uri())) == path


def test_a_typed_folder_shows_what_of_it_can_be_opened_folders_first(shelf):
    names = [path.name for path in suggestions(f"{shelf}/", [])]
    assert names == ["a päck", "plain", "Apples.zip", "film.mp4", "scene.zip"]
    assert [path.name for path in suggestions(f"{shelf}/a", [])] == ["a päck", "Apples.zip"]
    assert [path.name for path in suggestions(f"{shelf}/.h", [])] == [".hidden"]


def test_enter_looks_into_a_plain_folder_and_says_what_is_not_there(shelf):
    open_prompt = OpenPrompt([])
    open_prompt.type(f"{shelf}/pl")
    open_prompt.step(1)
    assert open_prompt.take() is None and open_prompt.text == f"{shelf}/plain/"
    open_prompt.type(f"{shelf}/plain/nothing")
    assert open_prompt.take() is None and "nothing" in open_prompt.problem
    open_prompt.type(f"{shelf}/a")
    open_prompt.step(1), open_prompt.step(5)
    assert open_prompt.picked == 1
    open_prompt.step(-9)
    assert open_prompt.picked is None


def test_the_question_opens_what_is_chosen_and_remembers_scenes(app, shelf, pack_folder):
    run(app, "open")
    app.open_prompt.type(str(pack_folder))
    choose(app)
    assert app.open_prompt is None and app.loading is not None and app.loading.path == pack_folder
    app.cancel_loading()
    (shelf / "plain" / "transforms.json").write_text('{"frames": []}')
    app.drop([shelf / "plain"])
    assert app.making.plan is not None and app.preferences.recent_packs() == [(shelf / "plain").resolve()]
    app.making.dismiss(app)


def test_a_pasted_path_opens_and_a_wrong_one_is_told(app, pack, pack_folder, tmp_path):
    assert COMMANDS["paste"].enabled(app)
    app.clipboard.set(f"{pack_folder}\n")
    app.paste()
    assert app.loading is not None and app.loading.path == pack_folder
    app.cancel_loading()
    app.clipboard.set(str(tmp_path / "gone"))
    with pytest.raises(UserError, match="nothing at this path"):
        app.paste()
    app.clipboard.set("no path")
    app.paste()
    assert "no path on the clipboard" in app.messages.toast
    app.show(pack, pack_folder)
    app.clipboard.set('{"eye": [0, 0, 5], "target": [0, 0, 0]}')
    app.paste()
    assert app.scene.rig.matrix[2, 3] == pytest.approx(5.0)
