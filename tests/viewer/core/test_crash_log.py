"""What is left of a viewer that crashes, and that nothing is left of one that ends as it should."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from viewer.app.commands import run
from viewer.core import log as log_module
from viewer.core.log import KEPT, CrashLog, left_behind


def test_nothing_is_left_of_a_good_end(tmp_path):
    log = CrashLog(tmp_path)
    log.add("command home")
    assert left_behind(tmp_path) == []  # it runs
    log.end()
    assert not list(tmp_path.iterdir())
    log.add("after the end")


def test_a_bug_leaves_versions_commands_and_its_traceback(tmp_path, app, pack, pack_folder):
    log = CrashLog(tmp_path)
    app.messages.crash_log = log.add
    app.show(pack, pack_folder)
    run(app, "next-mode")
    app.messages.say("something was said", "warning")
    try:
        raise RuntimeError("a bug of ours")
    except RuntimeError as error:
        log.crash(error)
    (found,) = left_behind(tmp_path)
    text = found.read_text()
    for part in ("Python 3", "snerg 0", "imgui-bundle", "command next-mode", "warning: something was said"):
        assert part in text, part
    assert "a bug of ours" in text and "Traceback" in text
    assert left_behind(tmp_path) == [] and found.exists()  # told once, and kept


CRASH = """
import sys, ctypes
from pathlib import Path
from viewer.core.log import CrashLog
log = CrashLog(Path(sys.argv[1]))
log.add("command fly")
ctypes.string_at(0)
"""


def test_what_a_driver_does_to_the_process_is_written_down_too(tmp_path):
    done = subprocess.run([sys.executable, "-c", CRASH, str(tmp_path)], capture_output=True, timeout=120)
    assert done.returncode != 0
    (found,) = left_behind(tmp_path)
    text = found.read_text()
    assert "command fly" in text and "Segmentation fault" in text and 'File "<string>"' in text


def test_only_the_last_crashes_are_kept(tmp_path):
    for i in range(KEPT + 4):
        old = tmp_path / f"crash-{i}.log"
        old.write_text("x")
        os.utime(old, (1000 + i, 1000 + i))
    (tmp_path / "running-1.log").write_text("newest")
    (found,) = left_behind(tmp_path)
    assert found.read_text() == "newest" and len(list(tmp_path.iterdir())) == KEPT


def test_a_long_session_writes_no_endless_file(tmp_path, monkeypatch):
    monkeypatch.setattr(log_module, "MOST_BYTES", 4000)
    log = CrashLog(tmp_path)
    for i in range(400):
        log.add(f"command number {i} " + 20 * "x")
    assert (
        log.path.stat().st_size < 5000 and "number 399" in log.path.read_text() and "Python 3" in log.path.read_text()
    )
    log.end()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_stops_nobody(tmp_path):
    tmp_path.chmod(0o500)
    CrashLog(tmp_path / "logs").end()


def test_a_file_in_the_folder_s_place_stops_nobody(tmp_path):
    (tmp_path / "logs").write_text("a file")
    log = CrashLog(Path(tmp_path / "logs"))
    log.add("command home")
    log.end()
    assert left_behind(tmp_path / "logs") == []
