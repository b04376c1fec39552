"""What is left of a viewer that crashes, and what is said where no temporary folder can be made."""

import errno
import os
import sys
import tempfile
from pathlib import Path

import pytest

from console import UserError, refusal
from viewer.core.log import CrashLog, left_behind
from viewer.core.tasks import CommandProcess


def test_a_bug_leaves_versions_commands_and_its_traceback(tmp_path, app, pack, pack_folder):
    log = CrashLog(tmp_path)
    app.messages.crash_log = log.add
    app.show(pack, pack_folder)
    app.run("next-mode")
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


def test_no_temporary_folder_is_told_with_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: [str(tmp_path / "none")])
    with pytest.raises(UserError, match=r"no temporary folder can be written.*TMPDIR"):
        CommandProcess([sys.executable, "-c", ""], tmp_path / "log")
    with pytest.raises(FileNotFoundError) as raised:
        tempfile.gettempdir()
    assert "TMPDIR" in (refusal(raised.value) or "")
    assert refusal(FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), "scene.json")) is None
