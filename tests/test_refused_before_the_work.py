"""What cannot end well is refused in one line before the work: results that cannot be written, options of which nothing comes."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from baker.commands.bake import main as snerg_bake
from baker.commands.evaluate import main as snerg_eval
from baker.commands.make import main as snerg_make
from baker.commands.pack import main as snerg_pack
from baker.commands.report import main as report
from console import check_results, write_json
from scenepack import save_pack
from tests.scenepack.helpers import small_pack
from tests.told import told
from tests.viewer.rendering.shapes import shapes_pack
from tools.procedural import write_procedural_scene
from viewer.commands.bench import main as snerg_bench
from viewer.commands.render import main as snerg_render
from viewer.rendering.gpu_memory import Limits

RENDER, RUN, OPEN = "viewer.commands.render.load_pack", "training.run.load_run", "baker.commands.pack.open_pack"


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A pack, a scene, and places where no file can be: below a file, and in place of a folder."""
    folder = tmp_path_factory.mktemp("results")
    save_pack(small_pack(), folder / "pack")
    write_procedural_scene(folder / "scene", size=48, views=2, subpixels=1)
    (folder / "file").write_text("in the way of a folder")
    names = {"pack": "pack", "scene": "scene", "below": "file/deep/results", "folder": "scene", "out": "out"}
    return {name: str(folder / path) for name, path in names.items()}


@pytest.mark.parametrize(
    ("command", "words", "work", "told_of"),
    [
        (snerg_pack, "info {pack} --json {below}.json", OPEN, "cannot be written"),
        (snerg_pack, "convert {pack} --out {below}", OPEN, "cannot be written"),
        (
            snerg_eval,
            "{pack} --scene {scene} --json {folder}",
            "baker.reports.evaluation.evaluate",
            "cannot be written",
        ),
        (snerg_bake, "{pack} --out {below}", RUN, "cannot be written"),
        (report, "{pack} --out {below}", "baker.reports.report.open_study", "cannot be written"),
        (snerg_bench, "{pack} --plot {folder}", "viewer.commands.bench.load_pack", "cannot be written"),
        (snerg_render, "{pack} --out {below} --orbit 3", RENDER, "cannot be written"),
        (snerg_bake, "{scene} --out {out} --resolution 7650", RUN, "--resolution"),
        (snerg_bake, "{scene} --out {out} --seed -1", RUN, "--seed"),
        (snerg_bake, "{scene} --out {out} --quality best", RUN, "--quality"),
        (snerg_make, "{scene} --out {out} --resolution 0", "training.loop.train", "--resolution"),
        (snerg_make, "{scene} --out {out} --frames 7", "training.loop.train", "--frames"),
        (snerg_render, "{pack} --out {out}.mp4 --orbit 2 --fps 0", RENDER, "--fps"),
    ],
)
def test_what_cannot_end_well_is_refused_before_the_work(
    command: Callable[[list[str]], int],
    words: str,
    work: str,
    told_of: str,
    places: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def begin(*_: object, **__: object) -> None:
        raise AssertionError("the work has begun")

    monkeypatch.setattr(work, begin)
    assert command(words.format(**places).split()) == 2
    [line] = told(capsys.readouterr().err)
    assert told_of in line
    assert not Path(places["out"]).exists() and not Path(places["out"] + ".mp4").exists()


@pytest.mark.parametrize(
    ("command", "words"), [(snerg_eval, "--scene {scene}"), (snerg_bench, "--frames 1 --size 48x36")]
)
def test_a_pack_that_does_not_fit_is_measured_at_half_resolution_only_where_that_is_allowed(
    command: Callable[[list[str]], int],
    words: str,
    places: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    save_pack(shapes_pack(70), tmp_path / "pack")
    out = tmp_path / "figures.json"
    line = [str(tmp_path / "pack"), *words.format(**places).split(), "--json", str(out)]
    assert command(line) == 0
    whole = json.loads(out.read_text())
    assert whole["halved"] is False and whole["grid_size"] == [70, 70, 70]
    out.unlink()
    monkeypatch.setattr(Limits, "of", classmethod(lambda cls, _: Limits(2048, 400_000)))
    capsys.readouterr()
    assert command(line) == 2 and not out.exists()
    error = told(capsys.readouterr().err)[-1]
    assert "too large" in error and "--allow-half" in error
    assert command([*line, "--allow-half"]) == 0
    half = json.loads(out.read_text())
    assert half["halved"] is True and half["grid_size"] == [35, 35, 35]


def test_the_question_leaves_nothing_behind_and_harms_nothing(tmp_path: Path) -> None:
    (tmp_path / "there.json").write_text("old")
    check_results(tmp_path / "new.json", tmp_path / "there.json", None, Path("-"), folder=tmp_path / "deep" / "folder")
    check_results(tmp_path / "deep" / "new.json")
    assert os.listdir(tmp_path) == ["there.json"] and (tmp_path / "there.json").read_text() == "old"


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


def test_what_a_link_leads_to_is_replaced_and_not_the_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.json").symlink_to(tmp_path / "real" / "figures.json")
    for figure in (1, 2):
        write_json(tmp_path / "link.json", {"figure": figure})
    assert (tmp_path / "link.json").is_symlink()
    assert json.loads((tmp_path / "real" / "figures.json").read_text()) == {"figure": 2}
