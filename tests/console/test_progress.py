"""Progress without a terminal: plain lines, rarely, with the time left once it can be told."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from console import progress
from console.progress import duration


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    now = [100.0]
    stopped = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr(sys.modules["console.progress"], "time", stopped)
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
    assert lines[:2] == ["training: 4 %  2 s  PSNR 4", "training: 24 %  12 s, 38 s left  PSNR 24"]
    assert lines[-1] == "training: 100 %  50 s  PSNR 100"
    assert len(lines) == 6


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
        for second in (1, 5, 10):
            clock(second)
            bar.update(600 + 10 * second)
        assert bar.seconds_left == pytest.approx(30)
    with progress("supersampling", 1000) as bar:
        bar.resume_at(600)
        for second in (11, 15, 20):
            clock(second)
            bar.update(500 + 10 * second)
        assert bar.seconds_left == pytest.approx(30)


def test_work_that_says_nothing_still_shows_that_time_passes(
    clock: Callable[[float], None], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules["console.progress"], "BEAT_S", 0.01)

    def printed() -> str:
        for _ in range(500):
            time.sleep(0.01)
            if text := capsys.readouterr().err:
                return text
        return ""

    with progress("training", 100) as bar:
        clock(10)
        assert printed() == "training: 0 %  10 s\n"
        bar.update(5)
        with progress("closing holes", 4):
            clock(22)
            assert printed() == "closing holes: 0 %  12 s\n"
        clock(24)
        assert printed() == "training: 5 %  24 s\n"
