"""Programs that start our commands, and those that we start: progress in a file, odd JSON, an end that comes with theirs."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from console import UserError, progress, run_command
from console.child_process import module_command
from console.json_text import MOST_BYTES, parse_json
from console.progress_protocol import PROGRESS, Report, read_report

WAITS = """
import sys, time
from console import run_command
def wait():
    print("ready", flush=True)
    time.sleep(60)
sys.exit(run_command(wait, prog="waits", args=[]))
"""


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
    assert run_command(lambda: (_ for _ in ()).throw(UserError("no")), prog="works", args=[]) == 2
    report = read_report(file)
    assert report is not None and (report.title, report.error) == ("works", "no")


def test_a_file_that_cannot_be_written_does_not_stop_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROGRESS, str(tmp_path / "gone" / "progress.json"))
    with progress("training", 10) as bar:
        bar.update(10)
    assert bar.done == 10


@pytest.mark.parametrize("set_", [True, False])
def test_the_end_of_standard_input_is_ctrl_c_where_it_is_asked_for(set_: bool) -> None:
    env = {**os.environ, **({"SNERG_ENDS_WITH_STDIN": "1"} if set_ else {})}
    pipes: Any = {name: subprocess.PIPE for name in ("stdin", "stdout", "stderr")}
    with subprocess.Popen([sys.executable, "-c", WAITS], env=env, **pipes) as child:
        assert child.stdout is not None and child.stdin is not None and child.stderr is not None
        assert child.stdout.readline() == b"ready\n"
        child.stdin.close()
        if set_:
            assert child.wait(30) == 130 and b"interrupted" in child.stderr.read()
        else:
            with pytest.raises(subprocess.TimeoutExpired):
                child.wait(0.5)
            child.kill()


# JSON that nobody writes by mistake


def test_a_value_comes_back_as_it_was_written() -> None:
    document = {"whole": 123456789012345678, "float": 0.1, "text": "日本語", "list": [1, -2.5, None, True]}
    assert parse_json(json.dumps(document)) == document
    assert parse_json(b"\xef\xbb\xbf" + json.dumps(document).encode()) == document
    assert type(parse_json("17")) is int and parse_json("9" * 30) == 1e30


def test_more_than_anybody_writes_is_not_parsed() -> None:
    with pytest.raises(ValueError, match="16 MiB"):
        parse_json(b" " * (MOST_BYTES + 1))


# What we start runs our modules and Python's, whatever the user keeps in the current folder

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
    command = module_command("baker.commands.make", "--help")
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
