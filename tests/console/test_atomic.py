"""Files and folders take their place in one step, and are on the disk before they do."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baker.commands.pack import main as snerg_pack
from baker.reports.figures import Section, draw_sections
from console import write_json
from console.atomic import replacing
from scenepack import save_pack
from tests.scenepack.helpers import small_pack
from training.checkpoints import write_checkpoint
from viewer.commands.render import main as snerg_render
from viewer.features.film.camera_path import CameraPath, Keyframe, save_path
from viewer.features.film.picture_export import write_film
from viewer.features.preferences.preferences import save

ROOT = Path(__file__).parents[2]
PICTURE = np.zeros((16, 16, 3), np.uint8)
EMPTY = Section(np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4), bool), np.zeros(2), np.ones(2), False)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("figures.json", lambda path: write_json(path, {"psnr": 30.0})),
        ("viewer.json", lambda path: save({"page": "view"}, path)),
        (
            "path.json",
            lambda path: save_path(CameraPath([Keyframe(np.eye(4), 50.0)]), path, np.eye(4), (320, 200), 30.0),
        ),
        ("sections.png", lambda path: draw_sections(path, {"empty": EMPTY})),
        ("film.mp4", lambda path: write_film(path, [PICTURE] * 3, 24)),
        ("step_00000007.safetensors", lambda path: write_checkpoint(path.parent, 7, {"a": np.zeros(3, np.float32)})),
    ],
)
def test_what_a_person_keeps_is_flushed_before_it_takes_its_place(tmp_path, monkeypatch, name, write):
    steps: list[str] = []
    sync, replace = os.fsync, os.replace

    def fsync(handle: int) -> None:
        steps.append("folder" if os.path.isdir(f"/proc/self/fd/{handle}") else "file")
        sync(handle)

    def renamed(source: Any, target: Any) -> None:
        steps.append("rename")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", renamed)
    write(tmp_path / name)
    assert steps == ["file", "rename", "folder"]
    assert os.listdir(tmp_path) == [name]


def test_a_folder_that_meets_a_file_in_its_place_keeps_its_own_mode(tmp_path, monkeypatch):
    modes = []
    monkeypatch.setattr(os, "replace", lambda new, _: modes.append(new.stat().st_mode & 0o700))
    with replacing(tmp_path / "pack", folder=True):
        (tmp_path / "pack").write_text("dear")
        (tmp_path / "pack").chmod(0o600)
    assert modes == [0o700]


# Two commands that write one output at once: one writes it, the other says so

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


def go_on(*children: subprocess.Popen[str]) -> list[str]:
    """Sends each process a line, so that all go on at once; then reads the answer of each."""
    for child in children:
        assert child.stdin is not None
        print(file=child.stdin, flush=True)
    return [child.stdout.readline().strip() for child in children if child.stdout is not None]


def test_of_several_that_begin_in_one_moment_one_writes(tmp_path: Path) -> None:
    with writers(tmp_path / "film.mp4", 4) as children:
        said = go_on(*children)
        assert sorted(said) == ["another process is writing it"] * 3 + ["writes"]
        go_on(children[said.index("writes")])
    assert (tmp_path / "film.mp4").read_text() == "theirs"
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize(
    ("out", "command", "words"),
    [("view.png", snerg_render, "{pack} --size 16x16"), ("film.mp4", snerg_render, "{pack} --size 16x16 --orbit 2"),
     ("views", snerg_render, "{pack} --size 16x16 --orbit 2"), ("pack.zip", snerg_pack, "convert {pack} --codec png"),
     ("pack", snerg_pack, "convert {pack} --codec png")],
)  # fmt: skip
def test_a_command_says_that_another_one_writes_there(tmp_path, out, command, words, refused):
    save_pack(small_pack(), tmp_path / "source")
    line = [*words.format(pack=tmp_path / "source").split(), "--out", str(tmp_path / "new" / out)]
    (tmp_path / "new").mkdir()
    with writers(tmp_path / "new" / out, 1, *([] if "." in out else ["folder"])) as (child,):
        assert go_on(child) == ["writes"]
        error = refused(command, *line)
        assert out in error and "another process is writing it" in error
    assert command(line) == 0, "the other one was killed amid its work"
    assert [path.name for path in (tmp_path / "new").iterdir()] == [out]
