"""transforms.json in the two layouts: one camera model, space from cameras and points, splits, and what is refused by name."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData, PlyElement

from console import Notice
from tests.scenepack.helpers import edit_json
from tests.training.test_captures import circle, complaint, everyone, write_transforms
from training.scenes import load_scene
from training.scenes.poses import look_at
from training.scenes.scene import Camera, Scene
from training.scenes.scene_options import require_rays
from training.scenes.space import PointCloud, space_of_capture

SIZE = (40, 30)
ORIGIN = (0.0, 0.0, 0.0)
FOCAL = 55.0  # frames what NeRF-synthetic's cameras frame
SYNTHETIC = circle(9, radius=4.03 / np.hypot(1, 0.4), centre=ORIGIN)  # cameras as NeRF-synthetic has them


def write_blender(path: Path, P: np.ndarray = SYNTHETIC, *, mode="RGBA", **values) -> Path:
    """transforms_{train,test}.json, of which the last 2 cameras are for testing. values: keys at the top."""
    values = values or {"fl_x": FOCAL}
    for split, poses in (("train", P[:-2]), ("test", P[-2:])):
        (path / split).mkdir(parents=True, exist_ok=True)
        frames = [{"file_path": f"./{split}/r_{i}", "transform_matrix": p.tolist()} for i, p in enumerate(poses)]
        for i in range(len(poses)):
            Image.new(mode, SIZE, (200, 10 * i, 0, 255)[: len(mode)]).save(path / split / f"r_{i}.png")
        (path / f"transforms_{split}.json").write_text(json.dumps({"frames": frames, **values}))
    return path


def write_capture(path: Path, P: np.ndarray | None = None, **values) -> Path:
    """transforms.json with pictures in images."""
    focal = {} if any(key.startswith(("fl_", "camera_angle", "x_fov")) for key in values) else {"fl_x": FOCAL}
    return write_transforms(path, circle(9) if P is None else P, lens=focal, size=SIZE, **values)


def eyes_of(scene: Scene) -> np.ndarray:
    return np.stack([photograph.camera.world_T_camera[:3, 3] for photograph in everyone(scene)])


@pytest.mark.parametrize("write", [write_blender, write_capture])
@pytest.mark.parametrize(
    "values",
    [
        {"fl_x": 60.0},
        {"fl_y": 60.0},
        {"camera_angle_x": 2 * np.arctan(20 / 60)},
        {"camera_angle_y": 2 * np.arctan(15 / 60)},
        {"x_fov": 2 * np.degrees(np.arctan(20 / 60))},
    ],
)
def test_one_focal_length_or_angle_is_enough(tmp_path: Path, write, values):
    """Of both sides, and pictures of other sizes: tests/fuzz/spellings.py."""
    for photograph in everyone(load_scene(write(tmp_path, **values))):
        assert (photograph.camera.fx, photograph.camera.fy) == pytest.approx((60, 60))


@pytest.mark.parametrize("write", [write_blender, write_capture])
@pytest.mark.parametrize(
    "values",
    [
        {"camera_model": "EQUIRECTANGULAR", "k1": 0.1},
        {"camera_model": "OPENCV_FISHEYE", "k5": 0.1},
        {"camera_model": "OPENCV", "k4": 0.1},
        {"camera_model": "a lens of the future"},
        {"camera_model": 3},
        {"camera_model": "FULL_OPENCV", "s1": 0.01},
        {"equirectangular": True},
        {"latlong": 1},
        {"ftheta_p0": 0.2},
        {"sx1": 0.1},
        {"s1": 0.1},
    ],
)
def test_lenses_that_are_not_understood_are_refused_by_name(tmp_path: Path, write, values):
    line = complaint(write(tmp_path, fl_x=FOCAL, **values))
    named = str(values.get("camera_model", next(iter(values))))
    assert "lens model is not supported" in line and named in line


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda M: M * [[-1], [1], [1], [1]], "mirrors the world"),
        (lambda M: M * [1, 1, -1, 1], "determinant -1"),
        (lambda M: M.T, "last row"),
        (lambda M: M + 0.3 * np.outer(np.eye(4)[0], np.eye(4)[1]), "right angles"),
    ],
)
@pytest.mark.parametrize("write", [write_blender, write_capture])
def test_matrices_that_are_no_pose_are_refused(tmp_path: Path, write, change, words):
    P = circle(9)
    assert words in complaint(write(tmp_path, np.stack([change(M) for M in P])))


@pytest.mark.parametrize("write", [write_blender, write_capture])
def test_frames_without_a_matrix_are_left_out(tmp_path: Path, write):
    path = write(tmp_path)
    file = path / ("transforms_train.json" if write is write_blender else "transforms.json")
    edit_json(file, lambda d: (d["frames"][2].pop("transform_matrix"), d["frames"][3].update(transform_matrix=None)))
    with pytest.warns(Notice, match=r"2 of \d frames have no transform_matrix and are left out \("):
        assert len(everyone(load_scene(path))) == 7


@pytest.mark.parametrize(("scale", "offset"), [(1, 0), (0.3, 0), (6, 0), (1, 10), (1e3, -4e3)])
def test_an_object_of_any_scale_and_place_gets_the_published_bounds(tmp_path: Path, scale, offset):
    P = SYNTHETIC.copy()
    P[:, :3, 3] = scale * P[:, :3, 3] + np.array([1, 0, 0.2]) * offset
    scene = load_scene(write_blender(tmp_path, P))
    assert (scene.near, scene.far) == (2, 6) and np.abs(scene.aabb).tolist() == [[1.5] * 3] * 2
    assert np.linalg.norm(eyes_of(scene), axis=-1).mean() == pytest.approx(4.03)
    require_rays(scene)


def test_cameras_that_look_outwards_have_a_box_around_them(tmp_path: Path):
    P = circle(9, centre=ORIGIN)
    P[:, :3, 0] *= -1
    P[:, :3, 2] *= -1
    for path in (write_blender(tmp_path / "b", P, mode="RGB"), write_capture(tmp_path / "t", P)):
        scene = load_scene(path)
        assert np.abs(scene.aabb).max() >= 2 * np.abs(eyes_of(scene)).max()
        require_rays(scene)


@pytest.mark.parametrize("aabb_scale", [16, 32, 128])
def test_a_converters_aabb_scale_reaches_no_further_than_what_cameras_look_at(tmp_path: Path, aabb_scale):
    assert np.abs(load_scene(write_capture(tmp_path, aabb_scale=aabb_scale)).aabb).max() == 1.5


def test_scale_offset_and_aabb_place_the_box_as_instant_ngp_does(tmp_path: Path):
    centre, scale = np.array([1.0, -2.0, 0.5]), 0.11
    mean = 3 * np.sqrt(1 + 0.4**2)  # distance of the cameras, our unit
    plain = load_scene(write_capture(tmp_path / "a", scale=scale, offset=(0.5 - scale * centre).tolist(), aabb_scale=1))
    np.testing.assert_allclose(np.abs(plain.aabb), 0.5 / scale / mean, atol=1e-6)
    aabb = [[-1, -3, -0.5], [3, -1, 1.5]]  # about the centre
    boxed = load_scene(write_capture(tmp_path / "b", aabb=aabb))
    np.testing.assert_allclose(np.abs(boxed.aabb), 2 / mean, atol=1e-6)
    with pytest.warns(Notice, match="do not look at"):
        elsewhere = load_scene(write_capture(tmp_path / "c", scale=0.5, offset=[9, 9, 9]))
    assert np.abs(elsewhere.aabb).tolist() == [[1.5] * 3] * 2
    assert "no list of 6 numbers" in complaint(write_capture(tmp_path / "d", aabb=[[1, 2], [3, 4]]))


@pytest.mark.parametrize("text", [True, False])
def test_the_points_that_a_file_names_say_where_things_are(tmp_path: Path, text: bool):
    points = np.random.default_rng(0).normal(size=(400, 3)) * 0.2 + [1.0, -2.0, 0.5]
    path = write_capture(tmp_path, ply_file_path="points.ply")
    edit_json(path / "transforms.json", lambda d: d.update(fl_x=30.0))
    vertices = points.astype("<f4").view([(axis, "<f4") for axis in "xyz"])[:, 0]
    PlyData([PlyElement.describe(vertices, "vertex")], text=text).write(str(path / "points.ply"))
    for file in (path / "images").iterdir():
        Image.new("RGBA", SIZE, (9, 9, 9, 0)).save(file)  # nothing needs to be in the box up to the corners
    scene = load_scene(path)
    assert 0.1 < np.abs(scene.aabb).max() < 0.4 and 0.3 < scene.near <= 0.45
    (path / "points.ply").write_bytes((path / "points.ply").read_bytes()[:-999] + b"x")
    with pytest.warns(Notice, match="points are not used"):
        assert np.abs(load_scene(path).aabb).max() > 0.4


def test_values_that_make_no_sense_are_passed_over(tmp_path: Path):
    path = write_capture(tmp_path, ply_file_path="a" * 300, mask_color=[[1, 2], [3]])
    with pytest.warns(Notice, match='not read, and ignored: "mask_color"'):
        load_scene(path)


def test_photographs_that_see_nothing_are_told(tmp_path: Path):
    scene = load_scene(write_blender(tmp_path))
    away = np.eye(4)
    away[:3, 3] = 100
    moved = [replace(p, camera=replace(p.camera, world_T_camera=away)) for p in scene.splits["train"][:4]]
    some = replace(scene, splits={"train": (*moved, *scene.splits["train"][4:])})
    with pytest.warns(Notice, match="4 of 7 photographs see nothing"):
        require_rays(some)


def names(scene: Scene, split: str) -> list[str]:
    return [photograph.name for photograph in scene.splits.get(split, ())]


def test_a_frame_is_never_trained_on_and_held_out(tmp_path: Path):
    both = [f"images/{i:03d}.png" for i in range(9)]
    with pytest.warns(Notice, match="2 frames are listed for training and for testing"):
        scene = load_scene(write_capture(tmp_path / "a", train_filenames=both[:8], test_filenames=both[6:]))
    assert len(names(scene, "train")) == 8 and names(scene, "test") == both[8:]
    path = write_blender(tmp_path / "b")
    first = json.loads((path / "transforms_train.json").read_text())["frames"][0]
    edit_json(path / "transforms_test.json", lambda d: d["frames"].append(first))
    with pytest.warns(Notice, match="1 of 3 frames are trained on"):
        assert len(names(load_scene(path), "test")) == 2


def camera_at(x: float) -> Camera:
    """A camera on the x axis that looks at the origin."""
    eye = np.array([x, 0.0, 0.0])
    return Camera(look_at(eye, eye, np.array([0.0, 0.0, 1.0])), 40, 40, 40.0, 40.0, 20.0, 20.0)


def test_rays_begin_before_what_the_camera_that_comes_closest_shows() -> None:
    """Of 21 photographs one is taken from close by: by all of them together, its points would be outliers."""
    ball = np.random.default_rng(0).normal(size=(2000, 3))
    ball *= 0.2 / np.linalg.norm(ball, axis=-1, keepdims=True)
    cameras = [*(camera_at(1.0 + 0.01 * i) for i in range(20)), camera_at(0.4)]
    front = np.flatnonzero(ball[:, 0] > 0.15)  # the close one shows what it faces
    seen = [*[np.arange(len(ball))] * 20, front]
    counts = np.bincount(np.concatenate(seen), minlength=len(ball)).astype(float)
    near = space_of_capture(cameras, PointCloud(ball, counts, seen), opaque=True).near
    assert near == pytest.approx(0.7 * 0.2, rel=0.05)
    without = space_of_capture(cameras[:-1], PointCloud(ball, counts, seen[:-1]), opaque=True).near
    assert 0.4 < without <= 0.45
