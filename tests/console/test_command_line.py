"""run_command: arguments in, exit status out, one line on stderr, or a box where nobody reads what is printed."""

import errno
import os
import subprocess
import sys
from pathlib import Path
from threading import Barrier, Thread
from typing import Literal

import pytest

from console import Notice, UserError, collect_notices, notify, run_command
from console.command_line import parse_point, parse_size
from console.errors import handle_notices
from tests.stand_ins import raising

ROOT = Path(__file__).parents[2]


def train(
    scene: Path, /, out: Path, preset: Literal["cpu", "fast"] = "cpu", max_steps: int = 3, resume: bool = False
) -> int | None:
    """Trains.

    Args:
        scene: The scene, a folder.
        out: The run.
        preset: How much work.
        max_steps: Optimiser
            steps, all in
            all.
        resume: Go on from the last checkpoint.
    """
    print(scene, out, preset, max_steps, resume)
    return 3 if max_steps == 33 else None


def test_parameters_become_options_and_flags_and_a_number_returned_the_status(capsys):
    assert run_command(train, prog="t", args=["S", "--out", "O", "--max-steps", "5", "--resume"]) == 0
    assert capsys.readouterr().out == "S O cpu 5 True\n"
    assert run_command({"train": train, "stop": lambda: None}, prog="t", args=["train", "S", "--out", "O"]) == 0
    assert capsys.readouterr().out == "S O cpu 3 False\n"
    assert run_command(train, prog="t", args=["S", "--out", "O", "--max-steps", "33"]) == 3


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("", ["missing: PATH, --out PATH"]),
        ("S", ["missing: --out PATH"]),
        ("S --oyt O", ["missing: --out PATH", "--oyt"]),
        ("S --out O --max-steps many", ["--max-steps", "many"]),
        ("S --out O --preset slow", ["--preset", "slow", "cpu", "fast"]),
        ("S --out O --loud", ["--loud"]),
        ("S --out", ["--out"]),
        ("S --out O --max-steps " + "9" * 100 + "x", ["9" * 100]),
    ],
)
def test_bad_arguments_are_status_two_and_one_line(words, expected, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    assert run_command(train, prog="snerg-t", args=words.split()) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert err.startswith("snerg-t: ") and err.endswith("; see snerg-t --help\n")
    assert not set(err) & set("╭╰│─"), err
    for word in expected:
        assert word in err


def test_help_has_defaults_and_no_negative_flags_and_breaks_lines_where_the_terminal_ends(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    assert run_command(train, prog="snerg-t", args=["--help"]) == 0
    out, err = capsys.readouterr()
    assert "Optimiser steps, all in all. (default: 3)" in out and "--resume " in out and "--no-resume" not in out
    assert err == ""


WRONG = UserError("is\nwrong", where="a.png", expected=3, found=4, remedy="correct it")


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (WRONG, 2, "a.png: is wrong (expected 3, found 4); correct it"),
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/a/b"), 2, "/a/b: the disk is full"),
        (OSError(errno.EACCES, os.strerror(errno.EACCES), "/a/b"), 2, "/a/b: Permission denied"),
        (OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG), "/a/b"), 2, "/a/b: File name too long"),
        (KeyboardInterrupt("go on with --resume"), 130, "interrupted; go on with --resume"),
    ],
)
def test_what_is_no_bug_is_one_line(error: BaseException, status: int, said: str, capsys) -> None:
    assert run_command(raising(error), prog="p", args=[]) == status
    assert capsys.readouterr().err == f"p: {said}\n"
    assert run_command(raising(MemoryError()), prog="p", args=[]) == 2


def test_a_bug_and_whatever_fails_under_debug_come_with_their_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(raising(UserError("wrong")), prog="p", args=["--debug"]) == 2
    err = capsys.readouterr().err
    assert "Traceback" in err and err.endswith("p: wrong\n")
    assert run_command(raising(ValueError("oops")), prog="p", args=[]) == 1
    err = capsys.readouterr().err
    assert "Traceback" in err and "ValueError: oops" in err


def test_notices_are_one_plain_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    def command() -> None:
        for _ in range(2):
            notify(Notice("left\nout"))

    assert run_command(command, prog="p", args=[]) == 0
    assert capsys.readouterr().err == "p: warning: left out\n" * 2
    assert run_command(lambda: None, prog="p", args=[]) == 0


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_a_reader_that_goes_away_does_not_stop_the_work(stream: str, tmp_path: Path) -> None:
    """As in `snerg-train ... 2>&1 | head -1`: its checkpoints are wanted, whoever reads what it says."""
    code = (
        "import sys\nfrom pathlib import Path\nfrom console import UserError, progress, run_command\n"
        "def c():\n    'Works.'\n"
        f"    for i in range(20000): print('line', i, file=sys.{stream}, flush=True)\n"
        "    with progress('working', 2) as bar: bar.advance()\n"
        "    Path(sys.argv[1]).write_text('done')\n"
        "    raise UserError('and then it fails')\n"
        "raise SystemExit(run_command(c, prog='p', args=[]))"
    )
    line = [sys.executable, "-c", code, str(tmp_path / "result")]
    child = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    reader, other = (child.stdout, child.stderr) if stream == "stdout" else (child.stderr, child.stdout)
    assert reader is not None and other is not None
    reader.readline()
    reader.close()
    assert child.wait(120) == 2 and (tmp_path / "result").read_text() == "done"
    assert other.read() == (b"p: and then it fails\n" if stream == "stdout" else b"")
    other.close()


def test_a_thread_that_collects_notices_hears_its_own_alone(capsys: pytest.CaptureFixture[str]) -> None:
    collected, handling = [], Barrier(2)

    def collect() -> None:
        with collect_notices() as texts:
            handling.wait()  # until another thread has begun to handle notices
            notify(Notice("of the thread"))
            collected.extend(texts)

    def command() -> None:
        thread = Thread(target=collect)
        thread.start()
        with handle_notices(lambda _: None, show_too=True):
            handling.wait()
            notify(Notice("of the command"))
            thread.join()

    assert run_command(command, prog="p", args=[]) == 0
    assert collected == ["of the thread"] and capsys.readouterr().err == "p: warning: of the command\n"


@pytest.mark.parametrize("kind", ["error", "warning"])
def test_no_control_character_reaches_the_terminal_and_no_line_is_endless(kind, capsys):
    name = "\x1b[31m\x1b]0;title\x07\x9b2J" + "a" * 1_000_000 + "end"

    def command() -> None:
        if kind == "error":
            raise UserError("is not a pack", where=name)
        notify(Notice(f"{name}: is not a pack"))

    assert run_command(command, prog="p", args=[]) == (2 if kind == "error" else 0)
    err = capsys.readouterr().err
    assert err.endswith("is not a pack\n") and len(err) < 3000 and "a … a" in err
    assert not [character for character in err[:-1] if not character.isprintable()]


@pytest.mark.parametrize("text", ["", "800", "800x", "0x10", "-8x8", "8x8x8", "20000x10", "8.5x8"])
def test_what_is_no_size_is_told_in_one_line(text: str) -> None:
    with pytest.raises(UserError, match=r"--export-size: .*WxH such as 800x600"):
        parse_size(text, "--export-size")


def test_a_size_is_width_by_height_with_a_least_side_and_a_point_three_finite_numbers() -> None:
    assert parse_size("1280x800") == parse_size(" 1280×800 ", least=64) == (1280, 800)
    with pytest.raises(UserError, match="sides of 64 to 16384"):
        parse_size("63x64", least=64)
    assert parse_point("1,-2.5,3e2", "--eye") == (1.0, -2.5, 300.0)
    with pytest.raises(UserError, match="3 such as 1,2,3"):
        parse_point("1,2,inf", "--eye")


# A library prints without asking Python, while a file of ours is open.
WRITES = """
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


def ran(words: list[str], redirections: str) -> subprocess.CompletedProcess[str]:
    line = f'exec "$0" "$@" {redirections}'
    command = ["sh", "-c", line, sys.executable, *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)


@pytest.mark.skipif(sys.platform == "win32", reason="a shell closes the streams")
@pytest.mark.parametrize(
    ("closed", "words", "status"),
    [(">&-", [], 0), ("<&- >&- 2>&-", ["--fail"], 2), (">&-", ["--help"], 0), ("2>&-", ["--unknown"], 2)],
)  # fmt: skip
def test_streams_that_were_closed_before_the_start_change_neither_status_nor_file(closed, words, status, tmp_path):
    out = tmp_path / "out"
    done = ran(["-c", WRITES, str(out), *words], closed)
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    if not {"--unknown", "--help"} & set(words):
        assert out.read_text() == "content"


@pytest.mark.skipif(sys.platform == "win32", reason="a shell begins it")
def test_names_that_are_not_utf8_are_printed(tmp_path: Path) -> None:
    script = WRITES.replace('print("done")', 'print("a\\udcffb", "\\ud800")')
    script = script.replace('os.write(1, b"noise")', "None")
    done = ran(["-c", script, str(tmp_path / "out")], "")
    assert (done.returncode, done.stdout) == (0, "a\N{REPLACEMENT CHARACTER}b \N{REPLACEMENT CHARACTER}\n"), done.stderr


FAILING = (
    "import sys; from console import UserError, run_command; from console.desktop import tell_if_unseen\n"
    "def work() -> None:\n    raise {error}\n"
    "sys.exit(run_command(work, prog='snerg-view', args=[], on_failure=tell_if_unseen))"
)

by_scripts = pytest.mark.skipif(os.name == "nt", reason="fake programs are shell scripts")


def fake_zenity(folder: Path) -> Path:
    """A program on PATH that notes how it was called; where that is noted."""
    folder.mkdir()
    said = folder / "said"
    (folder / "zenity").write_text(f'#!/bin/sh\nfor word in "$@"; do echo "$word"; done > "{said}"\n')
    (folder / "zenity").chmod(0o755)
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
            env=environment,
            cwd=tmp_path,
            timeout=120,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            **{"stderr": log, **streams},
        )


@by_scripts
def test_failures_and_bugs_are_shown_in_a_box(tmp_path: Path) -> None:
    said = fake_zenity(tmp_path / "bin")
    assert fail(tmp_path).returncode == 2
    assert "--error" in said.read_text() and "--text=no OpenGL; install it" in said.read_text()
    assert "snerg-view: no OpenGL; install it" in (tmp_path / "log").read_text()
    assert fail(tmp_path, "KeyError('depths')").returncode == 1
    assert "This is a bug in snerg: KeyError: 'depths'" in said.read_text()


@by_scripts
def test_where_there_is_nothing_a_file_on_the_desktop_tells_it(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "Desktop").mkdir()
    assert fail(tmp_path).returncode == 2
    assert (tmp_path / "Desktop" / "snerg-view did not start.txt").read_text() == "no OpenGL; install it\n"


@by_scripts
@pytest.mark.parametrize("streams", [{"stderr": subprocess.PIPE}, {"display": ""}])
def test_nothing_is_shown_where_somebody_reads_or_nobody_is_there(tmp_path: Path, streams: dict) -> None:
    said = fake_zenity(tmp_path / "bin")
    assert fail(tmp_path, **streams).returncode == 2
    assert not said.exists()
