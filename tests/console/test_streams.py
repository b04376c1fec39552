"""Standard streams that are closed before a command starts, or whose reader goes away."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# A library prints without asking Python, while a file of ours is open.
COMMAND = """
import os, sys
from pathlib import Path
from console import UserError, run_command
from console.streams import open_closed_streams

def write(out: Path, /, fail: bool = False) -> None:
    with open(out, "w") as file:
        os.write(1, b"noise"), os.write(2, b"noise")
        print("done")
        print("a warning", file=sys.stderr)
        file.write("content")
    if fail:
        raise UserError("is bad")

open_closed_streams()
sys.exit(run_command(write, prog="write"))
"""

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a shell closes the streams")


def ran(words: list[str], redirections: str) -> subprocess.CompletedProcess[str]:
    line = f'exec "$0" "$@" {redirections}'
    command = ["sh", "-c", line, sys.executable, *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
@pytest.mark.parametrize(("words", "status"), [([], 0), (["--fail"], 2), (["--unknown"], 2), (["--help"], 0)])
def test_streams_that_were_closed_before_the_start_change_neither_the_status_nor_a_file(
    closed: str, words: list[str], status: int, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = ran(["-c", COMMAND, str(out), *words], closed)
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    if not {"--unknown", "--help"} & set(words):
        assert out.read_text() == "content"


def test_names_that_are_not_utf8_are_printed(tmp_path: Path) -> None:
    script = COMMAND.replace('print("done")', 'print("a\\udcffb", "\\ud800")')
    script = script.replace('os.write(1, b"noise")', "None")
    done = ran(["-c", script, str(tmp_path / "out")], "")
    assert (done.returncode, done.stdout) == (0, "a\N{REPLACEMENT CHARACTER}b \N{REPLACEMENT CHARACTER}\n"), done.stderr
