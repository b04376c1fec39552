"""Progress: plain lines, rarely, with the time left once it can be told; and in a file, for programs that start our commands."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest

from console import UserError, progress, run_command
from console.child_process import module_command
from console.json_text import MOST_BYTES, parse_json
from console.progress import Estimate, duration
from console.progress_protocol import PROGRESS, Report, read_report
from tests.stand_ins import raising
from tests.viewer.waiting import until


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
        bar.update(3, "nearly")
        bar.advance()
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
    with progress("training", 100) as bar:
        clock(10)
        assert until(lambda: capsys.readouterr().err) == "training: 0 %  10 s\n"
        bar.update(5)
        with progress("closing holes", 4):
            clock(22)
            assert until(lambda: capsys.readouterr().err) == "closing holes: 0 %  12 s\n"
        clock(24)
        assert until(lambda: capsys.readouterr().err) == "training: 5 %  24 s\n"


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


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file in which progress is kept."""
    monkeypatch.setenv(PROGRESS, str(tmp_path / "progress.json"))
    return tmp_path / "progress.json"


def test_progress_is_kept_in_a_file_with_stage_and_metrics_that_programs_read(file: Path) -> None:
    with progress("supersampling", 10, stage="baking") as bar:
        begun = read_report(file)
        assert begun is not None and begun == Report("supersampling", 0.0, 10.0, "", begun.seconds, "baking")
        bar.update(4, "PSNR 20")
        report = read_report(file)
        assert report is not None and (report.done, report.note, report.share) == (4.0, "PSNR 20", 0.4)
        metrics = {"psnr": 27.1, "rays_per_second": 3000.0, "samples": 5.0}
        bar.update(10, metrics=metrics)
    assert list(file.parent.iterdir()) == [file]
    values = json.loads(file.read_text())
    assert set(values) == {"title", "done", "total", "note", "seconds", "begun", "seconds_left", "stage", "metrics",
                           "error", "bug"}  # fmt: skip
    assert (values["stage"], values["metrics"], values["done"]) == ("baking", metrics, 10)
    assert values["note"] == "PSNR 27.10 dB  3.0k rays/s" and not values["error"]


@pytest.mark.parametrize(
    ("bug", "said"),
    [(KeyError("depths"), "KeyError: 'depths'"), (UserError("is empty", where="scene"), "scene: is empty")],
)
def test_why_a_command_failed_is_data_too(file: Path, bug: Exception, said: str) -> None:
    def command() -> None:
        with progress("training", 10, stage="training") as bar:
            bar.update(4)
            raise bug

    is_bug = isinstance(bug, KeyError)
    assert run_command(command, prog="works", args=[]) == (1 if is_bug else 2)
    report = read_report(file)
    assert report is not None and (report.stage, report.done) == ("training", 4.0)
    assert (report.error, report.bug) == (said, is_bug)
    file.unlink()
    assert run_command(raising(UserError("no")), prog="works", args=[]) == 2
    report = read_report(file)
    assert report is not None and (report.title, report.error) == ("works", "no")


def test_a_file_that_cannot_be_written_does_not_stop_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROGRESS, str(tmp_path / "gone" / "progress.json"))
    with progress("training", 10) as bar:
        bar.update(10)
    assert bar.done == 10


def test_a_value_comes_back_as_it_was_written() -> None:
    document = {"whole": 123456789012345678, "float": 0.1, "text": "日本語", "list": [1, -2.5, None, True]}
    assert parse_json(json.dumps(document)) == document
    assert parse_json(b"\xef\xbb\xbf" + json.dumps(document).encode()) == document
    assert type(parse_json("17")) is int and parse_json("9" * 30) == 1e30


def test_more_than_anybody_writes_is_not_parsed() -> None:
    with pytest.raises(ValueError, match="16 MiB"):
        parse_json(b" " * (MOST_BYTES + 1))


ROOT = Path(__file__).parents[2]
PACKAGES = ("console", "scenepack", "training", "baker", "viewer")
SHADOWS = (*PACKAGES, "shaders", "random", "numpy", "json", "queue", "tempfile", "subprocess", "jax", "PIL")


def test_commands_that_are_started_do_not_run_modules_of_the_user(tmp_path, monkeypatch) -> None:
    folder, imported = tmp_path / "of the user", tmp_path / "imported"
    for name in SHADOWS:  # each notes that it was imported, and fails
        place = folder / name / "__init__.py" if name in PACKAGES else folder / f"{name}.py"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(f"open({str(imported)!r}, 'a').write(__name__)\nraise ImportError(__name__)\n")
    monkeypatch.chdir(folder)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    command = module_command("snerg", "make", "--help")
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and "--help" in done.stdout, done.stderr
    assert not imported.exists()


def test_every_start_of_python_leaves_out_the_current_folder() -> None:
    started = re.compile(r"\[\s*sys\.executable,\s*([^\s,\]]+)")
    seen = 0
    for package in PACKAGES:
        for file in (ROOT / package).rglob("*.py"):
            for word in started.findall(file.read_text(encoding="utf-8")):
                seen += 1
                assert word == '"-P"', file
    assert seen >= 1 and sys.version_info >= (3, 11)
