"""The check of photographs in the make dialog: the real command as a child process, and what is shown of it."""

import shutil
import tempfile
from pathlib import Path

import pytest
from PIL import Image

from tests.training.posing.rooms import cameras, photograph
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.features.making.test_making import gone
from tests.viewer.waiting import live
from viewer.app.application import App
from viewer.features.making import survey
from viewer.features.making.survey import result_lines

COUNT, DARK = 8, 4


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """An app whose dialog asks about photographs, one of them darker than the others."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    (tmp_path / "shed").mkdir()
    for i, camera in enumerate(cameras(COUNT)):
        picture = Image.fromarray(photograph(camera)).point(
            [int(v * (0.6 if i == DARK else 1.0)) for v in range(256)] * 3
        )
        picture.save(tmp_path / "shed" / f"p{i}.png")
    app = App(canvas=FakeCanvas())
    app.drop([tmp_path / "shed"])
    live(app, lambda: app.making.plan.survey.finished)
    yield app
    app.making.end()


def test_a_check_shows_its_progress_and_then_what_it_found(asked: App, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    making, opened = asked.making, []
    making.check_photographs(asked)
    check = making.check
    assert check is not None and check.running and making.busy
    live(asked, lambda: check.report is not None)
    assert check.report.stage == "check"
    live(asked, lambda: not check.running)
    assert not check.error and check.result is not None
    assert list(check.result["differently_exposed"]) == [f"p{DARK}.png"] and not check.result["set_aside"]
    assert check.page == tmp_path / "shed-snerg" / "check.html" and check.page.is_file()
    lines = [text for text, _ in result_lines(check.result)]
    assert lines[0].startswith(f"{COUNT} photographs, ") and lines[-1].startswith(
        f"1 differently exposed: p{DARK}.png ("
    )
    monkeypatch.setattr(survey.webbrowser, "open", lambda address: opened.append(address))  # and finds none
    check.open_page()
    live(asked, lambda: "No browser was found" in asked.messages.toast)
    assert opened == [check.page.as_uri()]
    making.dismiss()
    assert making.check is None


def test_a_check_whose_dialog_is_closed_is_stopped_and_leaves_nothing(asked: App, tmp_path: Path):
    asked.making.check_photographs(asked)
    pid = asked.making.check.child._child.pid
    live(asked, lambda: asked.making.check.report is not None)
    asked.making.dismiss()  # which stops it first
    assert asked.making.check is None
    live(asked, lambda: gone(pid) and not list((tmp_path / "temporary").glob("snerg-ch*")))
    assert not (tmp_path / "shed-snerg").exists() and not asked.messages.dialogs


def test_a_check_that_fails_says_why_in_one_line(asked: App, tmp_path: Path):
    shutil.rmtree(tmp_path / "shed")
    asked.making.check_photographs(asked)
    live(asked, lambda: not asked.making.check.running)
    assert asked.making.check.result is None
    assert asked.making.check.error.startswith(f"{tmp_path / 'shed'}: no such file or folder")


def test_names_beyond_the_first_few_are_counted():
    assert survey.few_with_reasons({f"{i}.jpg": "blurred" for i in range(5)}).endswith("and 2 more")
