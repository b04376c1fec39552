"""Captures with camera poses but without points: near, far and box come from features that match in their photographs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from console import Notice, UserError
from tests.scenepack.helpers import edit_json
from tests.training.posing.rooms import FOCAL, SIZE, cameras, photograph
from tests.training.test_captures import write_transforms
from training.config import PRESETS
from training.posing.depths import meeting_places, with_depths
from training.run import read_description, resume_run, start_run
from training.scenes import SceneOptions, load_scene
from training.scenes.scene import Camera, camera_rays
from training.scenes.space import NEAR, poses_of

COUNT, CLOSE = 9, 4


def walkers() -> list[Camera]:
    """Cameras in the room, of which one comes close to its corner."""
    around = cameras(COUNT)
    pose = around[CLOSE].world_T_camera.copy()
    pose[:3, 3] *= 0.55
    return [*around[:CLOSE], replace(around[CLOSE], world_T_camera=pose), *around[CLOSE + 1 :]]


def write_capture(folder: Path, posed: list[Camera]) -> Path:
    """Photographs of the room with these poses, whatever those are from which they were taken, and no points."""
    write_transforms(folder, poses_of(posed), size=SIZE, lens={"fl_x": FOCAL})
    for i, camera in enumerate(walkers()):
        Image.fromarray(photograph(camera)).save(folder / f"images/{i:03d}.png")
    return folder


def test_rays_meet_where_both_come_closest_to_one_another():
    rng = np.random.default_rng(0)
    places, origins = rng.normal(size=(40, 3)), rng.normal(size=(2, 3)) + 4 * np.eye(3)[:2]
    rays = places[:, None] - origins
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    origins = np.broadcast_to(origins, rays.shape)
    found, share, apart = meeting_places(origins, rays)
    np.testing.assert_allclose(found, places, atol=1e-6)
    assert share == 1 and apart < 1e-9
    assert meeting_places(np.zeros_like(origins), rays)[1:] == (0.0, 0.0)  # of cameras at one place
    aside, behind, narrow = rays.copy(), rays.copy(), rays.copy()
    aside[:10, 1] = np.roll(rays[:10, 1], 1, axis=0)  # matches that are none
    behind[:10] *= -1
    narrow[:10, 1] = narrow[:10, 0]  # almost: they do not count
    for changed, expected in ((aside, 0.75), (behind, 0.75), (narrow, 1.0)):
        found, share, _ = meeting_places(origins, changed)
        assert (len(found), share) == (30, expected)


@pytest.mark.slow
def test_features_of_the_photographs_tell_how_near_things_are(tmp_path: Path, recwarn: pytest.WarningsRecorder):
    path = write_capture(tmp_path / "scene", walkers())
    scene = load_scene(path)
    assert scene.guessed and scene.near == NEAR
    found = with_depths(scene)
    read = [photo.camera for photo in scene.splits["train"][:2]]
    unit, scaled = (np.linalg.norm(np.diff(poses_of(two)[:, :3, 3], axis=0)) for two in (walkers()[1:3], read))
    close = walkers()[CLOSE]
    origins, directions = camera_rays(close)
    with np.errstate(divide="ignore"):
        nearest = np.quantile(np.where(directions < 0, -origins / directions, np.inf).min(-1), 0.01)
    assert found.near == pytest.approx(0.7 * nearest * scaled / unit, rel=0.1)
    assert not found.guessed and found.contraction == scene.contraction
    assert with_depths(found) is found and not len(recwarn)

    box, out, config = (-0.2, -0.2, -0.2, 0.2, 0.2, 0.2), tmp_path / "run", replace(PRESETS["quick"], steps=1)
    boxed = start_run(out, path, config, SceneOptions(aabb=box)).scene
    assert boxed.near == found.near and tuple(boxed.aabb.ravel()) == box
    edit_json(out / "config.json", lambda document: document["depths"].update(near=0.125))
    assert resume_run(out, read_description(out), path, config).scene.near == 0.125
    edit_json(out / "config.json", lambda document: document["depths"].update(near=float("nan")))
    with pytest.raises(UserError, match="damaged"):
        read_description(out)


def turned(cameras: list[Camera], degrees: float) -> list[Camera]:
    """Each turned by so many degrees about its own x axis, by turns up and down."""
    found = []
    for i, camera in enumerate(cameras):
        pose, turn = camera.world_T_camera.copy(), Rotation.from_euler("x", degrees * (-1) ** i, degrees=True)
        pose[:3, :3] = pose[:3, :3] @ turn.as_matrix()
        found.append(replace(camera, world_T_camera=pose))
    return found


def test_poses_that_the_photographs_were_not_taken_from_are_told(tmp_path: Path):
    scene = load_scene(write_capture(tmp_path / "reversed", walkers()[::-1]))
    with pytest.warns(Notice, match="lie where the camera poses say"):
        assert with_depths(scene) is scene
    scene = load_scene(write_capture(tmp_path / "turned", turned(walkers(), 0.3)))
    with pytest.warns(Notice, match=r"matching features lie \d\.\d of \d+ pixels from where .* --find-poses"):
        assert not with_depths(scene).guessed
