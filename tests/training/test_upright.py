"""What is up, where the user says it: poses, points and box turn together, and a run and its pack are compared so, too."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from baker.reports.evaluation import reading_of
from console import UserError
from tests.training.reconstructions import around, ball, write_colmap
from training.run import read_description
from training.scenes import SceneOptions, load_scene
from training.scenes.colmap import sparse_points
from training.scenes.scene_options import axes_of


def eyes(scene) -> np.ndarray:
    return np.stack([p.camera.world_T_camera[:3, 3] for split in scene.splits.values() for p in split])


@pytest.fixture(scope="module")
def leaning(tmp_path_factory) -> Path:
    """Cameras that all stand on one side and look down at a ball: their mean up leans back."""
    return write_colmap(tmp_path_factory.mktemp("leaning") / "scene", around(), ball(300, 1.0))


def test_what_is_up_becomes_z_and_all_else_turns_along(leaning: Path) -> None:
    up = (0.3, -0.2, 1.5)
    before, after = load_scene(leaning), load_scene(leaning, up=up)
    turn = axes_of(up)
    np.testing.assert_allclose(turn @ [0, 0, 1], np.array(up) / np.linalg.norm(up), atol=1e-12)
    np.testing.assert_allclose(eyes(after), eyes(before) @ turn, atol=1e-9)
    points = sparse_points(before).places, sparse_points(after).places
    np.testing.assert_allclose(points[1], points[0] @ turn, atol=1e-9)
    inside = ((points[1] > after.aabb[0]) & (points[1] < after.aabb[1])).all(-1)
    assert inside.mean() > 0.95, "the box is that of the points as they lie now"
    assert (after.near, after.far) == pytest.approx((before.near, before.far))
    np.testing.assert_allclose(load_scene(leaning, up=(0.0, 0.0, 2.0)).aabb, before.aabb, atol=1e-9)


def test_a_run_remembers_what_is_up(tmp_path: Path) -> None:
    options = vars(SceneOptions(up=(0.0, -1.0, 0.5)))
    document = {"format": 1, "scene": "s", "scene_options": options, "config": {}}
    (tmp_path / "config.json").write_text(json.dumps(document))
    assert read_description(tmp_path).options.up == (0.0, -1.0, 0.5)
    assert reading_of(tmp_path)["up"] == (0.0, -1.0, 0.5)
    document["scene_options"] = {**options, "up": [1, 2]}
    (tmp_path / "config.json").write_text(json.dumps(document))
    with pytest.raises(UserError):
        read_description(tmp_path)
