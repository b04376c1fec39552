"""The campaigns of tools.fuzz see what falls short: one that sees nothing proves nothing."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tools.fuzz.long_run import FEWEST, WARM_UP, Lap, verdict
from tools.fuzz.writer import Writer, digest

OLD, NEW = "old " * 1000, "new " * 1000
# Each writes NEW to the last word of its line. Its first run makes the file `begun` beside it and goes on for a minute.
IN_PLACE = "out.write_text(NEW[:2000]); pause(); out.write_text(NEW)"
ASIDE = "aside.write_text(NEW[:2000]); pause(); aside.write_text(NEW); aside.replace(out)"
TIDY = "[p.unlink() for p in out.parent.glob('.aside*')]; " + ASIDE
PROGRAM = f"""
import os, sys, time
from pathlib import Path
out, NEW = Path(sys.argv[-1]), {NEW!r}
aside = out.with_name(f".aside-{{os.getpid()}}")
def pause():
    begun = out.parent.parent / "begun"
    if not begun.exists():
        begun.touch()
        time.sleep(60)
"""


class Scripted(Writer):
    """A program of our own, killed as soon as it has begun."""

    script = ""

    def line(self, out: Path) -> list[str]:
        return [sys.executable, "-c", PROGRAM + self.script, str(out)]

    def wait(self, child: subprocess.Popen[str], moment: float) -> None:
        until = time.monotonic() + 60
        while not self.begun.exists() and time.monotonic() < until:
            time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "problem"),
    [(IN_PLACE, "neither the old output nor the new one"), (ASIDE, "left behind: ['.aside-"), (TIDY, "")],
    ids=["in place", "aside", "aside and tidy"],
)
def test_half_written_outputs_and_what_is_left_behind_are_seen(tmp_path: Path, script: str, problem: str) -> None:
    place = tmp_path / "place"
    place.mkdir()
    (tmp_path / "new").write_text(NEW)
    writer = Scripted("film", [], "out", lambda out: out.write_text(OLD), digest(tmp_path / "new"))
    writer.script, writer.begun = script, tmp_path / "begun"
    found = writer.kill(place, 0.5)
    if not problem:
        assert found == "old" and not writer.problems
    else:
        assert len(writer.problems) == 1 and problem in writer.problems[0]
    assert (place / "out").read_text() == NEW, "the same line was run to its end"


def test_a_long_run_sees_what_grows_and_what_is_left_behind() -> None:
    flat = [Lap(1.0, 10**9 + 10**6 * (i % 3), 20, 8, 0, []) for i in range(WARM_UP + 12)]
    warming = [replace(lap, memory=lap.memory // 2, descriptors=3) for lap in flat[:WARM_UP]]
    assert verdict(flat) == verdict(warming + flat[WARM_UP:]) == []
    for name, step in {"memory": 10**7, "descriptors": 1, "threads": 1, "processes": 1}.items():
        [problem] = verdict([replace(lap, **{name: getattr(lap, name) + i * step}) for i, lap in enumerate(flat)])
        assert problem.startswith(name)
    [problem] = verdict([*flat, replace(flat[-1], left=["tmp1234"])])
    assert "tmp1234" in problem
    [problem] = verdict(flat[: WARM_UP + FEWEST - 1])
    assert "too few" in problem
