"""Reading Blender scenes, and what a person is told when a scene is bad."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from console import UserError
from tests.scenepack.helpers import edit_json
from tests.training.reconstructions import ball, write_colmap
from tests.training.test_captures import circle, complaint, everyone, forward, write_llff, write_transforms
from tests.training.test_training import MINUTE
from training.commands.train import main
from training.config import PRESETS
from training.loop import train
from training.run import load_run, read_description
from training.scenes import Scene, SceneOptions, load_pixels, load_scene
from training.scenes.colmap import sparse_points
from training.scenes.pictures import over_background, shrink
from training.scenes.scene import few_line
from training.scenes.scene_options import axes_of, box_text


@pytest.fixture
def copy(procedural_path: Path, tmp_path: Path) -> Path:
    """A copy of the procedural scene to spoil."""
    return Path(shutil.copytree(procedural_path, tmp_path / "scene"))


def test_a_blender_scene_has_its_published_frame_and_bounds(scene: Scene):
    assert scene.kind == "blender" and not scene.ndc
    assert {split: len(photographs) for split, photographs in scene.splits.items()} == {"train": 12, "test": 2}
    assert (scene.near, scene.far, scene.background) == (2.0, 6.0, (1.0, 1.0, 1.0))
    np.testing.assert_array_equal(scene.aabb, [[-1.5] * 3, [1.5] * 3])
    np.testing.assert_array_equal(scene.worldspace_T_opengl, [[-1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    camera = scene.splits["train"][0].camera
    assert camera.fx == pytest.approx(24 / np.tan(0.6911112 / 2)) and (camera.cx, camera.cy) == (24, 24)
    assert scene.splits["train"][3].name == "train/r_3"


def test_pictures_are_decoded_when_asked_for_and_not_before(copy: Path):
    scene = load_scene(copy)
    (copy / "train" / "r_0.png").write_bytes(b"")
    with pytest.raises(UserError, match=r"r_0\.png"):
        scene.splits["train"][0].load()


def test_shrinking_keeps_the_mean_of_premultiplied_colour_and_alpha():
    rng = np.random.default_rng(0)
    picture = rng.random((12, 18, 4)).astype(np.float32)
    for size in ((6, 4), (7, 5), (1, 1)):
        small = shrink(picture, *size)
        assert small.shape == (size[1], size[0], 4)
        for p in (lambda x: x[..., :3] * x[..., 3:], lambda x: x[..., 3]):
            np.testing.assert_allclose(p(small).mean((0, 1)), p(picture).mean((0, 1)), atol=1e-5)
        white = over_background(small, (1, 1, 1)).mean((0, 1))
        np.testing.assert_allclose(white, over_background(picture, (1, 1, 1)).mean((0, 1)), atol=1e-5)


def test_any_range_of_the_pixels_of_many_pictures_can_be_loaded(scene: Scene):
    train = scene.splits["train"]
    pixels = load_pixels(train)
    assert pixels.shape == (12 * 48 * 48, 4) and pixels.dtype == np.uint8
    third = np.rint(train[2].load() * 255).reshape(-1, 4)
    np.testing.assert_array_equal(pixels[2 * 48 * 48 : 3 * 48 * 48], third)
    np.testing.assert_array_equal(load_pixels(train, 2 * 48 * 48 - 5, 3 * 48 * 48 - 7)[5:], third[:-7])
    assert not load_pixels(train, len(pixels) - 1, len(pixels) + 3)[1:].any(), "padding is 0"


def test_a_folder_without_a_scene_says_what_was_looked_for(tmp_path: Path):
    (tmp_path / "notes.txt").write_text("hello")
    line = complaint(tmp_path)
    assert "transforms_train.json" in line and str(tmp_path) in line


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(frames=[]), "no frames"),
        (lambda d: d.pop("frames"), "no frames"),
        (lambda d: d.update(frames={"a": 1}), "no frames"),
        (lambda d: d["frames"][1].pop("file_path"), "file_path"),
        (lambda d: d.pop("camera_angle_x"), "camera_angle_x"),
        (lambda d: d.update(camera_angle_x=float("nan")), "camera_angle_x"),
        (lambda d: d.update(camera_angle_x=7), "field of view"),
        (lambda d: [frame.pop("transform_matrix") for frame in d["frames"]], "no picture has a pose"),
        (lambda d: d["frames"][1].update(transform_matrix=[[1, 2], [3, 4]]), "shape"),
        (lambda d: d["frames"][1].update(transform_matrix=[[1, 2, 3], [4]]), "not numbers"),
        (lambda d: d["frames"][1].update(transform_matrix="north"), "not numbers"),
        (lambda d: d["frames"][1]["transform_matrix"][0].__setitem__(3, float("inf")), "not finite"),
        (lambda d: d["frames"][1].update(transform_matrix=[[0] * 4] * 4), "right angles"),
        (lambda d: [frame.update(file_path="./train/absent") for frame in d["frames"]], "picture not found"),
    ],
)
def test_a_description_that_is_wrong_gets_one_clear_line(copy: Path, change, words: str):
    edit_json(copy / "transforms_train.json", change)
    assert words in complaint(copy)


def test_a_picture_of_another_size_is_refused_with_both_sizes(copy: Path):
    Image.new("RGBA", (40, 48)).save(copy / "train" / "r_5.png")
    line = complaint(copy)
    assert "r_5.png" in line and "the shape of 48x48" in line and "found 40x48" in line


def test_what_is_up_becomes_z_and_all_else_turns_along(tmp_path: Path) -> None:
    # cameras that all stand on one side and look down at a ball: their mean up leans back
    leaning = write_colmap(tmp_path, circle(10), ball(300, 1.0))
    up = (0.3, -0.2, 1.5)
    before, after = load_scene(leaning), load_scene(leaning, up=up)
    turn = axes_of(up)
    np.testing.assert_allclose(turn @ [0, 0, 1], np.array(up) / np.linalg.norm(up), atol=1e-12)
    eyes = [[one.camera.world_T_camera[:3, 3] for one in everyone(scene)] for scene in (before, after)]
    np.testing.assert_allclose(eyes[1], eyes[0] @ turn, atol=1e-9)
    points = [cloud.places for cloud in map(sparse_points, (before, after)) if cloud is not None]
    np.testing.assert_allclose(points[1], points[0] @ turn, atol=1e-9)
    inside = ((points[1] > after.aabb[0]) & (points[1] < after.aabb[1])).all(-1)
    assert inside.mean() > 0.95, "the box is that of the points as they lie now"
    assert (after.near, after.far) == pytest.approx((before.near, before.far))
    np.testing.assert_allclose(load_scene(leaning, up=(0.0, 0.0, 2.0)).aabb, before.aabb, atol=1e-9)


def test_a_run_whose_up_makes_no_sense_is_refused(tmp_path: Path) -> None:
    options = {**vars(SceneOptions()), "up": [1, 2]}
    document = {"format": 1, "scene": "s", "scene_options": options, "config": {}}
    (tmp_path / "config.json").write_text(json.dumps(document))
    with pytest.raises(UserError, match="up"):
        read_description(tmp_path)


BOX = (-0.5, -0.75, -0.25, 1.0, 0.5, 0.75)
WORDS = "-0.5,-0.75,-0.25,1,0.5,0.75"


def test_the_box_takes_the_place_of_the_readers_and_far_reaches_its_end(procedural_path: Path):
    plain, scene = load_scene(procedural_path), load_scene(procedural_path, aabb=BOX)
    np.testing.assert_array_equal(scene.aabb, np.reshape(BOX, (2, 3)))
    assert (scene.near, scene.far) == (plain.near, plain.far)
    wide = load_scene(procedural_path, aabb=(-9, -9, -9, 9, 9, 9))
    corner = np.max([np.linalg.norm(9 + np.abs(p.camera.world_T_camera[:3, 3])) for p in wide.splits["train"]])
    assert wide.far == pytest.approx(corner)


def test_a_run_keeps_its_box_through_resuming_and_loading(procedural_path: Path, tmp_path: Path, capsys):
    train(procedural_path, tmp_path, dataclasses.replace(MINUTE, method="multires"), SceneOptions(aabb=BOX))
    assert json.loads((tmp_path / "config.json").read_text())["scene_options"]["aabb"] == list(BOX)
    assert main([str(procedural_path), "--out", str(tmp_path), "--resume", "--steps", "13", "--aabb", WORDS]) == 0
    assert f"box of the content: {WORDS} where cameras stand 4" in capsys.readouterr().err
    run = load_run(tmp_path)
    assert run.step == 13 and run.options.aabb == BOX
    np.testing.assert_allclose(run.dataset.aabb, np.reshape(BOX, (2, 3)))


def test_a_forward_facing_scene_has_no_box_to_choose(tmp_path: Path):
    path = write_llff(tmp_path / "forward", forward())
    with pytest.raises(UserError, match=r"--aabb: .* NDC.*; leave it out"):
        load_scene(path, aabb=BOX)
    around = write_llff(tmp_path / "around", circle())
    box = load_scene(around, spherify=True).aabb * 0.5
    assert box_text(load_scene(around, spherify=True, aabb=box.ravel()).aabb) == box_text(box)


@pytest.mark.parametrize(
    ("photographs", "words"),
    [(1, "one photograph"), (2, "one photograph"), (6, "5 photographs to train on are few"), (10, None)],
)
def test_what_can_be_expected_of_few_photographs_is_said(tmp_path: Path, photographs: int, words: str | None) -> None:
    line = few_line(load_scene(write_transforms(tmp_path / "t", circle(photographs))))
    assert (line is None) if words is None else (line is not None and words in line)


def test_cameras_that_all_look_away_from_the_box_are_refused_before_training(copy, tmp_path, refused):
    def turn_round(document: dict[str, Any]) -> None:
        for frame in document["frames"]:
            frame["transform_matrix"] = (np.array(frame["transform_matrix"]) * [-1, 1, -1, 1]).tolist()

    edit_json(copy / "transforms_train.json", turn_round)
    line = refused(main, copy, "--out", tmp_path / "run", "--preset", "tiny", "--steps", 2)
    assert "no photograph sees the box of the content" in line
    assert not (tmp_path / "run").exists()


def test_a_field_that_no_ray_meets_does_not_end_as_a_success(copy: Path, tmp_path: Path) -> None:
    for picture in (copy / "train").glob("*.png"):
        corner = Image.new("RGBA", (48, 48))
        corner.paste((255, 0, 0, 255), (0, 0, 8, 8))
        corner.save(picture)
    middle = SceneOptions(aabb=(-0.2, -0.2, -0.2, 0.2, 0.2, 0.2))
    with pytest.raises(UserError, match=r"the field is empty .*--aabb"):
        train(copy, tmp_path / "run", dataclasses.replace(PRESETS["quick"], steps=8, log_every=4), middle)
