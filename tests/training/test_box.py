"""--aabb: the user's box in place of the reader's, stored with the run, refused where it means nothing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from console import UserError
from tests.training.test_captures import circle, forward, write_llff
from tests.training.test_training import MINUTE
from training.commands.train import main
from training.loop import train
from training.run import load_run
from training.scenes import SceneOptions, load_scene
from training.scenes.scene_options import box_text

BOX = (-0.5, -0.75, -0.25, 1.0, 0.5, 0.75)
WORDS = "-0.5,-0.75,-0.25,1,0.5,0.75"


@pytest.fixture(scope="module")
def boxed(procedural_path: Path, tmp_path_factory) -> Path:
    """A finished run within BOX."""
    out = tmp_path_factory.mktemp("runs") / "boxed"
    train(procedural_path, out, MINUTE, SceneOptions(aabb=BOX))
    return out


def test_the_box_takes_the_place_of_the_readers_and_far_reaches_its_end(procedural_path: Path):
    plain, scene = load_scene(procedural_path), load_scene(procedural_path, aabb=BOX)
    np.testing.assert_array_equal(scene.aabb, np.reshape(BOX, (2, 3)))
    assert (scene.near, scene.far) == (plain.near, plain.far)
    wide = load_scene(procedural_path, aabb=(-9, -9, -9, 9, 9, 9))
    corner = np.max([np.linalg.norm(9 + np.abs(p.camera.world_T_camera[:3, 3])) for p in wide.splits["train"]])
    assert wide.far == pytest.approx(corner)


def test_a_run_keeps_its_box_through_resuming_and_loading(boxed: Path, procedural_path: Path, tmp_path: Path, capsys):
    assert json.loads((boxed / "config.json").read_text())["scene_options"]["aabb"] == list(BOX)
    longer = Path(shutil.copytree(boxed, tmp_path / "longer"))
    assert main([str(procedural_path), "--out", str(longer), "--resume", "--steps", "13", "--aabb", WORDS]) == 0
    assert WORDS in capsys.readouterr().err
    run = load_run(longer)
    assert run.step == 13 and run.options.aabb == BOX
    np.testing.assert_allclose(run.dataset.aabb, np.reshape(BOX, (2, 3)))


def test_the_box_and_its_units_are_told_when_training_begins(
    boxed: Path, procedural_path: Path, tmp_path: Path, capsys
):
    train(procedural_path, tmp_path / "plain", MINUTE)
    assert "box of the content: -1.5,-1.5,-1.5,1.5,1.5,1.5 where cameras stand 4" in capsys.readouterr().err


def test_a_forward_facing_scene_has_no_box_to_choose(tmp_path: Path):
    path = write_llff(tmp_path / "forward", forward())
    with pytest.raises(UserError, match=r"--aabb: .* NDC.*; leave it out"):
        load_scene(path, aabb=BOX)
    around = write_llff(tmp_path / "around", circle())
    box = load_scene(around, spherify=True).aabb * 0.5
    assert box_text(load_scene(around, spherify=True, aabb=box.ravel()).aabb) == box_text(box)
