"""Too few photographs, cameras that miss the scene, nothing in the pictures: told before training, or refused."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from console import UserError
from tests.training.test_captures import circle, write_transforms
from training.commands.train import main
from training.config import PRESETS
from training.loop import train
from training.scenes import SceneOptions, load_scene
from training.scenes.scene import few_line


@pytest.mark.parametrize(
    ("photographs", "words"),
    [(1, "one photograph"), (2, "one photograph"), (6, "5 photographs to train on are few"), (10, None)],
)
def test_what_can_be_expected_of_few_photographs_is_said(tmp_path: Path, photographs: int, words: str | None) -> None:
    line = few_line(load_scene(write_transforms(tmp_path / "t", circle(photographs))))
    assert (line is None) if words is None else (line is not None and words in line)


def test_cameras_that_all_look_away_from_the_box_are_refused_before_training(
    procedural_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = Path(shutil.copytree(procedural_path, tmp_path / "scene"))
    document = json.loads((scene / "transforms_train.json").read_text())
    for frame in document["frames"]:
        pose = np.array(frame["transform_matrix"])
        pose[:3, 0] *= -1
        pose[:3, 2] *= -1
        frame["transform_matrix"] = pose.tolist()
    (scene / "transforms_train.json").write_text(json.dumps(document))
    assert main([str(scene), "--out", str(tmp_path / "run"), "--preset", "tiny", "--steps", "2"]) == 2
    assert "no photograph sees the box of the content" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_field_that_no_ray_meets_does_not_end_as_a_success(procedural_path: Path, tmp_path: Path) -> None:
    scene = Path(shutil.copytree(procedural_path, tmp_path / "scene"))
    for picture in (scene / "train").glob("*.png"):
        corner = Image.new("RGBA", (48, 48))
        corner.paste((255, 0, 0, 255), (0, 0, 8, 8))
        corner.save(picture)
    middle = SceneOptions(aabb=(-0.2, -0.2, -0.2, 0.2, 0.2, 0.2))
    with pytest.raises(UserError, match=r"the field is empty .*--aabb"):
        train(scene, tmp_path / "run", dataclasses.replace(PRESETS["quick"], steps=8, log_every=4), middle)
