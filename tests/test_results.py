"""Where nothing can be written, every command says so before its work, not after."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from baker.commands.bake import main as snerg_bake
from baker.commands.codec_report import main as codec_report
from baker.commands.evaluate import main as snerg_eval
from baker.commands.pack import main as snerg_pack
from baker.commands.report import main as report
from console import UserError, check_results, write_json, write_text
from scenepack import save_pack
from tests.scenepack.helpers import small_pack
from tests.told import told
from tools.procedural import write_procedural_scene
from tools.profile_step import main as profile_step
from tools.scaling import main as scaling
from viewer.commands.bench import main as snerg_bench
from viewer.commands.render import main as snerg_render


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A pack, a scene, and places where no file can be: below a file, and in place of a folder."""
    folder = tmp_path_factory.mktemp("results")
    save_pack(small_pack(), folder / "pack")
    write_procedural_scene(folder / "scene", size=8, views=2, subpixels=1)
    (folder / "file").write_text("in the way of a folder")
    names = {"pack": "pack", "scene": "scene", "below": "file/deep/results", "folder": "scene"}
    return {name: str(folder / path) for name, path in names.items()}


@pytest.mark.parametrize(
    ("command", "words", "work"),
    [
        (snerg_pack, "info {pack} --json {below}.json", "scenepack.commands.open_pack"),
        (snerg_pack, "check {pack} --json {folder}", "scenepack.commands.open_pack"),
        (snerg_pack, "convert {pack} --out {below}", "scenepack.commands.open_pack"),
        (snerg_pack, "compare {pack} {pack} --json {below}.json", "baker.reports.pack_compare.compare_packs"),
        (snerg_eval, "{pack} --scene {scene} --json {folder}", "baker.reports.evaluation.evaluate"),
        (snerg_eval, "{pack} --scene {scene} --images {below}", "baker.reports.evaluation.evaluate"),
        (snerg_bake, "{pack} --out {below}", "training.run.load_run"),
        (codec_report, "{pack} --scene {scene} --out {below}.md", "baker.commands.codec_report.measured"),
        (report, "{pack} --out {below}", "baker.reports.report.open_study"),
        (profile_step, "{scene} --json {below}.json", "tools.profile_step._trained"),
        (profile_step, "{scene} --markdown {folder}", "tools.profile_step._trained"),
        (snerg_bench, "{pack} --json {below}.json", "viewer.commands.bench.load_pack"),
        (snerg_bench, "{pack} --markdown {below}.md", "viewer.commands.bench.load_pack"),
        (snerg_bench, "{pack} --plot {folder}", "viewer.commands.bench.load_pack"),
        (scaling, "--out {below}", "tools.scaling.measured"),
        (snerg_render, "{pack} --out {below}.png", "viewer.commands.render.load_pack"),
        (snerg_render, "{pack} --out {below} --orbit 3", "viewer.commands.render.load_pack"),
    ],
)
def test_results_that_cannot_be_written_are_refused_before_the_work(
    command: Callable[[list[str]], int],
    words: str,
    work: str,
    places: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def begin(*_: Any, **__: Any) -> None:
        raise AssertionError("the work has begun")

    monkeypatch.setattr(work, begin)
    assert command(words.format(**places).split()) == 2
    [line] = told(capsys.readouterr().err)
    assert "cannot be written" in line and (places["below"] in line or places["folder"] in line)


def test_the_question_leaves_nothing_behind_and_harms_nothing(tmp_path: Path) -> None:
    (tmp_path / "there.json").write_text("old")
    check_results(tmp_path / "new.json", tmp_path / "there.json", None, Path("-"), folder=tmp_path / "deep" / "folder")
    check_results(tmp_path / "deep" / "new.json")
    assert os.listdir(tmp_path) == ["there.json"] and (tmp_path / "there.json").read_text() == "old"


def test_a_name_that_is_too_long_is_told_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="name is too long"):
        check_results(tmp_path / f"{'n' * 250}.json")


def test_a_pipe_is_written_into_and_stays_a_pipe(tmp_path: Path) -> None:
    """As a shell's >(wc) is. A file that took its place would never reach the reader."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()), daemon=True)
    reader.start()
    check_results(pipe)
    write_json(pipe, {"psnr": 30.0})
    reader.join(60)
    assert json.loads(read[0]) == {"psnr": 30.0}
    assert pipe.is_fifo() and os.listdir(tmp_path) == ["pipe"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, of Linux")
def test_a_device_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    device = Path("/dev/full")
    before = device.lstat()
    with pytest.raises(UserError, match="disk is full"):
        write_text(device, "figures")
    assert device.lstat().st_rdev == before.st_rdev and device.is_char_device()


def test_what_a_link_leads_to_is_replaced_and_not_the_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.json").symlink_to(tmp_path / "real" / "figures.json")
    for figure in (1, 2):
        write_json(tmp_path / "link.json", {"figure": figure})
    assert (tmp_path / "link.json").is_symlink()
    assert json.loads((tmp_path / "real" / "figures.json").read_text()) == {"figure": 2}
