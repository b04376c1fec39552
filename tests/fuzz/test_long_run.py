"""A long run sees what grows, and what is left behind (python -m tests.fuzz.long_run)."""

from __future__ import annotations

import os
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from tests.fuzz.long_run import FEWEST, WARM_UP, Lap, held, verdict

FLAT = [Lap(1.0, 10**9 + 10**6 * (i % 3), 20, 8, 0, []) for i in range(WARM_UP + 12)]


def growing(**by: int) -> list[Lap]:
    return [replace(lap, **{k: getattr(lap, k) + i * step for k, step in by.items()}) for i, lap in enumerate(FLAT)]


def test_what_stays_as_it_is_after_the_warm_up_is_well() -> None:
    warming = [replace(lap, memory=lap.memory // 2, descriptors=3) for lap in FLAT[:WARM_UP]]
    assert verdict(FLAT) == verdict(warming + FLAT[WARM_UP:]) == []


@pytest.mark.parametrize("name", ["memory", "descriptors", "threads", "processes"])
def test_what_grows_lap_by_lap_is_told(name: str) -> None:
    [problem] = verdict(growing(**{name: 10**7 if name == "memory" else 1}))
    assert problem.startswith(name)


def test_files_and_too_few_laps_are_told() -> None:
    [problem] = verdict([*FLAT, replace(FLAT[-1], left=["tmp1234"])])
    assert "tmp1234" in problem
    [problem] = verdict(FLAT[: WARM_UP + FEWEST - 1])
    assert "too few" in problem


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="this system does not tell as Linux does")
def test_what_is_held_is_measured(tmp_path: Path) -> None:
    before = held(tmp_path, 0.0)
    ballast, release = bytes(bytearray(os.urandom(1)) * (64 << 20)), threading.Event()
    waiting = threading.Thread(target=release.wait)
    waiting.start()
    with open(tmp_path / "forgotten", "wb"):
        after = held(tmp_path, 0.0)
    release.set()
    waiting.join()
    assert after.memory > before.memory + len(ballast) // 2
    assert (after.descriptors, after.threads, after.left) == (before.descriptors + 1, before.threads + 1, ["forgotten"])
