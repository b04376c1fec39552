"""A killed or failing writer leaves the old pack or the new one, and never deletes what is not a pack.

`python -m tests.scenepack.test_atomic_writing TARGET` lets children die as if by kill -9 just before their first, second, …
file system call.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from console import UserError
from scenepack import check_target, load_pack, save_pack
from scenepack.codecs import images
from tests.scenepack.helpers import same_pack, small_pack, written

ROOT = Path(__file__).parents[2]
DIED = 77
# Of few files, since each is flushed to the disk.
OLD, NEW = (small_pack(seed, block_size=2, grid_blocks=(2, 1, 1), occupancy=0.9) for seed in (1, 2))


def die_at(step: int) -> None:
    """Makes the process end, with no clean-up, before the given call."""
    count = 0

    def dying(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            nonlocal count
            count += 1
            if count == step:
                os._exit(DIED)
            return function(*args, **kwargs)

        return call

    for owner, name in ((os, "rename"), (os, "replace"), (os, "fsync"), (os, "unlink"), (os, "rmdir"), (os, "mkdir")):
        setattr(owner, name, dying(getattr(owner, name)))
    setattr(Path, "write_bytes", dying(Path.write_bytes))  # noqa: B010


def die_at_each_step(target: Path) -> None:
    """Prints a line for each step: the dead writer's status, which pack is found then, and whether all is
    tidy after the next writer. Forks here, in a process without the threads of a whole test run.
    """
    for step in range(1, 200):
        save_pack(OLD, target)
        child = os.fork()
        if child == 0:
            die_at(step)
            save_pack(NEW, target)
            os._exit(0)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        pack = load_pack(target)
        found = [name for name, known in (("old", OLD), ("new", NEW)) if same_pack(pack, known)]
        save_pack(OLD, target)
        tidy = not [name for name in os.listdir(target.parent) if name.startswith(".")]
        print(status, *found, "tidy" if tidy else "untidy", flush=True)
        if status == 0:
            return


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs os.fork")
@pytest.mark.parametrize("name", ["pack", "pack.zip"])
def test_a_kill_before_any_single_step_leaves_the_old_pack_or_the_new_one(tmp_path: Path, name: str) -> None:
    words = [sys.executable, "-m", "tests.scenepack.test_atomic_writing", str(tmp_path / name)]
    output = subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    lines = [line.split() for line in output.splitlines()]
    assert [status for status, *_ in lines] == [str(DIED)] * (len(lines) - 1) + ["0"]
    assert {tidy for *_, tidy in lines} == {"tidy"}, output
    # Steps before the swap keep the old one, those after it have the new one: it never goes back and forth.
    found = [words[1] for words in lines]
    assert found[0] == "old" and found[-1] == "new" and found == sorted(found, reverse=True), output


def test_a_pack_set_aside_by_a_killed_writer_is_put_back_by_the_next_reader(tmp_path: Path) -> None:
    target = written(tmp_path / "pack", OLD)
    child = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    dead = int(child.stdout)
    target.rename(tmp_path / f".pack.old-{dead}-0123abcd")
    assert same_pack(load_pack(target), OLD)
    assert os.listdir(tmp_path) == ["pack"]


@pytest.mark.parametrize("name", ["pack", "pack.zip"])
@pytest.mark.parametrize("kind", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_writer_that_fails_half_way_leaves_the_old_pack_and_nothing_else(tmp_path, name, kind, monkeypatch):
    target = written(tmp_path / name, OLD)
    real, written_files = images.encode_png, []

    def failing(pixels: np.ndarray) -> bytes:
        written_files.append(1)
        if len(written_files) > 1:  # after the indices and the first image
            raise kind
        return real(pixels)

    monkeypatch.setattr(images, "encode_png", failing)
    with pytest.raises(UserError if isinstance(kind, OSError) else KeyboardInterrupt) as caught:
        save_pack(NEW, target)
    if isinstance(kind, OSError):
        assert "the disk is full" in str(caught.value)
    assert same_pack(load_pack(target), OLD)
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("photo", ["holiday.jpg", "scene_params.json.bak", "images"])
def test_a_folder_that_holds_anything_but_a_pack_is_never_overwritten(tmp_path: Path, photo: str) -> None:
    alone, beside = tmp_path / "photos", written(tmp_path / "pack")
    alone.mkdir()
    for folder in (alone, beside):
        (folder / photo).mkdir() if photo == "images" else (folder / photo).write_bytes(b"dear")
        before = sorted(os.listdir(folder))
        with pytest.raises(UserError, match=photo):
            check_target(folder)
        with pytest.raises(UserError, match=photo):
            save_pack(NEW, folder)
        assert sorted(os.listdir(folder)) == before


def test_files_of_the_wrong_kind_are_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"dear")
    (tmp_path / "folder.zip").mkdir()
    (tmp_path / "photos.zip").write_bytes(b"dear")
    for name in ("file", "folder.zip", "photos.zip"):
        with pytest.raises(UserError, match=name):
            save_pack(NEW, tmp_path / name)
    assert (tmp_path / "file").read_bytes() == (tmp_path / "photos.zip").read_bytes() == b"dear"
    with pytest.raises(UserError):
        save_pack(NEW, Path("/"))


if __name__ == "__main__":
    die_at_each_step(Path(sys.argv[1]))
