"""Two commands that write one output at once: one writes it, the other says so."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from console import UserError
from console.atomic import Replacement, replacing
from scenepack import load_pack, save_pack
from scenepack.commands import main as snerg_pack
from tests.scenepack.helpers import same_pack, small_pack
from tests.told import told
from viewer.commands.render import main as snerg_render
from viewer.features.film.film_export import Export
from viewer.rendering.camera import ViewCamera
from viewer.rendering.settings import RenderSettings

ROOT = Path(__file__).parents[2]
WRITER = """
import sys
from pathlib import Path
from console.atomic import replacing
print("ready", flush=True)
sys.stdin.readline()
try:
    with replacing(Path(sys.argv[1]), folder=len(sys.argv) > 2, durable=False, alone=True) as new:
        print("writes", flush=True)
        sys.stdin.readline()
        (new / "file" if new.is_dir() else new).write_text("theirs")
except OSError as error:
    print(error.strerror, flush=True)
"""


@contextmanager
def writers(target: Path, count: int = 1, *more: str) -> Iterator[list[subprocess.Popen[str]]]:
    """Processes that are about to write to `target`; a line makes each begin, another one end."""
    with ExitStack() as stack:
        words = [sys.executable, "-c", WRITER, str(target), *more]
        children = []
        for _ in range(count):
            child = subprocess.Popen(words, cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            stack.callback(child.communicate)
            stack.callback(child.kill)
            children.append(child)
        for child in children:
            assert child.stdout is not None and child.stdout.readline() == "ready\n"
        yield children


def go_on(child: subprocess.Popen[str]) -> str:
    assert child.stdin is not None and child.stdout is not None
    child.stdin.write("\n")
    child.stdin.flush()
    return child.stdout.readline().strip()


@pytest.fixture
def pack(tmp_path: Path) -> Path:
    save_pack(small_pack(), tmp_path / "source")
    return tmp_path / "source"


def test_of_several_that_begin_in_one_moment_one_writes(tmp_path: Path) -> None:
    with writers(tmp_path / "film.mp4", 4) as children:
        for child in children:
            assert child.stdin is not None
            child.stdin.write("\n")
        for child in children:
            child.stdin.flush()  # type: ignore[union-attr]
        said = [child.stdout.readline().strip() for child in children]  # type: ignore[union-attr]
        assert sorted(said) == ["another process is writing it"] * 3 + ["writes"]
        go_on(children[said.index("writes")])
    assert (tmp_path / "film.mp4").read_text() == "theirs"
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.slow
def test_one_that_is_killed_stands_in_nobodys_way(tmp_path: Path) -> None:
    with writers(tmp_path / "film.mp4") as (child,):
        assert go_on(child) == "writes"
        with pytest.raises(OSError, match="another process is writing it"):
            Replacement(tmp_path / "film.mp4", alone=True)
        with replacing(tmp_path / "film.mp4") as new:  # what is written in a moment asks nobody
            new.write_text("ours")
        child.kill()
        child.wait()
    with replacing(tmp_path / "film.mp4", alone=True) as new:
        new.write_text("again")
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize("out", ["view.png", "film.mp4", "views"])
def test_a_rendering_says_that_another_one_writes_there(
    pack: Path, tmp_path: Path, out: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = [str(pack), "--out", str(tmp_path / "new" / out), "--size", "16x16"]
    line += ["--orbit", "2"] if out != "view.png" else []
    (tmp_path / "new").mkdir()
    with writers(tmp_path / "new" / out, 1, *(["folder"] if out == "views" else [])) as (child,):
        assert go_on(child) == "writes"
        assert snerg_render(line) == 2
        [error] = told(capsys.readouterr().err)
        assert out in error and "another process is writing it" in error
    assert snerg_render(line) == 0
    assert [path.name for path in (tmp_path / "new").iterdir()] == [out]


@pytest.mark.slow
@pytest.mark.parametrize("out", ["pack", "pack.zip"])
def test_a_pack_that_another_process_writes_is_left_to_it(
    pack: Path, tmp_path: Path, out: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["convert", str(pack), "--out", str(tmp_path / "new" / out), "--codec", "png"]
    (tmp_path / "new").mkdir()
    with writers(tmp_path / "new" / out, 1, *([] if out.endswith("zip") else ["folder"])) as (child,):
        assert go_on(child) == "writes"
        assert snerg_pack(line) == 2
        assert "another process is writing it" in capsys.readouterr().err
    assert snerg_pack(line) == 0
    assert same_pack(load_pack(tmp_path / "new" / out), load_pack(pack))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["still.png", "film.mp4", "frames"])
def test_an_export_of_the_window_says_so(tmp_path: Path, name: str) -> None:
    def picture(camera: ViewCamera, _: RenderSettings) -> np.ndarray:
        return np.zeros((camera.height, camera.width, 3), np.uint8)

    camera = ViewCamera.look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), 40.0, (16, 16), mirrored=False)

    def export() -> Export:
        return Export([camera], RenderSettings(), tmp_path / name, picture)

    with writers(tmp_path / name, 1, *(["folder"] if name == "frames" else [])) as (child,):
        assert go_on(child) == "writes"
        with pytest.raises(UserError, match="another process is writing it"):
            export().step(60.0)
    job = export()
    while not job.finished:
        job.step(60.0)
    assert [path.name for path in tmp_path.iterdir()] == [name]
