"""A pack says where its rays begin, and is drawn and scored so. Of the field and the marcher: test_marching, test_marcher.

Notation: a speck hangs before the first camera, nearer than `near`, and hides an opaque ball from it.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baker.reports.evaluation import evaluate, shown_by
from scenepack import Pack, save_pack
from tests.baker.analytic import RADIUS
from tests.scenepack.helpers import small_pack
from tests.scenepack.volumes import BLENDER_FRAME, cube_pack
from training.scenes import Scene

SIDE, BLOCK = 42, 14
# cameras stand 4.03 from the origin; the speck is SPECK from it, towards the first
NEAR, SPECK, SPECK_RADIUS = 3.05, 1.4, 0.2


def ball_pack(eye: np.ndarray, speck: bool) -> Pack:
    """The ball, with the speck before a camera at `eye`, as a pack that knows where its rays begin."""
    voxel = 3.0 / SIDE
    at = np.stack(np.meshgrid(*[(np.arange(SIDE) + 0.5) * voxel - 1.5] * 3, indexing="ij")[::-1], axis=-1)
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    rgba[np.linalg.norm(at, axis=-1) < RADIUS] = (200, 100, 50, 255)
    if speck:
        away = at @ BLENDER_FRAME[:3, :3].T - SPECK * eye / np.linalg.norm(eye)
        rgba[np.linalg.norm(away, axis=-1) < SPECK_RADIUS] = (0, 0, 255, 255)
    pack = cube_pack(rgba, BLOCK, features=np.zeros_like(rgba))
    return replace(pack, voxel_size=voxel, min_xyz=np.full(3, -1.5)).with_metadata(near=NEAR)


def test_a_pack_is_drawn_and_scored_without_what_is_nearer_than_near(scene: Scene, tmp_path: Path) -> None:
    alone = replace(scene, near=NEAR, splits={"train": scene.splits["train"][:1]})
    camera = scene.splits["train"][0].camera
    ball, hidden = (ball_pack(camera.world_T_camera[:3, 3], speck) for speck in (False, True))
    pictures, scores = [], []
    for name, pack in (("ball", ball), ("hidden", hidden), ("anywhere", hidden.with_metadata(near=0.0))):
        save_pack(pack, tmp_path / name)
        with shown_by(tmp_path / name) as drawn:
            pictures.append(drawn.show(camera, "normal"))
        scores.append(evaluate(tmp_path / name, alone, "train")["psnr"])
    differences = [np.abs(picture - pictures[0]).max() for picture in pictures]
    assert differences[1] < 0.2 < differences[2] and scores[0] == pytest.approx(scores[1], abs=1e-6)


@pytest.mark.parametrize("near", ["0.5", True, -1.0, np.nan, np.inf, None, [1.0], pytest.param(10**400, id="huge")])
def test_a_pack_that_says_nonsense_begins_at_the_camera(near: object) -> None:
    pack = small_pack().with_metadata(near=NEAR)
    assert pack.near == NEAR and pack.with_metadata(near=near).near == 0.0
