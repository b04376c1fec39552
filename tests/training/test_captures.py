"""Captures of the real world: LLFF (forward-facing and from all around), transforms.json, masks, held-out views."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from PIL import Image

from console import Notice, UserError
from training.scenes import load_pixels, load_scene
from training.scenes.poses import focus_point, look_at

LENS: Mapping[str, float] = MappingProxyType({"fl_x": 33.0, "fl_y": 34.0, "cx": 14.0, "cy": 11.0, "w": 30, "h": 20})
PICTURES = MappingProxyType({"images": (40, 32)})


def circle(count: int = 12, radius: float = 3.0, centre=(1.0, -2.0, 0.5), height: float = 0.4) -> np.ndarray:
    """Cameras on a slanted circle looking at `centre` [N, 4, 4]."""
    angle = np.arange(count) * 2 * np.pi / count
    eyes = radius * np.stack([np.cos(angle), np.sin(angle), height + 0 * angle], -1)
    return np.stack([look_at(eye + centre, eye, np.array([0.0, 0.0, 1.0])) for eye in eyes])


def forward(count: int = 10) -> np.ndarray:
    """Cameras side by side looking along -z, somewhere."""
    offsets = np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3)) * [1, 1, 0.1]
    eye, back, up = np.array([4, 5, 6]), np.array([0, 0, 1.0]), np.array([0, 1.0, 0])
    return np.stack([look_at(eye + offset, back + 0.05 * offset, up) for offset in offsets])


def write_llff(path: Path, P: np.ndarray, depths=(2.0, 8.0), sizes: Mapping[str, tuple[int, int]] = PICTURES) -> Path:
    rows = []
    for pose in P:
        right, up, back, position = pose[:3].T
        hwf = np.array([32, 40, 50.0])
        rows.append(np.concatenate([np.stack([-up, right, back, position, hwf], 1).ravel(), depths]))
    path.mkdir(exist_ok=True)
    np.save(path / "poses_bounds.npy", np.array(rows))
    for folder, size in sizes.items():
        (path / folder).mkdir()
        for i in range(len(P)):
            Image.new("RGB", size, (i, 2 * i, 3 * i)).save(path / folder / f"img_{i:02d}.png")
    return path


def write_transforms(path: Path, P: np.ndarray, size=(30, 20), lens: Mapping[str, float] = LENS, **values) -> Path:
    """transforms.json with pictures in images. lens, values: keys at its top."""
    (path / "images").mkdir(parents=True)
    frames = [{"file_path": f"images/{i:03d}.png", "transform_matrix": p.tolist()} for i, p in enumerate(P)]
    for i in range(len(P)):
        Image.new("RGB", size, (i, 0, 0)).save(path / f"images/{i:03d}.png")
    (path / "transforms.json").write_text(json.dumps({**lens, "frames": frames, **values}))
    return path


def complaint(path: Path, **options) -> str:
    """The line in which the scene, or one of its pictures, is refused."""
    with pytest.raises(UserError) as raised:
        load_pixels(load_scene(path, **options).splits["train"])
    assert "\n" not in str(raised.value)
    return str(raised.value)


def everyone(scene):
    return [p for split in scene.splits.values() for p in split]


def test_a_forward_facing_capture_is_warped_to_a_box_that_holds_all_its_rays(tmp_path: Path):
    P = forward()
    scene = load_scene(write_llff(tmp_path, P, depths=(2.0, 9.0)))
    assert scene.ndc and (scene.near, scene.far) == (0, 1) and scene.ndc_camera == (40, 32, 50.0)
    np.testing.assert_array_equal(scene.worldspace_T_opengl, np.diag([1, 1, -1, 1]))
    np.testing.assert_allclose(scene.aabb[:, 2], [-1, 1])
    read = np.stack([p.camera.world_T_camera for p in sorted(everyone(scene), key=lambda p: p.name)])
    mean = look_at(read[:, :3, 3].mean(0), read[:, :3, 2].sum(0), read[:, :3, 1].sum(0))
    np.testing.assert_allclose(mean, np.eye(4), atol=1e-9)
    ours, given = (np.linalg.norm(poses[0, :3, 3] - poses[5, :3, 3]) for poses in (read, P))
    assert ours == pytest.approx(given / (0.75 * 2.0)), "of the nearest depth"


def test_a_capture_from_all_around_is_spherified_by_itself_with_a_notice(tmp_path: Path):
    with pytest.warns(Notice, match="--spherify"):
        scene = load_scene(write_llff(tmp_path, circle()))
    assert not scene.ndc and scene.disparity and scene.near <= 0.45 and scene.far == 100
    P = np.stack([p.camera.world_T_camera for p in everyone(scene)])
    assert np.sqrt(np.square(P[:, :3, 3]).sum(-1).mean()) == pytest.approx(1)
    assert focus_point(P) == pytest.approx(np.zeros(3), abs=1e-9)
    np.testing.assert_allclose(P[:, :3, 3].mean(0)[:2], 0, atol=1e-9)  # the cameras stand about +z
    np.testing.assert_allclose(np.linalg.det(P[:, :3, :3]), 1)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda p: (p / "poses_bounds.npy").write_bytes(b"hello"), "not a NumPy file"),
        (lambda p: np.save(p / "poses_bounds.npy", np.zeros((10, 15))), "[N, 17]"),
        (lambda p: np.save(p / "poses_bounds.npy", np.full((10, 17), np.nan)), "not finite"),
        (lambda p: np.save(p / "poses_bounds.npy", np.zeros((10, 17))), "positive"),
        (lambda p: np.save(p / "poses_bounds.npy", np.array([{}], object)), "Python objects"),
        (lambda p: (p / "images" / "img_03.png").unlink(), "expected 10 pictures, found 9"),
        (lambda p: Image.new("RGB", (32, 40)).save(p / "images" / "img_03.png"), "another size"),
    ],
)
def test_a_spoilt_llff_scene_gets_one_clear_line(tmp_path: Path, spoil, words: str):
    path = write_llff(tmp_path, forward())
    spoil(path)
    assert words in complaint(path)


@pytest.mark.parametrize("change", [np.asfortranarray, lambda rows: rows.astype(">f4"), np.float32])
def test_poses_that_other_programs_write_are_read_all_the_same(tmp_path: Path, change):
    path = write_llff(tmp_path, forward())
    before = load_scene(path).splits["train"][2].camera.world_T_camera
    np.save(path / "poses_bounds.npy", change(np.load(path / "poses_bounds.npy")))
    np.testing.assert_allclose(load_scene(path).splits["train"][2].camera.world_T_camera, before, atol=1e-5)


def test_a_transforms_scene_stands_upright_about_what_its_cameras_look_at(tmp_path: Path):
    scene = load_scene(write_transforms(tmp_path / "s", circle()))
    P = np.stack([p.camera.world_T_camera for p in everyone(scene)])
    assert np.linalg.norm(P[:, :3, 3], axis=-1).mean() == pytest.approx(1)
    assert focus_point(P) == pytest.approx(np.zeros(3), abs=1e-9)
    assert P[:, 2, 1].min() > 0.5 and scene.kind == "transforms"  # every camera's up has much of z
    camera = scene.splits["train"][0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.width) == (33, 34, 14, 11, 30)


def test_real_scenes_read(real_data: Path):
    lego = load_scene(real_data / "nerf_synthetic" / "lego", downscale=8)
    assert len(lego.splits["train"]) == 100 and len(lego.splits["test"]) == 25
    picture = lego.splits["test"][0].load()
    assert picture.shape == (100, 100, 4) and 0.05 < picture[..., 3].mean() < 0.9
    fern = load_scene(real_data / "nerf_llff_data" / "fern", downscale=8)
    assert fern.ndc and len(fern.splits["test"]) == 3 and fern.ndc_camera and fern.ndc_camera[:2] == (504, 378)
    with pytest.warns(Notice):
        rose = load_scene(real_data / "real_360" / "mary_rose", downscale=16)
    assert rose.disparity and rose.splits["train"][0].load().shape == (216, 216, 4)
    with pytest.warns(Notice, match="17 of 67"):
        fox = load_scene(real_data / "transforms_json" / "fox", downscale=8)
    assert any(fox.splits["train"][0].camera.distortion) and len(everyone(fox)) == 50
