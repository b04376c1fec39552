"""Progress without a terminal: plain lines, rarely, with the time left once it can be told."""

import sys
import time
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace

import pytest

from console import progress
from console.progress import Estimate, duration


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    now = [100.0]
    stopped = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr(sys.modules["console.progress"], "time", stopped)
    return lambda seconds: now.__setitem__(0, 100.0 + seconds)


def test_plain_lines_come_every_ten_seconds_and_at_the_end(clock, capsys):
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
        bar.advance(2)
    assert bar.done == 4 and "[b]baking" in capsys.readouterr().err


def test_durations_read_well() -> None:
    durations = [duration(seconds) for seconds in (0.2, 59.4, 59.6, 200, 3900)]
    assert durations == ["0 s", "59 s", "1 min 00 s", "3 min 20 s", "1 h 05 min"]


def test_work_taken_up_again_counts_from_its_place_in_the_whole_and_its_time_from_now(clock, capsys):
    with progress("training", 1000, begun=600) as bar:
        assert bar.done == 600
        for second in (1, 5, 10):
            clock(second)
            bar.update(600 + 10 * second)
        assert bar.seconds_left == pytest.approx(30)


def test_work_that_says_nothing_still_shows_that_time_passes(clock, capsys, monkeypatch):
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


# The time that is left: no promise before it means something, and none that stands still


def test_a_first_step_that_compiles_makes_no_promise() -> None:
    """110 steps, of which the first takes five minutes and each other a second."""
    estimate, estimates = Estimate(110), []
    for step in range(1, 110):
        now = 300.0 + step - 1
        estimate.update(now, step)
        if (left := estimate.left(now)) is not None:
            estimates.append(left)
            assert left == pytest.approx(110 - step, abs=1)
    assert len(estimates) > 100


@pytest.mark.parametrize("costs", [[1.0] * 60, [5.0, 0.1] * 30, [0.2] * 50 + [4.0] * 50, [30.0, *[0.5] * 99]])
def test_what_is_left_falls_while_time_passes_and_never_below_nothing(costs: list[float]) -> None:
    estimate, now = Estimate(len(costs)), 0.0
    for done, cost in enumerate(costs):
        before = estimate.left(now)
        for part in (0.25, 0.5, 0.75):
            left = estimate.left(now + part * cost)
            if before is not None and left is not None:
                assert left == pytest.approx(before - part * cost) and left > 0
        now += cost
        estimate.update(now, done + 1)


def test_a_change_of_speed_is_followed_without_a_jump() -> None:
    estimate, estimates, now = Estimate(300), [], 0.0
    for done in range(1, 301):
        now += 1.0 if done < 150 else 3.0
        estimate.update(now, done)
        estimates.append(estimate.left(now))
    known = [left for left in estimates[10:-1] if left is not None]
    assert len(known) == 289
    assert max(after - before for before, after in pairwise(known)) < 25
    assert known[-50] == pytest.approx(150, rel=0.25)  # 50 units of 3 s
