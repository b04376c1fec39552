"""What ends commands sees what falls short of it: one that sees nothing proves nothing (python -m tests.fuzz.interruptions)."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.interruptions import Writer, digest
from tests.fuzz.windows import MakingWindow, working_on
from viewer.features.film.film_export import films_possible, write_film

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


@pytest.mark.skipif(not films_possible(), reason="PyAV is not installed")
def test_films_are_compared_by_their_pictures_and_half_a_film_is_none(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (3, 32, 48, 3), np.uint8)
    film, other, half = (tmp_path / name for name in ("film.mp4", "other.mp4", "half.mp4"))
    write_film(film, list(noise), 30)
    whole, found = film.read_bytes(), digest(film)
    half.write_bytes(whole[: len(whole) // 2])
    write_film(other, list(noise[::-1]), 30)
    assert len({found, digest(other), digest(half), digest(tmp_path / "none.mp4")}) == 4
    film.write_bytes(whole + (8).to_bytes(4, "big") + b"free")  # an empty box, which players pass over
    assert digest(film) == found
    write_film(other, [picture ^ 1 for picture in noise], 30)  # as far as an encoder may be from itself
    assert digest(other) == found
    write_film(other, list(noise[:-1]), 30)
    assert digest(other) != found


# A window whose "snerg-make" is a program that notices nothing, or ends as soon as the pipe to it is closed.
WINDOW = """
import subprocess, sys, time
subprocess.Popen([sys.executable, "-c", sys.argv[1], sys.argv[2]], stdin=subprocess.PIPE, start_new_session=True)
time.sleep(60)
"""
DEAF, HEARING = "import time; time.sleep(60)", "import sys; sys.stdin.read()"


@pytest.mark.parametrize(("maker", "problems"), [(DEAF, ["window: what it makes outlives it"]), (HEARING, [])])
def test_what_a_killed_window_leaves_running_is_seen_and_ended(tmp_path: Path, maker: str, problems: list[str]) -> None:
    out = str(tmp_path / "out")
    writer = MakingWindow("window", [], "out")
    writer.patience_s = 0.5 if problems else 60.0
    child = subprocess.Popen([sys.executable, "-c", WINDOW, maker, out], text=True)
    until = time.monotonic() + 60
    while len(working_on(out)) < 2 and time.monotonic() < until:
        time.sleep(0.01)
    writer.end(child)
    child.wait()
    assert writer.problems == problems
    until = time.monotonic() + 60
    while working_on(out) and time.monotonic() < until:
        time.sleep(0.01)
    assert not working_on(out)
