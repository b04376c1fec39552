"""Options of which nothing can come end in one line before the work, not in a traceback or after hours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from baker.commands.bake import main as snerg_bake
from baker.commands.make import main as snerg_make
from scenepack import save_pack
from tests.scenepack.helpers import small_pack
from tests.told import told
from tools.procedural import write_procedural_scene
from viewer.commands.render import main as snerg_render


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("options")
    save_pack(small_pack(), folder / "pack")
    write_procedural_scene(folder / "scene", size=8, views=2, subpixels=1)
    return {name: str(folder / name) for name in ("pack", "scene", "out", "film.mp4")}


@pytest.mark.parametrize(
    ("command", "words", "work", "told_of"),
    [
        (snerg_bake, "{scene} --out {out} --resolution 7650", "training.run.load_run", "--resolution"),
        (snerg_bake, "{scene} --out {out} --resolution -5", "training.run.load_run", "--resolution"),
        (snerg_bake, "{scene} --out {out} --seed 99999999999999999999", "training.run.load_run", "--seed"),
        (snerg_bake, "{scene} --out {out} --seed -1", "training.run.load_run", "--seed"),
        (snerg_bake, "{scene} --out {out} --quality best", "training.run.load_run", "--quality"),
        (snerg_bake, "{scene} --out {out} --most-macroblocks 0", "training.run.load_run", "--most-macroblocks"),
        (snerg_bake, "{scene} --out {out} --pictures -3", "training.run.load_run", "--pictures"),
        (snerg_make, "{scene} --out {out} --resolution 7650", "training.loop.train", "--resolution"),
        (snerg_make, "{scene} --out {out} --resolution 0", "training.loop.train", "--resolution"),
        (snerg_make, "{scene} --out {out} --frames 7", "training.loop.train", "--frames"),
        (snerg_make, "{scene} --out {out} --seed -7", "training.loop.train", "--seed"),
        (snerg_render, "{pack} --out {film.mp4} --orbit 2 --fps -1", "viewer.commands.render.load_pack", "--fps"),
        (snerg_render, "{pack} --out {film.mp4} --orbit 2 --fps 0", "viewer.commands.render.load_pack", "--fps"),
        (
            snerg_render,
            "{pack} --out {film.mp4} --orbit 2 --fps 99999999999",
            "viewer.commands.render.load_pack",
            "--fps",
        ),
        (snerg_render, "{pack} --out {film.mp4} --orbit 2 --size 1x1", None, "at least 2 × 2 pixels"),
    ],
)
def test_what_makes_no_sense_is_refused_before_the_work(
    command: Callable[[list[str]], int],
    words: str,
    work: str | None,
    told_of: str,
    places: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def begin(*_: object, **__: object) -> None:
        raise AssertionError("the work has begun")

    if work is not None:
        monkeypatch.setattr(work, begin)
    for name, path in places.items():
        words = words.replace(f"{{{name}}}", path)
    assert command(words.split()) == 2
    [line] = told(capsys.readouterr().err)
    assert told_of in line
    assert not Path(places["out"]).exists() and not Path(places["film.mp4"]).exists()
    assert not [file.name for file in Path(places["out"]).parent.iterdir() if file.name.startswith(".")]
