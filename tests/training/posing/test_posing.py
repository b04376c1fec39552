"""Poses of bare photographs: the cameras that took them are found, and what cannot be used is told by name."""

import os
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from baker.commands.make import main as snerg_make
from console import UserError
from tests.training.posing.conftest import COUNT, STRANGER, Found, load_quietly, write_photographs
from tests.training.posing.rooms import cameras, panorama_cameras, photograph
from tests.viewer.waiting import until
from tools.pose_error import pose_error
from training.posing import child_process, find
from training.posing.find import find_poses, posed_scene
from training.posing.photograph import read_photograph
from training.scenes import Photograph, Scene
from training.scenes.lens import EQUIRECTANGULAR, projection_of
from training.scenes.read import suggested_downscale

ROOT = Path(__file__).parents[3]


def photographs_of(scene: Scene) -> dict[str, Photograph]:
    return {Path(one.name).stem: one for split in scene.splits.values() for one in split}


def test_the_cameras_of_bare_photographs_are_found(found: Found):
    scene = load_quietly(found.scene)
    given = replace(scene, splits={"train": tuple(Photograph(n, c, lambda: None) for n, c in found.cameras.items())})  # type: ignore[arg-type, return-value]
    result = pose_error(scene, given)
    assert len(result.names) == COUNT
    assert result.positions.max() < 0.01 and result.degrees.max() < 1.0
    focals = {name: one.camera.fx / one.camera.width for name, one in photographs_of(scene).items()}
    assert np.allclose(list(focals.values()), 268.8 / 256, rtol=0.02)
    assert all(one.camera.fx == one.camera.fy for one in photographs_of(scene).values()), "square pixels"
    notices = "\n".join(found.notices)
    assert "p0b.jpg = p0.jpg" in notices and "p6b.jpg" in notices and STRANGER in notices


@pytest.mark.slow
def test_pixels_that_are_not_square_are_found(tmp_path: Path):
    (tmp_path / "photographs").mkdir()
    views = []
    for number, camera in enumerate(cameras(12)):
        narrow = replace(camera, width=192, fx=0.75 * camera.fx, cx=96.0)
        Image.fromarray(photograph(narrow)).save(tmp_path / "photographs" / f"p{number:02}.png")
        views.append(Photograph(f"p{number:02}", narrow, lambda: None))  # type: ignore[arg-type, return-value]
    scene = load_quietly(posed_scene(tmp_path / "photographs", tmp_path / "out"))
    result = pose_error(scene, replace(scene, splits={"train": tuple(views)}))
    assert len(result.names) == 12
    assert result.positions.max() < 0.01 and result.degrees.max() < 0.5
    aspects = [one.camera.fx / one.camera.fy for one in photographs_of(scene).values()]
    assert aspects == pytest.approx([0.75] * 12, rel=0.01)


def test_panoramas_are_told_from_photographs(tmp_path: Path):
    inside, (corner,) = panorama_cameras(3), cameras(1)
    for camera, expected in ((inside[0], True), (inside[2], True), (replace(corner, height=128), False)):
        Image.fromarray(photograph(camera)).save(tmp_path / "picture.png")
        assert read_photograph(tmp_path / "picture.png").is_panorama == expected
    Image.new("RGB", (64, 32), "white").save(tmp_path / "picture.png")
    assert not read_photograph(tmp_path / "picture.png").is_panorama


@pytest.mark.slow
def test_the_cameras_of_panoramas_are_found(tmp_path: Path):
    (tmp_path / "photographs").mkdir()
    given = {f"p{number}": camera for number, camera in enumerate(panorama_cameras(COUNT))}
    for name, camera in given.items():
        Image.fromarray(photograph(camera)).save(tmp_path / "photographs" / f"{name}.png")
    scene = load_quietly(posed_scene(tmp_path / "photographs", tmp_path / "out"))
    views = tuple(Photograph(name, camera, lambda: None) for name, camera in given.items())  # type: ignore[arg-type, return-value]
    result = pose_error(scene, replace(scene, splits={"train": views}))
    assert len(result.names) == COUNT
    assert result.positions.max() < 0.01 and result.degrees.max() < 0.5
    assert all(projection_of(one.camera.distortion) == EQUIRECTANGULAR for one in photographs_of(scene).values())
    assert scene.contraction is not None, "what lies around the cameras has no end"
    assert suggested_downscale(scene.path, 128) == 1 and suggested_downscale(scene.path, 64) == 2


def test_the_users_folder_is_left_as_it_was_and_the_scene_holds_no_copies_of_what_can_be_used(found: Found):
    assert len(list(found.source.path.iterdir())) == COUNT + 3
    assert (found.scene / "images" / "p0.jpg").is_symlink() or os.name == "nt"
    assert not (found.scene.parent / find.WORK).exists()


def test_the_same_line_again_finds_the_poses_there(found: Found, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(find, "ask", None)
    assert find_poses(found.source, found.scene.parent) == found.scene
    assert posed_scene(found.scene, found.scene.parent / "other") == found.scene  # which has poses


@pytest.mark.slow
def test_poses_are_found_anew_where_there_are_some(found: Found, tmp_path: Path):
    scene = posed_scene(found.scene, tmp_path / "out", anew=True)
    assert scene == tmp_path / "out" / find.SCENE
    assert len(photographs_of(load_quietly(scene))) == len(photographs_of(load_quietly(found.scene)))


@pytest.mark.slow
def test_who_is_stopped_goes_on_from_the_finished_stages_to_the_same_poses(found, tmp_path, monkeypatch):
    stage = "poses"
    ends: list[subprocess.Popen] = []
    asked: list[tuple[str, float]] = []
    before = child_process.ask

    def interrupted(service: str, request: Any, log: Path, tell: Any) -> Any:
        def stopping(title: str, done: float, total: float) -> None:
            asked.append((title, done))
            tell(title, done, total)
            if title == stage:
                raise KeyboardInterrupt

        return before(service, request, log, stopping)

    popen = subprocess.Popen

    def started(*args: Any, **kwargs: Any) -> subprocess.Popen:
        ends.append(popen(*args, **kwargs))
        return ends[-1]

    monkeypatch.setattr(subprocess, "Popen", started)
    monkeypatch.setattr(find, "ask", interrupted)
    with pytest.raises(KeyboardInterrupt, match="the same command line continues"):
        find_poses(found.source, tmp_path / "out")
    assert ends[0].poll() is not None and not (tmp_path / "out" / "scene").exists()  # nothing half done

    asked.clear()
    stage = "never"
    with warnings.catch_warnings(action="ignore"):
        scene = find_poses(found.source, tmp_path / "out")
    assert asked[:2] == [("features", COUNT + 1), ("matches", (COUNT + 1) * COUNT / 2)]  # all of which are kept
    first, second = load_quietly(found.scene), load_quietly(scene)
    # Not to the last bit: COLMAP's matcher may lose some matches, once in hundreds of runs.
    result = pose_error(second, first)
    assert len(result.names) == COUNT and result.positions.max() < 0.005 and result.degrees.max() < 0.2
    of_second = photographs_of(second)
    for name, one in photographs_of(first).items():
        assert one.camera.fx == pytest.approx(of_second[name].camera.fx, rel=0.005)


@pytest.mark.slow
def test_one_ctrl_c_ends_it_in_one_line(found: Found, tmp_path: Path):
    code = (
        "import sys; from pathlib import Path; from console import run_command; from training.posing.find import posed_scene\n"
        "def go(photos: Path, out: Path, /) -> None:\n    posed_scene(photos, out)\n"
        "sys.exit(run_command(go, prog='go', args=sys.argv[1:]))"
    )
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(found.source.path), str(out)], cwd=ROOT, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "SNERG_PROGRESS": str(tmp_path / "progress.json")},
    )  # fmt: skip
    until(lambda: process.poll() is not None or (out / find.WORK / "database.db").exists())  # COLMAP is at work
    process.send_signal(signal.SIGINT)
    lines = process.communicate(timeout=60)[1].splitlines()
    assert process.returncode == 130
    assert lines[-1].startswith("go: interrupted; ") and not [line for line in lines if "Traceback" in line]


@pytest.mark.slow
def test_snerg_make_trains_on_the_scene_whose_poses_it_found(found, monkeypatch, capsys):
    def train(scene: Path, run: Path, *_: object, **__: object) -> None:
        raise UserError("trained", where=scene)

    monkeypatch.setattr("training.loop.train", train)
    assert snerg_make([str(found.source.path), "--out", str(found.scene.parent)]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"snerg-make: {found.scene}: trained"


@pytest.mark.parametrize("name", [find.SCENE, find.WORK])
def test_folders_that_it_did_not_make_are_left_alone(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(find, "require", lambda source: None)
    write_photographs(tmp_path / name, 8)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(UserError, match=f"{name}: is in the way"):
        posed_scene(tmp_path / name, tmp_path)
    assert sorted(tmp_path.rglob("*")) == before


FULL = """
from training.posing import child_process
def fill(request, on_progress): raise RuntimeError('database or disk is full')
child_process.SERVICES['reconstruct'] = fill
child_process.serve()"""
DIES, FAILS = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "raise ValueError('went wrong')"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "error", "said"),
    [(DIES, UserError, "SIGKILL"), (FULL, UserError, "the disk is full"), (FAILS, RuntimeError, "went wrong")],
)
def test_a_child_that_dies_is_told_with_its_log(code, error, said, tmp_path, monkeypatch):
    monkeypatch.setattr(child_process, "COMMAND", [sys.executable, "-P", "-c", code])
    with pytest.raises(error, match=said):
        child_process.ask("reconstruct", {}, tmp_path / "log.txt", lambda *_: None)
