"""COLMAP scenes: the geometry of what pycolmap wrote, which pictures are taken, and what is wrong with the files."""

import shutil
import warnings
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from console import Notice
from tests.training.reconstructions import SIZE, ball, ndc_points, save_picture, side_by_side, write_colmap
from tests.training.test_captures import circle, complaint, everyone, write_transforms
from tools.pose_error import similarity
from training.scenes import load_scene
from training.scenes.colmap import sparse_points
from training.scenes.colmap_files import read_reconstruction
from training.scenes.pictures import PictureLoader
from training.scenes.pixels import may_be_transparent
from training.scenes.scene import Scene, camera_rays
from training.scenes.space import poses_of


def met_points(scene: Scene, model: Path) -> tuple[np.ndarray, np.ndarray, float]:
    """Where the rays through each point's pixels meet [M, 3], COLMAP's place of it [M, 3], and how far they miss, at most.

    Says nothing of how the reader makes cameras: pixels and places are pycolmap's, rays are training.scenes.scene'.
    """
    made = pycolmap.Reconstruction(model)
    cameras = {photograph.name: photograph.camera for photograph in everyone(scene)}
    lines: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    for image in made.images.values():
        camera = cameras[image.name]
        for point in image.points2D:
            x, y = point.xy / SIZE * (camera.width, camera.height)
            lines.setdefault(point.point3D_id, []).append(camera_rays(camera, np.array(x), np.array(y)))
    met, miss = [], 0.0
    for rays in lines.values():
        origins, directions = (np.stack(values) for values in zip(*rays, strict=True))
        across = np.eye(3) - directions[:, :, None] * directions[:, None]
        at = np.linalg.solve(across.sum(0), (across @ origins[..., None]).sum(0)[:, 0])
        miss = max(miss, float(np.linalg.norm((across @ (at - origins)[..., None])[..., 0], axis=-1).max()))
        met.append(at)
    return np.array(met), np.array([made.points3D[number].xyz for number in lines]), miss


@pytest.mark.parametrize("models", [("SIMPLE_PINHOLE", "PINHOLE"), ("SIMPLE_RADIAL", "RADIAL"), ("PINHOLE", "OPENCV")])
@pytest.mark.parametrize("downscale", [1, 5])
def test_rays_through_a_points_pixels_meet_where_colmap_has_it_and_up_is_up(tmp_path, models, downscale):
    path = write_colmap(tmp_path, circle(10), ball(), models)
    scene = load_scene(path, downscale=downscale)
    met, places, miss = met_points(scene, path / "sparse/0")
    assert len(met) == 150 and miss < 1e-6
    scale, R, offset = similarity(places, met)
    np.testing.assert_allclose(scale * places @ R.T + offset, met, atol=1e-6)
    np.testing.assert_allclose(R[:, 2], [0, 0, 1], atol=0.02)
    assert np.linalg.norm([p.camera.world_T_camera[:3, 3] for p in everyone(scene)], axis=-1).mean() == pytest.approx(1)


def test_the_points_say_where_things_are_whatever_was_matched_wrongly(tmp_path):
    path = write_colmap(tmp_path, circle(10), ball(), mistakes=2)
    for picture in (path / "images").rglob("*.png"):
        save_picture(path / "masks" / picture.relative_to(path / "images"))
    scene = load_scene(path, masks=True)
    clean = write_colmap(tmp_path / "clean", circle(10), ball())
    met, _, _ = met_points(load_scene(clean), clean / "sparse/0")
    inside = np.all((met > scene.aabb[0]) & (met < scene.aabb[1]), axis=1)
    assert inside.mean() > 0.95 and np.ptp(scene.aabb, axis=0).max() < 2 * np.ptp(met, axis=0).max()
    eyes = np.stack([p.camera.world_T_camera[:3, 3] for p in everyone(scene)])
    distances = np.linalg.norm(met[:, None] - eyes, axis=-1)
    assert 0.3 < scene.near < distances.min() and scene.far > distances.max() and scene.disparity and not scene.ndc


def test_opaque_photographs_are_in_the_box_up_to_their_corners(tmp_path):
    scene = load_scene(write_colmap(tmp_path, circle(10), ball(), ("PINHOLE",)))
    x, y = (side.ravel() for side in np.meshgrid([0.0, SIZE[0]], [0.0, SIZE[1]]))
    rays = [camera_rays(photograph.camera, x, y) for photograph in everyone(scene)]
    corners = np.concatenate([origins + directions for origins, directions in rays])  # about as far away as the points
    inside = np.all((corners > scene.aabb[0] - 0.02) & (corners < scene.aabb[1] + 0.02), axis=1)
    assert inside.all() and np.abs(scene.aabb).max() <= 1.5


def test_a_capture_that_looks_outwards_has_its_walls_in_the_box(tmp_path):
    P = circle(10)
    P[:, :3, 0] *= -1
    P[:, :3, 2] *= -1  # turned round, and still no mirror
    directions = np.random.default_rng(3).normal(size=(900, 3))
    walls = 12 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    scene = load_scene(write_colmap(tmp_path, P, np.add(walls, (1, -2, 0.5)), ("PINHOLE",)))
    assert np.ptp(scene.aabb, axis=0)[:2].min() > 2 * 12 / 3.3 and np.linalg.norm(scene.aabb.mean(0)[:2]) < 0.2


def test_every_eighth_picture_by_name_is_held_out_and_folders_belong_to_names(tmp_path):
    scene = load_scene(write_colmap(tmp_path, circle(10), ball()))
    names = sorted(p.name for p in everyone(scene))
    assert names[0] == "left/01.png" and [p.name for p in scene.splits["test"]] == names[::8]
    photograph = scene.splits["train"][0]
    colour = 10 * int(Path(photograph.name).stem)
    assert photograph.load()[0, 0, 0] == pytest.approx(colour / 255)


def test_cameras_that_look_forward_are_read_in_ndc_unless_told_otherwise(tmp_path):
    depths = np.random.default_rng(4).uniform(2.0, 9.0, 300)
    aside = np.random.default_rng(5).uniform(-0.3, 0.3, (300, 2)) * depths[:, None]
    points = np.concatenate([aside, -depths[:, None]], axis=1)
    path = write_colmap(tmp_path, side_by_side(), np.add(points, (1, -2, 3.5)))
    with pytest.warns(Notice, match="--spherify"):
        scene = load_scene(path)
    assert scene.ndc and scene.ndc_camera == (*SIZE, 50.0) and (scene.near, scene.far) == (0, 1)
    met, _, miss = met_points(scene, path / "sparse/0")
    warped = ndc_points(met, *SIZE, 50.0)
    assert miss < 1e-6 and warped[:, 2].min() > -1 and 0.2 < warped[:, 2].max() < 1
    assert np.all((warped > scene.aabb[0]) & (warped < scene.aabb[1]))
    around_it = load_scene(path, spherify=True)
    assert not around_it.ndc and around_it.disparity


def test_shrunk_pictures_are_taken_where_they_are_what_they_say(tmp_path):
    path = write_colmap(tmp_path, circle(10), ball())
    for folder, size in (("images_2", (24, 18)), ("images_3", (40, 30))):
        for index in range(10):
            save_picture(path / folder / f"{'left' if index % 2 else 'right'}/{index:02d}.jpg", size, index)
    for downscale, size, source in ((1, SIZE, "images"), (2, (24, 18), "images_2"), (5, (9, 7), "images_2")):
        photograph = load_scene(path, downscale=downscale).splits["train"][0]
        assert isinstance(photograph.load, PictureLoader)
        assert photograph.load.path.relative_to(path).parts[0] == source
        assert photograph.load().shape[1::-1] == (photograph.camera.width, photograph.camera.height) == size
    shutil.rmtree(path / "images")
    shutil.rmtree(path / "images_3")
    with pytest.warns(Notice, match="images_2"):
        assert load_scene(path).splits["train"][0].camera.width == 24


def test_what_is_left_out_is_told_in_one_line_each(tmp_path):
    path = write_colmap(tmp_path, circle(10), ball(), unposed=2)
    (path / "images/right/04.png").unlink()
    shutil.copytree(path / "sparse/0", path / "sparse/1")
    with pytest.warns(Notice) as warned:
        assert len(everyone(load_scene(path))) == 9
    lines = "\n".join(str(one.message) for one in warned)
    assert len(warned) == 3 and "2 of 11 pictures have no pose" in lines and "lost_0.png" in lines
    assert "1 of 10 images" in lines and "right/04.png" in lines and "2 parts" in lines


@pytest.mark.parametrize(
    ("model", "pictures"),
    [
        ("colmap/sparse/0", "images"),
        ("colmap/sparse", "images"),
        ("sparse", "images"),
        (".", "images"),
        ("sparse/0", "."),
        ("dense/sparse", "dense/images"),
        ("dense/0/sparse", "dense/0/images"),
    ],
)
def test_a_reconstruction_is_found_where_programs_leave_it(tmp_path: Path, model: str, pictures: str):
    made, path = write_colmap(tmp_path / "made", circle(10), ball()), tmp_path / "scene"
    masks = Path(pictures).parent / "masks"
    for target, source in ((model, "sparse/0"), (pictures, "images"), (masks, "images")):
        shutil.copytree(made / source, path / target, dirs_exist_ok=True)
    with warnings.catch_warnings(action="error"):
        scene = load_scene(path)
    assert scene.kind == "colmap" and len(everyone(scene)) == 10
    assert may_be_transparent(everyone(load_scene(path, masks=True)))
    found = sparse_points(scene)
    assert found is not None and len(found.places) == 150


def test_a_description_of_another_program_wins(tmp_path):
    path = write_colmap(tmp_path / "colmap", circle(10), ball())
    write_transforms(tmp_path / "both", circle(10))
    shutil.copytree(path / "sparse", tmp_path / "both/sparse")
    assert load_scene(tmp_path / "both").kind == "transforms"


def test_unsupported_lenses_are_named(tmp_path):
    words = complaint(write_colmap(tmp_path, circle(3), ball(), ("PINHOLE", "FOV")))
    assert "found FOV" in words and "RADIAL" in words and "image_undistorter" in words


def test_a_reconstruction_in_text_is_the_same(tmp_path):
    path = write_colmap(tmp_path, circle(10), ball(), ("PINHOLE", "OPENCV"), mistakes=2)
    binary, model = read_reconstruction(path / "sparse/0"), path / "sparse/0"
    pycolmap.Reconstruction(model).write_text(model)
    for file in model.glob("*.bin"):
        file.unlink()
    text = read_reconstruction(model)
    assert text.names == binary.names and len(text.names) == 10
    np.testing.assert_allclose(poses_of(text.cameras), poses_of(binary.cameras), atol=1e-9)
    np.testing.assert_allclose(text.places, binary.places, atol=1e-9)
    np.testing.assert_array_equal(text.tracks, binary.tracks)
    assert all(np.array_equal(a, b) for a, b in zip(text.seen, binary.seen, strict=True))
    lenses = [[vars(camera) | {"world_T_camera": 0} for camera in found.cameras] for found in (text, binary)]
    assert lenses[0] == lenses[1]
    assert len(everyone(load_scene(path))) == 10
    for name in ("cameras.txt", "images.txt", "points3D.txt"):
        whole = (model / name).read_bytes()
        rows = whole.split(b"\n")
        first = next(i for i, row in enumerate(rows) if row and not row.startswith(b"#"))
        for spoilt in (b"x " + rows[first], rows[first].split()[0], rows[first].replace(b" ", b" nan ", 2), b"\xff" * 90,
                       b"1 " * (10_000 if name == "images.txt" else 3), b"9" * 400 + b" " + rows[first]):  # fmt: skip
            (model / name).write_bytes(b"\n".join([*rows[:first], spoilt, *rows[first + 1 :]]))
            assert name in complaint(path)
        (model / name).write_bytes(whole)


def test_missing_parts_and_pictures_are_told(tmp_path):
    path = write_colmap(tmp_path, circle(3), ball())
    save_picture(path / "images/left/01.png", (36, 48))
    assert "the shape of 48x36" in complaint(path)
    (path / "images/left/01.png").write_text("no picture")
    assert "not a readable picture" in complaint(path)
    shutil.rmtree(path / "images")
    assert "no pictures" in complaint(path)
    (path / "images").mkdir()
    assert "picture not found" in complaint(path)
    (path / "sparse/0/images.bin").unlink()
    assert "images.bin: this part" in complaint(path)
    for spoilt in (b"\xff" * 200, b"version https://git-lfs.github.com/spec/v1\n", b""):
        (path / "sparse/0/images.bin").write_bytes(spoilt)
        assert "images.bin" in complaint(path)


def test_the_largest_reconstruction_is_read_and_damaged_ones_are_passed_over(tmp_path):
    path = write_colmap(tmp_path, circle(10), ball(), folder="sparse/1")
    assert len(everyone(load_scene(path))) == 10, "there need not be a 0"
    small = write_colmap(tmp_path / "small", circle(3), ball())
    shutil.copytree(small / "sparse/0", path / "sparse/0")
    with pytest.warns(Notice, match="2 parts; reading 1, the largest"):
        assert len(everyone(load_scene(path))) == 10
    (path / "sparse/0/images.bin").write_bytes(b"damaged")
    with pytest.warns(Notice, match="reading 1"):
        assert len(everyone(load_scene(path))) == 10
