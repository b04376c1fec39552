"""What was changed is kept however the program ends: killed, asked by a signal, left without a display, closed."""

import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.viewer.conftest import installed
from tests.viewer.features.making.conftest import FAKE
from tests.viewer.screen import virtual_screen
from tests.viewer.waiting import is_gone, until
from tests.viewer.window.running import RunningViewer

# snerg-view in which fake_make.py is at work: python -c MAKING FOLDER FAKE
MAKING = """
import sys
from pathlib import Path
from viewer.commands import view
from viewer.features.making.make_plan import Plan
folder, start = Path(sys.argv[1]), view.apply_preferences
Plan.command = lambda plan: [sys.executable, sys.argv[2], "wait", str(folder)]
def use(app, preferences):
    start(app, preferences)
    app.making.plan = Plan("scene", folder / "photographs", folder)
    app.making.start(app)
view.apply_preferences = use
sys.exit(view.main([]))
"""


@pytest.fixture
def viewer(display: str, tmp_path: Path, pack_folder: Path) -> Iterator[RunningViewer]:
    """A viewer with the toy open."""
    with RunningViewer(display, tmp_path / "home", pack_folder, "--size", "900x600") as running:
        until(lambda: running.saved.get("recent"))
        yield running


def test_what_was_changed_outlives_kill_9(viewer: RunningViewer, pack_folder: Path) -> None:
    assert viewer.saved["recent"] == [str(pack_folder)]
    viewer.xdotool("windowfocus", "--sync", viewer.window, "key", "ctrl+shift+l")
    until(lambda: viewer.saved.get("theme") == "light")
    assert viewer.saved["window"] == [900, 600] and "Docking" in viewer.saved["layout"]
    assert viewer.signal(signal.SIGKILL) == -signal.SIGKILL
    assert viewer.saved["theme"] == "light"
    assert [path.name for path in viewer.file.parent.iterdir()] == ["viewer.json"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_like_quit_and_is_told_in_the_exit_status(viewer: RunningViewer, number: int) -> None:
    assert viewer.signal(number) == 128 + number
    assert "Traceback" not in viewer.errors()
    assert viewer.saved["recent"]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGTERM", "SIGHUP", "display"])
def test_what_is_being_made_saves_when_the_session_ends(tmp_path, how):
    command = [sys.executable, "-c", MAKING, str(tmp_path), str(FAKE)]
    with (
        virtual_screen(installed("Xvfb")) as (name, server),
        RunningViewer(name, tmp_path / "home", command=command) as viewer,
    ):
        until((tmp_path / "pid").exists)
        until(lambda: viewer.saved)
        if how == "display":
            server.kill()
            assert viewer.process.wait(60) == 129
            errors = viewer.errors()
            assert "the connection to the display is lost; settings are saved" in errors and "Traceback" not in errors
        else:
            number = getattr(signal, how)
            assert viewer.signal(number) == 128 + number
        until((tmp_path / "saved").exists)  # before the viewer ended, but on a busy machine
        until(lambda: is_gone(int((tmp_path / "pid").read_text())))


@pytest.mark.slow
def test_a_crash_leaves_a_log_with_the_last_commands_and_the_next_start_says_where(viewer, display, pack_folder):
    logs = viewer.home / "state" / "snerg" / "log"
    (running,) = logs.glob("running-*.log")
    viewer.xdotool("windowfocus", "--sync", viewer.window, "key", "ctrl+shift+l", "key", "KP_Space")
    until(lambda: "command theme" in running.read_text())
    assert viewer.signal(signal.SIGSEGV) == -signal.SIGSEGV  # as a driver would bring it down
    text = running.read_text()
    assert "OpenGL" in text and "llvmpipe" in text and "Segmentation fault" in text and "Current thread" in text
    with RunningViewer(display, viewer.home, pack_folder) as again:
        (crashed,) = until(lambda: list(logs.glob("crash-*.log")))
        (log,) = until(lambda: list(logs.glob("running-*.log")))
        until(lambda: f"Its log: {crashed}" in log.read_text())
        assert crashed.read_text() == text
        again.xdotool("windowfocus", "--sync", again.window, "key", "ctrl+q")
        assert again.process.wait(60) == 0
    assert [path.name for path in logs.iterdir()] == [crashed.name]
