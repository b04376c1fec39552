"""Where no temporary folder can be made, what needs one says so in one line."""

from __future__ import annotations

import errno
import os
import sys
import tempfile
from pathlib import Path

import pytest

from console import UserError, refusal
from viewer.core.command_process import CommandProcess


def test_no_temporary_folder_is_told_with_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: [str(tmp_path / "none")])
    with pytest.raises(UserError, match=r"no temporary folder can be written.*TMPDIR"):
        CommandProcess([sys.executable, "-c", ""], tmp_path / "log")
    with pytest.raises(FileNotFoundError) as told:
        tempfile.gettempdir()
    assert "TMPDIR" in (refusal(told.value) or "")
    assert refusal(FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), "scene.json")) is None
