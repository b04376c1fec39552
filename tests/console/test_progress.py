"""Progress without a terminal: plain lines, rarely, with the time left."""

from __future__ import annotations

import sys
from collections.abc import Callable

import pytest

from console import progress
from console.progress import duration


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    now = [100.0]
    monkeypatch.setattr(sys.modules["console.progress"].time, "monotonic", lambda: now[0])
    return lambda seconds: now.__setitem__(0, 100.0 + seconds)


def test_plain_lines_come_every_ten_seconds_and_at_the_end(
    clock: Callable[[float], None], capsys: pytest.CaptureFixture[str]
) -> None:
    with progress("training", 100) as bar:
        for step in range(1, 101):
            clock(step / 2)
            bar.update(step, f"PSNR {step}")
        bar.update(100)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "training: 4 %  2 s, 48 s left  PSNR 4"
    assert lines[-1] == "training: 100 %  50 s  PSNR 100"
    assert len(lines) == 6


def test_work_done_at_once_says_nothing(clock: Callable[[float], None], capsys: pytest.CaptureFixture[str]) -> None:
    with progress("reading", 3) as bar:
        for _ in range(3):
            bar.advance()
    assert capsys.readouterr().err == ""
    with progress("nothing", 0) as bar:
        clock(5)
        bar.update(0)
    assert capsys.readouterr().err == "nothing: 100 %  5 s\n"


def test_no_estimate_is_made_from_nothing(clock: Callable[[float], None], capsys: pytest.CaptureFixture[str]) -> None:
    with progress("[b]baking", 10) as bar:
        clock(3)
        bar.update(0)
    assert capsys.readouterr().err == "[b]baking: 0 %  3 s, time left unknown\n"


def test_a_terminal_gets_a_bar(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    with progress("[b]baking", 4) as bar:
        bar.update(2, "half")
        bar.advance(2, "done")
    assert bar.done == 4 and "[b]baking" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.2, "0 s"), (59.4, "59 s"), (59.6, "1 min 00 s"), (200, "3 min 20 s"), (3900, "1 h 05 min")]
)
def test_durations_read_well(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_work_taken_up_again_counts_from_its_place_in_the_whole_and_its_time_from_now(
    clock: Callable[[float], None], capsys: pytest.CaptureFixture[str]
) -> None:
    with progress("training", 1000, begun=600) as bar:
        assert bar.done == 600
        clock(10)
        bar.update(700, "PSNR 30")
    with progress("supersampling", 1000) as bar:
        bar.resume_at(600)
        clock(20)
        bar.update(700)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["training: 70 %  10 s, 30 s left  PSNR 30", "supersampling: 70 %  10 s, 30 s left"]


def test_a_bar_of_work_taken_up_again_begins_at_its_place(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    with progress("training", 10, begun=4):
        pass
    assert "4/10" in capsys.readouterr().err.replace(" ", "")
    with progress("supersampling", 10) as bar:
        bar.resume_at(6)
    assert "6/10" in capsys.readouterr().err.replace(" ", "")
