"""Where rays begin: one rule for the field, and for the evaluation of its packs. Pruning and tuning: tuning/test_marcher.py."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from baker.reports.evaluation import evaluate, shown_by
from scenepack import Pack, save_pack
from tests.baker.analytic import RADIUS
from tests.scenepack.helpers import small_pack
from tests.scenepack.volumes import BLENDER_FRAME, centres, cube_pack
from tests.stored_runs import SCENE, STORED
from training.run import load_run
from training.scenes import Camera, Scene

SIDE, BLOCK = 42, 14
# cameras stand 4.03 from the origin; the speck is SPECK from it, towards the first
NEAR, SPECK, SPECK_RADIUS = 3.05, 1.4, 0.2


def ball_pack(camera: Camera, speck: bool) -> Pack:
    """An opaque ball, hidden by the speck or not, as a pack that knows where its rays begin."""
    at = 1.5 * np.stack(centres(SIDE), axis=-1)
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    rgba[np.linalg.norm(at, axis=-1) < RADIUS] = (200, 100, 50, 255)
    if speck:
        eye = camera.world_T_camera[:3, 3]
        away = at @ BLENDER_FRAME[:3, :3].T - SPECK * eye / np.linalg.norm(eye)
        rgba[np.linalg.norm(away, axis=-1) < SPECK_RADIUS] = (0, 0, 255, 255)
    pack = cube_pack(rgba, BLOCK, features=np.zeros_like(rgba))
    return replace(pack, voxel_size=3.0 / SIDE, min_xyz=np.full(3, -1.5)).with_metadata(near=NEAR)


def test_the_field_is_drawn_without_what_is_nearer_than_near() -> None:
    """As the density says that it has along the same rays."""
    run = load_run(STORED / "multires", scene_path=SCENE)
    rays = run.dataset.view_rays(run.scene.splits["test"][0].camera)
    t = np.arange(2.0, 6.0, 0.02)
    points = rays.origins[:, None] + t[:, None] * rays.directions[:, None]
    density = np.asarray(run.method.query(run.state, points.reshape(-1, 3)).density).reshape(-1, len(t))
    for near in (0.0, 3.4, 4.4):  # the middle of the content lies at 4.03
        expected = 1 - np.exp(-0.02 * (density * (t >= near)).sum(axis=1))
        found = run.method.render(run.state, rays._replace(near=jnp.full_like(rays.near, near))).alpha
        assert np.abs(found - expected).mean() < 0.015 and expected.mean() > 0.15


def test_a_pack_is_drawn_and_scored_as_its_field_is(scene: Scene, tmp_path: Path) -> None:
    alone = replace(scene, near=NEAR, splits={"train": scene.splits["train"][:1]})
    camera = alone.splits["train"][0].camera
    ball, hidden = (ball_pack(camera, speck) for speck in (False, True))
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
