"""Making a scene from the window: what the child process does, what is shown of it, and that it never outlives us."""

import os
import signal
import subprocess
import sys

import pytest
from PIL import Image

from console import child_process
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.features.making.conftest import FAKE, ROOT
from tests.viewer.waiting import live, until
from viewer.app.application import App


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
        "import sys, time; from pathlib import Path; from viewer.core.command_process import CommandProcess\n"
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
        plan = app.making.plan
        plan.choose(tmp_path / "made")
        plan.preset, plan.steps, plan.resolution = "tiny", steps, 32
        app.making.start(app)

    begin(100_000)
    try:
        job = app.making.job
        live(app, lambda: app.making.job is None or (job.report and job.report.stage == "training"), 300)
        app.making.stop(app)  # while its first step is being compiled
        live(app, lambda: app.making.job is None, 300)
        assert not app.messages.dialogs and "was stopped" in app.messages.toast
        assert list((tmp_path / "made" / "run" / "checkpoints").glob("*.safetensors"))
        begin(1)  # as many as are done
        live(app, lambda: app.making.job is None and app.loading is None, 300)
    finally:
        app.making.end()
    assert not app.messages.dialogs and app.scene.path == tmp_path / "made" / "pack"
