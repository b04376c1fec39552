"""Making a scene from the window: what the child process does, what is shown of it, and that it never outlives us."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from PIL import Image

from console import child_process
from scenepack import save_pack
from tests.training.posing.rooms import cameras, photograph
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.features.making.conftest import FAKE, ROOT
from tests.viewer.waiting import live, there, until
from viewer.app.application import App
from viewer.features.making import survey
from viewer.features.making.make_job import preview_title
from viewer.features.making.survey import result_lines


def stage_of(app: App) -> str:
    report = there(app.making.job).report
    return "" if report is None else report.stage


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_progress_is_shown_while_the_child_works(making, tmp_path):
    app = making("wait")
    live(app, lambda: app.making.job.report is not None and app.making.job.report.done == 40)
    job = app.making.job
    assert job.stage == 1 and job.figures == [21.5] and job.report.share == 0.4
    (job.plan.run / "validation").mkdir(parents=True)
    Image.new("RGB", (1024, 512), (200, 10, 10)).save(job.plan.run / "validation" / "latest.png")
    live(app, lambda: job.picture is not None)
    assert job.picture.shape == (256, 512, 3)
    app.drop([tmp_path / "photographs"])  # gone: opened as a pack, which it is not
    app.making.offer(app, "scene", tmp_path)
    assert "One scene at a time" in [dialog.title for dialog in app.messages.dialogs]


def test_stopping_lets_the_child_save_and_a_later_attempt_goes_on(making, tmp_path):
    app = making("wait")
    live(app, (tmp_path / "pid").exists)
    pid = int((tmp_path / "pid").read_text())
    app.making.stop(app)
    assert app.making.job.child.stopping
    live(app, lambda: app.making.job is None)
    assert (tmp_path / "saved").exists() and gone(pid) and not app.messages.dialogs
    assert "make it again" in app.messages.toast
    assert "saved at step 40" in (tmp_path / "make.log").read_text()


def test_a_child_that_does_not_hear_is_ended_all_the_same(making, tmp_path, monkeypatch):
    app = making("deaf")
    live(app, (tmp_path / "pid").exists)
    pid = int((tmp_path / "pid").read_text())
    app.making.stop(app)
    app.making.stop(app)  # in a hurry
    live(app, lambda: app.making.job is None)
    assert gone(pid) and not app.messages.dialogs


def test_a_failure_is_a_dialog_with_its_line_and_its_log_and_can_be_tried_again(making, tmp_path):
    app = making("fail")
    live(app, lambda: app.making.job is None)
    dialog = app.messages.dialogs[0]
    assert "could not be made" in dialog.title
    assert dialog.text.startswith(f"{tmp_path}: the folder is empty; choose another")
    assert str(tmp_path / "make.log") in dialog.text and "Traceback" not in dialog.text
    app.messages.dialogs.clear()
    assert app.run("make-again") and app.making.plan.source == tmp_path / "photographs"


def test_quitting_asks_first_and_leaves_no_child(making, tmp_path):
    app = making("wait")
    live(app, (tmp_path / "pid").exists)
    pid = int((tmp_path / "pid").read_text())
    app.run("quit")
    app.run("quit")
    assert not app.quitting and len(app.messages.dialogs) == 1
    answers = dict(app.messages.dialogs.pop().buttons)
    app.run(answers["Stop and quit"])
    live(app, lambda: app.quitting)
    assert (tmp_path / "saved").exists() and gone(pid)
    assert App().run("quit")


def test_a_viewer_that_is_killed_leaves_no_child(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from viewer.core.tasks import CommandProcess\n"
        f"CommandProcess([sys.executable, {str(FAKE)!r}, 'wait', {str(tmp_path)!r}], Path({str(tmp_path / 'log')!r}))\n"
        "time.sleep(60)"
    )
    viewer = subprocess.Popen([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)})
    until((tmp_path / "pid").exists)
    viewer.send_signal(signal.SIGKILL)
    viewer.wait()
    until((tmp_path / "saved").exists)


@pytest.mark.slow
def test_photographs_become_a_scene_through_the_real_programs_even_when_stopped_between(scene, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setattr(child_process, "POLITENESS", 0)  # other tests would go first
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "compiled"))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    app = App(canvas=FakeCanvas())

    def begin(steps: int) -> None:
        app.drop([scene])
        plan = there(app.making.plan)
        plan.choose(tmp_path / "made")
        plan.preset, plan.steps, plan.resolution = "tiny", steps, 32
        app.making.start(app)

    begin(100_000)
    try:
        live(app, lambda: app.making.job is None or stage_of(app) == "training", 300)
        app.making.stop(app)  # while its first step is being compiled
        live(app, lambda: app.making.job is None, 300)
        assert not app.messages.dialogs and "was stopped" in app.messages.toast
        assert list((tmp_path / "made" / "run" / "checkpoints").glob("*.safetensors"))
        begin(1)  # as many as are done
        live(app, lambda: app.making.job is None and app.loading is None, 300)
    finally:
        app.making.end()
    assert not app.messages.dialogs and app.open_scene.path == tmp_path / "made" / "pack"


# What is trained so far is shown as it comes, with the camera where the hands put it, and never in place of something else


@pytest.fixture
def write(tmp_path, pack):
    """Writes what is trained after so many steps, as the child does."""

    def call(steps: int) -> None:
        made = {"steps": steps, "of_steps": 6000, "preview": True}
        save_pack(pack.with_metadata(provenance=made), tmp_path / "preview.zip")

    return call


def came(app: App, steps: int) -> bool:
    preview = there(app.making.job).preview
    return preview is not None and f" {steps:,} " in preview_title(preview)


def test_what_is_trained_so_far_is_shown_by_itself_and_then_the_pack_while_the_camera_stays(making, write, tmp_path):
    app = making("until-told")
    live(app, lambda: app.making.job.report is not None)
    assert app.scene is None
    write(1200)
    live(app, lambda: came(app, 1200))
    assert app.open_scene.name == "photographs: preview after 1,200 steps" and app.making.training_preview_shown(app)
    assert app.canvas.shown == [app.making.job.preview] and app.preferences.recent == []
    untouched = app.open_scene.rig.goal
    app.open_scene.rig.orbit(80.0, 15.0)
    chosen, fov = app.open_scene.rig.goal, app.fov
    assert chosen != untouched
    live(app, lambda: app.scene.rig.shown == app.scene.rig.goal)
    write(2400)
    live(app, lambda: came(app, 2400))
    assert app.open_scene.name.endswith("2,400 steps") and app.open_scene.pack is app.making.job.preview
    assert app.open_scene.rig.goal == app.open_scene.rig.shown == chosen
    assert app.canvas.shown == [app.making.job.preview], "refined in place: nothing is blank in between"
    (tmp_path / "go").touch()
    live(app, lambda: app.making.job is None and app.loading is None)
    assert app.open_scene.path == tmp_path / "pack" and not app.messages.dialogs
    assert app.open_scene.rig.goal == chosen and app.fov == fov


def test_a_scene_that_is_open_is_not_taken_away(making, write, pack, pack_folder):
    app = making("until-told")
    app.show(pack, pack_folder)
    write(1200)
    live(app, lambda: came(app, 1200))
    assert app.scene.path == pack_folder and not app.making.training_preview_shown(app)
    app.making.show_training_preview(app)
    assert app.making.training_preview_shown(app)
    app.show(pack, pack_folder)
    write(2400)
    live(app, lambda: came(app, 2400))
    assert app.scene.path == pack_folder, "whoever has gone elsewhere stays there"


# The check of photographs in the make dialog: the real command as a child process, and what is shown of it


COUNT, DARK = 8, 4


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """An app whose dialog asks about photographs, one of them darker than the others."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    (tmp_path / "shed").mkdir()
    for i, camera in enumerate(cameras(COUNT)):
        picture = Image.fromarray(photograph(camera)).point(lambda v, light=0.6 if i == DARK else 1.0: int(v * light))
        picture.save(tmp_path / "shed" / f"p{i}.png")
    app = App(canvas=FakeCanvas())
    app.drop([tmp_path / "shed"])
    live(app, lambda: there(there(app.making.plan).survey).finished)
    yield app
    app.making.end()


def test_a_check_shows_its_progress_and_then_what_it_found(asked: App, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    making, opened = asked.making, []
    making.check_photographs(asked)
    check = making.check
    assert check is not None and check.running and making.busy
    live(asked, lambda: check.report is not None)
    assert there(check.report).stage == "check"
    live(asked, lambda: not check.running)
    assert not check.error and check.result is not None
    assert list(check.result["differently_exposed"]) == [f"p{DARK}.png"] and not check.result["set_aside"]
    assert check.page == tmp_path / "shed-snerg" / "check.html" and check.page.is_file()
    lines = [text for text, _ in result_lines(check.result)]
    assert lines[0].startswith(f"{COUNT} photographs, ")
    assert lines[-1].startswith(f"1 differently exposed: p{DARK}.png (")
    monkeypatch.setattr(survey.webbrowser, "open", lambda address: opened.append(address))  # and finds none
    check.open_page()
    live(asked, lambda: "No browser was found" in asked.messages.toast)
    assert opened == [check.page.as_uri()]
    making.dismiss()
    assert making.check is None


def test_a_check_whose_dialog_is_closed_is_stopped_and_leaves_nothing(asked: App, tmp_path: Path):
    asked.making.check_photographs(asked)
    check = there(asked.making.check)
    live(asked, lambda: check.report is not None)
    pid = check.child._child.pid
    asked.making.dismiss()  # which stops it first
    assert asked.making.check is None
    live(asked, lambda: gone(pid) and not list((tmp_path / "temporary").glob("snerg-ch*")))
    assert not (tmp_path / "shed-snerg").exists() and not asked.messages.dialogs


def test_a_check_that_fails_says_why_in_one_line(asked: App, tmp_path: Path):
    shutil.rmtree(tmp_path / "shed")
    asked.making.check_photographs(asked)
    check = there(asked.making.check)
    live(asked, lambda: not check.running)
    assert check.result is None and check.error.startswith(f"{tmp_path / 'shed'}: no such file or folder")


def test_names_beyond_the_first_few_are_counted():
    assert survey.few_with_reasons({f"{i}.jpg": "blurred" for i in range(5)}).endswith("and 2 more")
