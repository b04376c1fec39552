"""Making a scene from the window: what the child process does, what is shown of it, and that it never outlives us."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui
from PIL import Image

from console import child_process
from console.progress_protocol import Report, read_report
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.waiting import until
from viewer.app.application import App
from viewer.app.commands import run
from viewer.core.command_process import CommandProcess
from viewer.features.making.make_plan import Plan
from viewer.features.making.making import Making

FAKE = Path(__file__).with_name("fake_make.py")
ROOT = FAKE.parents[4]


@pytest.fixture
def making(monkeypatch, tmp_path, pack_folder):
    """An app whose plan runs the stand-in: making("wait") begins it."""
    shutil.copytree(pack_folder, tmp_path / "source")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    app = App(canvas=FakeCanvas())

    def begin(how: str) -> App:
        command = [sys.executable, str(FAKE), how, str(tmp_path)]
        monkeypatch.setattr(Plan, "command", lambda plan: command)
        app.making.plan = Plan("scene", tmp_path / "photographs", tmp_path)
        app.making.start(app)
        return app

    yield begin
    app.making.end()


def live(app: App, until, seconds: float = 30.0) -> None:
    """Lets time pass for the app until something is so."""
    end = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < end, "it takes too long"
        app.tick(0.02)
        time.sleep(0.02)


def working(app: App):
    return lambda: app.making.job is None or app.making.job.report is not None


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_a_scene_is_made_and_opens_by_itself(making, tmp_path):
    app = making("make")
    live(app, working(app))
    live(app, lambda: app.making.job is None and app.loading is None)
    assert app.scene is not None and app.scene.path == tmp_path / "pack" and not app.messages.dialogs


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
    live(app, lambda: (tmp_path / "pid").exists())
    pid = int((tmp_path / "pid").read_text())
    app.making.stop(app)
    assert app.making.job.stopping
    live(app, lambda: app.making.job is None)
    assert (tmp_path / "saved").exists() and gone(pid) and not app.messages.dialogs
    assert "make it again" in app.messages.toast
    assert "saved at step 40" in (tmp_path / "make.log").read_text()


def test_a_child_that_does_not_hear_is_ended_all_the_same(making, tmp_path, monkeypatch):
    app = making("deaf")
    live(app, lambda: (tmp_path / "pid").exists())
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
    assert run(app, "make-again") and app.making.plan.source == tmp_path / "photographs"


def test_a_child_that_the_system_kills_is_told_as_such(making):
    app = making("die")
    live(app, lambda: app.making.job is None)
    assert "SIGKILL" in app.messages.dialogs[0].text and "memory" in app.messages.dialogs[0].text


def test_a_bug_of_the_child_is_told_as_one(making):
    app = making("bug")
    live(app, lambda: app.making.job is None)
    assert app.messages.dialogs[0].text.startswith("This is a bug in snerg (KeyError: 'depths')")


def test_quitting_asks_first_and_leaves_no_child(making, tmp_path):
    app = making("wait")
    live(app, lambda: (tmp_path / "pid").exists())
    pid = int((tmp_path / "pid").read_text())
    run(app, "quit")
    run(app, "quit")
    assert not app.quitting and len(app.messages.dialogs) == 1
    answers = dict(app.messages.dialogs.pop().buttons)
    run(app, answers["Stop and quit"])
    live(app, lambda: app.quitting)
    assert (tmp_path / "saved").exists() and gone(pid)
    assert run(App(), "quit")


def test_a_window_that_closes_at_once_leaves_no_child(making, tmp_path):
    app = making("wait")
    live(app, lambda: (tmp_path / "pid").exists())
    app.making.end()
    assert gone(int((tmp_path / "pid").read_text())) and (tmp_path / "saved").exists()


def test_a_viewer_that_is_killed_leaves_no_child(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from viewer.core.command_process import CommandProcess\n"
        f"CommandProcess([sys.executable, {str(FAKE)!r}, 'wait', {str(tmp_path)!r}], Path({str(tmp_path / 'log')!r}))\n"
        "time.sleep(60)"
    )
    viewer = subprocess.Popen([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)})
    end = time.monotonic() + 30
    while not (tmp_path / "pid").exists() and time.monotonic() < end:
        time.sleep(0.05)
    viewer.send_signal(signal.SIGKILL)
    viewer.wait()
    while not (tmp_path / "saved").exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert (tmp_path / "saved").exists()


def test_a_child_can_be_watched_from_its_file_alone(tmp_path):
    assert read_report(tmp_path / "none") is None
    (tmp_path / "broken").write_text('{"title": 3')
    assert read_report(tmp_path / "broken") is None
    assert Report("training", 25, 100, "", 10.0).share == 0.25


def test_a_program_that_is_not_there_is_told(tmp_path):
    from console import UserError

    with pytest.raises(UserError, match="cannot be started"):
        CommandProcess([str(tmp_path / "none")], tmp_path / "log")


def test_the_question_and_the_card_are_drawn_and_answered(offscreen, making, scene, monkeypatch):
    command = Plan.command
    app = making("wait")
    live(app, working(app))
    app.making.job.picture = np.full((64, 128, 3), (200, 40, 40), np.uint8)
    app.making.job.figures = [18.0, 20.0, 21.5]
    ui = offscreen(app)
    ui.settle()
    card = ui.picture()[400:, 20:380].astype(int)
    assert (np.abs(card - (200, 40, 40)).sum(axis=2) < 12).mean() > 0.2
    assert ui.ctx.error == "GL_NO_ERROR"
    ui.click(330, 560)  # nothing there
    app.making.end()
    monkeypatch.setattr(Plan, "command", command)
    app.drop([scene])
    until(lambda: app.making.plan.survey.finished)
    ui.settle()
    ui.key(imgui.Key.space)  # keys wait for the answer
    assert app.making.plan is not None
    ui.key(imgui.Key.escape)
    assert app.making.plan is None and ui.ctx.error == "GL_NO_ERROR"


def test_nothing_is_looked_at_while_nothing_is_made():
    assert not Making().busy


@pytest.mark.slow
def told_stage(job) -> str:
    return job.report.stage if job.report else ""


def test_photographs_become_a_scene_through_the_real_programs_even_when_stopped_between(scene, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setattr(child_process, "POLITENESS", 0)  # other tests would go first
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "compiled"))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    app = App(canvas=FakeCanvas())

    def begin(steps: int) -> None:
        app.drop([scene])
        plan = app.making.plan
        plan.choose(tmp_path / "made")
        plan.preset, plan.steps, plan.resolution = "tiny", steps, 32
        app.making.start(app)

    begin(100_000)
    try:
        live(app, lambda: app.making.job is None or told_stage(app.making.job) == "training", 300)
        app.making.stop(app)  # while its first step is being compiled
        live(app, lambda: app.making.job is None, 300)
        assert not app.messages.dialogs and "was stopped" in app.messages.toast
        assert list((tmp_path / "made" / "run" / "checkpoints").glob("*.safetensors"))
        begin(1)  # as many as are done
        live(app, lambda: app.making.job is None and app.loading is None, 300)
    finally:
        app.making.end()
    assert not app.messages.dialogs and app.scene.path == tmp_path / "made" / "pack"
