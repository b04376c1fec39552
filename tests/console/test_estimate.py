"""The time that is left: no promise before it means something, and none that stands still."""

from __future__ import annotations

from itertools import pairwise

import pytest

from console.progress import Estimate


def test_even_work_is_told_right_after_a_few_updates_and_seconds() -> None:
    estimate = Estimate(100)
    for second in range(1, 100):
        estimate.update(second, second)
        left = estimate.left(second)
        assert left is None if second <= 5 else left == pytest.approx(100 - second, abs=1e-6)


def test_a_first_step_that_compiles_makes_no_promise() -> None:
    """110 steps, of which the first takes five minutes and each other a second."""
    estimate, told = Estimate(110), []
    for step in range(1, 110):
        now = 300.0 + step - 1
        estimate.update(now, step)
        if (left := estimate.left(now)) is not None:
            told.append(left)
            assert left == pytest.approx(110 - step, abs=1)
    assert len(told) > 100


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
    estimate, told, now = Estimate(300), [], 0.0
    for done in range(1, 301):
        now += 1.0 if done < 150 else 3.0
        estimate.update(now, done)
        left = estimate.left(now)
        told.append(left)
    assert all(left is not None for left in told[10:-1])
    known = [left for left in told[10:-1] if left is not None]
    assert max(after - before for before, after in pairwise(known)) < 25
    assert known[-50] == pytest.approx(150, rel=0.25)  # 50 units of 3 s
