"""Failures are shown in a box where nobody reads what is printed, and only there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FAILING = (
    "import sys; from console import UserError, run_command; from console.desktop import tell_if_unseen\n"
    "def work() -> None:\n    raise {error}\n"
    "sys.exit(run_command(work, prog='snerg-view', args=[], on_failure=tell_if_unseen))"
)

pytestmark = pytest.mark.skipif(os.name == "nt", reason="fake programs are shell scripts")


def fake(folder: Path, name: str, status: int = 0) -> Path:
    """A program on PATH that notes how it was called; where that is noted."""
    folder.mkdir(exist_ok=True)
    said = folder / f"{name}.said"
    (folder / name).write_text(f'#!/bin/sh\nfor word in "$@"; do echo "$word"; done > "{said}"\nexit {status}\n')
    (folder / name).chmod(0o755)
    return said


def fail(tmp_path: Path, error: str = "UserError('no OpenGL', remedy='install it')", display: str = ":99", **streams):
    """Runs a command that fails as a desktop starts it: without a terminal, stderr in a log."""
    environment = {
        "PATH": f"{tmp_path / 'bin'}:/bin",
        "HOME": str(tmp_path),
        "DISPLAY": display,
        "PYTHONPATH": str(ROOT),
    }
    with open(tmp_path / "log", "wb") as log:
        return subprocess.run(
            [sys.executable, "-c", FAILING.format(error=error)],
            env={name: value for name, value in environment.items() if value},
            cwd=tmp_path,
            timeout=120,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            **{"stderr": log, **streams},
        )


def test_failures_and_bugs_are_shown_in_a_box(tmp_path: Path) -> None:
    said = fake(tmp_path / "bin", "zenity")
    assert fail(tmp_path).returncode == 2
    assert "--error" in said.read_text() and "--text=no OpenGL; install it" in said.read_text()
    assert "snerg-view: no OpenGL; install it" in (tmp_path / "log").read_text()
    assert fail(tmp_path, "KeyError('depths')").returncode == 1
    assert "This is a bug in snerg: KeyError: 'depths'" in said.read_text()


def test_where_there_is_nothing_a_file_on_the_desktop_tells_it(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "Desktop").mkdir()
    assert fail(tmp_path).returncode == 2
    assert (tmp_path / "Desktop" / "snerg-view did not start.txt").read_text() == "no OpenGL; install it\n"


@pytest.mark.parametrize("streams", [{"stderr": subprocess.PIPE}, {"display": ""}])
def test_nothing_is_shown_where_somebody_reads_or_nobody_is_there(tmp_path: Path, streams: dict) -> None:
    said = fake(tmp_path / "bin", "zenity")
    assert fail(tmp_path, **streams).returncode == 2
    assert not said.exists()
