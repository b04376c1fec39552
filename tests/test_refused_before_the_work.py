"""What cannot end well is refused in one line before the work: results that cannot be written, options of which nothing comes."""

import json
import os
import threading
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
from tests.stand_ins import raising
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.texture_limits import limit_textures
from viewer.commands.bench import main as snerg_bench
from viewer.commands.render import main as snerg_render


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory, procedural_path: Path) -> dict[str, str]:
    """A pack, a scene, and places where no file can be: below a file, and in place of a folder."""
    folder = tmp_path_factory.mktemp("results")
    save_pack(small_pack(), folder / "pack")
    (folder / "file").write_text("in the way of a folder")
    names = {"pack": "pack", "scene": procedural_path, "below": "file/deep/results", "folder": "pack", "out": "out"}
    return {name: str(folder / path) for name, path in names.items()}


WORK = ("viewer.commands.render.load_pack", "viewer.commands.bench.load_pack", "training.run.load_run", "training.loop.train",
        "baker.commands.pack.open_pack", "baker.reports.evaluation.evaluate", "baker.reports.report.open_study")  # fmt: skip


@pytest.mark.parametrize(
    ("command", "words", "expected"),
    [
        (snerg_pack, "info {pack} --json {below}.json", "cannot be written"),
        (snerg_pack, "convert {pack} --out {below}", "cannot be written"),
        (snerg_eval, "{pack} --scene {scene} --json {folder}", "cannot be written"),
        (snerg_bake, "{pack} --out {below}", "cannot be written"),
        (snerg_bake, "{pack} --out {scene}", "not replaced"),
        (report, "{pack} --out {below}", "cannot be written"),
        (snerg_bench, "{pack} --json {folder}", "cannot be written"),
        (snerg_render, "{pack} --out {below} --orbit 3", "cannot be written"),
        (snerg_bake, "{scene} --out {out} --resolution 7650", "--resolution"),
        (snerg_bake, "{scene} --out {out} --seed -1", "--seed"),
        (snerg_bake, "{scene} --out {out} --quality best", "--quality"),
        (snerg_make, "{scene} --out {out} --resolution 0", "--resolution"),
        (snerg_make, "{scene} --out {out} --frames 7", "--frames"),
        (snerg_render, "{pack} --out {out}.mp4 --orbit 2 --fps 0", "--fps"),
    ],
)
def test_what_cannot_end_well_is_refused_before_the_work(command, words, expected, places, refused, monkeypatch):
    for work in WORK:
        monkeypatch.setattr(work, raising(AssertionError("the work has begun")))
    assert expected in refused(command, *words.format(**places).split())
    assert not Path(places["out"]).exists() and not Path(places["out"] + ".mp4").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("convert --codec gif", "image format is not known"), ("convert --codec webp --quality 5", "has no quality"),
        ("convert --codec avif --quality 0", "expected 1 to 100"),
        ("move", "nothing to change"), ("move --up 0,0,0", "not a direction"), ("move --scale 0m", "not a length"),
        ("move --scale 5km", "not a length"), ("move --origin 1,2", "list of numbers"), ("move --origin 1,2,1e9", "range"),
        ("move --turn nan", "--turn: is out of range"), ("move --up 1e-200,0,0", "not a direction"),
        ("edit", "there is nothing to remove"), ("edit --fainter-than 2", "--fainter-than"),
        ("edit --smaller-than 0", "--smaller-than"), ("edit --crop 1,2", "--crop"),
        ("edit --fainter-than 1 --sphere 0,0,0,99", "nothing would be left"),
        ("edit --voxels none.npz", "is not a selection of this pack's voxels"),
        ("export a.obj", "FILE.ply, FILE.glb or FILE.spz"), ("export a.sog", "FILE.ply, FILE.glb or FILE.spz"),
        ("export a.ply", "--kind"), ("export a.glb --kind points", "cannot hold points"),
        ("export a.spz --kind mesh", "cannot hold mesh"), ("export a.spz --scale 1e8", "--scale"),
        ("export mesh.ply --level 2", "--level"), ("export mesh.ply --coarser 5", "1, 2, 3, 6"),
        ("export mesh.ply --keep most", "--keep: is not understood (expected {all,largest}|FLOAT, found most)"),
        ("export mesh.ply --crop 5,5,5,6,6,6", "nothing to export"),
        ("export points.ply --spacing 0", "--spacing"),
    ],
)  # fmt: skip
def test_snerg_pack_refuses_what_cannot_be_and_writes_nothing(words, expected, places, refused, tmp_path):
    command, *options = words.split()
    out = ["--to", tmp_path / options.pop(0)] if command == "export" else ["--out", tmp_path / "new"]
    assert expected in refused(snerg_pack, command, places["pack"], *out, *options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command, words", [(snerg_eval, "--scene {scene}"), (snerg_bench, "--frames 1 --size 48x36")])
def test_a_pack_that_does_not_fit_is_halved_if_allowed(command, words, places, tmp_path, refused, monkeypatch, capsys):
    save_pack(shapes_pack(70), tmp_path / "pack")
    out = tmp_path / "figures.json"
    line = [str(tmp_path / "pack"), *words.format(**places).split(), "--json", str(out)]
    assert command(line) == 0
    whole = json.loads(out.read_text())
    assert whole["halved"] is False and whole["grid_size"] == [70, 70, 70]
    out.unlink()
    limit_textures(monkeypatch, most_bytes=400_000)
    error = refused(command, *line)
    assert "no room" in error and "--allow-half" in error and not out.exists()
    assert command([*line, "--allow-half"]) == 0
    half = json.loads(out.read_text())
    assert half["halved"] is True and half["grid_size"] == [35, 35, 35]
    assert command is not snerg_bench or "at reduced resolution" in capsys.readouterr().out


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
