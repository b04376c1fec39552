"""`snerg-pack export`: files that a second library opens, and that are the scene which was known by formula."""

import json
import struct
from pathlib import Path
from typing import Any

import gsply
import numpy as np
import pytest

from baker.commands.pack import main
from scenepack import Pack
from scenepack.exports import scene
from scenepack.exports.field import Field
from scenepack.exports.file_formats import COLUMNS, opacity_table
from scenepack.exports.scene import KINDS, Export, coarseness, export_scene, preview_geometry
from scenepack.exports.surface import components, decimated, extract, smoothed
from tests.scenepack.helpers import written
from tests.scenepack.volumes import BLENDER_FRAME, NDC_FRAME, PLANE, centres, cube_pack, plane_pack, solid_pack
from tests.viewer.rendering.shapes import BALL, SKY, surroundings_pack
from viewer.features.photographs.photographs import shots_of
from viewer.rendering.camera import ViewCamera

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: the extra dev")
SIDE, BLOCK, RADIUS, CENTRE = 42, 14, 0.55, np.array([0.1, -0.05, 0.2])
VOXEL = 2 / SIDE
COLOUR = (200, 120, 40)
AT = {name: i for i, (name, _) in enumerate(COLUMNS)}


def ball_inside() -> np.ndarray:
    x, y, z = centres(SIDE)
    return (RADIUS - np.sqrt((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2 + (z - CENTRE[2]) ** 2)) / VOXEL


@pytest.fixture(scope="module")
def ball() -> Pack:
    """A ball across eight macroblocks, and a floater of a few voxels."""
    x, y, z = centres(SIDE)
    floater = 1.5 - np.sqrt((x + 0.8) ** 2 + (y - 0.8) ** 2 + (z + 0.8) ** 2) / VOXEL
    return solid_pack(np.maximum(ball_inside(), floater), COLOUR)


@pytest.fixture(scope="module")
def folder(ball: Pack, tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(written(tmp_path_factory.mktemp("packs") / "ball", ball))


def run(folder: str, out: Path, *words: str) -> int:
    return main(["export", folder, "--to", str(out), *words])


def gaussians_of(file: Path) -> np.ndarray:
    body = file.read_bytes().partition(b"end_header\n")[2]
    return np.frombuffer(body, "<f4").reshape(-1, len(COLUMNS))


def test_seams_between_macroblocks_are_closed_whatever_the_opacities(ball: Pack) -> None:
    """Noise meets every case of marching cubes on the seams, the ambiguous ones as well."""
    rng = np.random.default_rng(3)
    noise = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    noise[..., 3] = rng.integers(0, 256, noise.shape[:3]) * (rng.random(noise.shape[:3]) < 0.7)
    pack = cube_pack(noise, BLOCK)
    for each, coarser in ((ball, 1), (ball, 2), (pack, 1), (pack, 7)):
        surface = extract(Field(each, coarser), 0.15)
        edges = np.sort(np.concatenate([surface.faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
        _, times = np.unique(edges, axis=0, return_counts=True)
        assert len(surface.faces) > 50 and np.all(times % 2 == 0)  # every edge has a face on either side
        directed = np.concatenate([surface.faces[:, [i, (i + 1) % 3]] for i in range(3)]).astype(np.int64)
        there = np.bincount(directed[:, 0], minlength=len(surface.vertices))
        assert np.array_equal(there, np.bincount(directed[:, 1], minlength=len(surface.vertices)))


@pytest.mark.parametrize("name", ["mesh.glb", "mesh.ply"])
def test_a_mesh_is_the_closed_ball_that_the_pack_holds_in_another_library(folder, tmp_path, name):
    assert run(folder, tmp_path / name, "--level", "0.5", "--keep", "largest") == 0
    mesh = trimesh.load(tmp_path / name, force="mesh", process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.03)  # positive: normals point out
    off = np.linalg.norm(mesh.vertices - CENTRE, axis=1) - RADIUS
    assert np.abs(off).max() < 0.6 * VOXEL
    outwards = (mesh.vertices - CENTRE) / np.linalg.norm(mesh.vertices - CENTRE, axis=1, keepdims=True)
    assert np.sum(mesh.vertex_normals * outwards, axis=1).min() > 0.9


def parts_of_glb(file: Path) -> tuple[dict[str, Any], bytes]:
    data = file.read_bytes()
    magic, version, length, text, _ = struct.unpack("<IIIII", data[:20])
    assert (magic, version, length) == (0x46546C67, 2, len(data))
    return json.loads(data[20 : 20 + text]), data[28 + text :]


def test_a_glb_says_what_it_is_and_its_colours_are_linear(folder: str, tmp_path: Path) -> None:
    """Read by hand, as the format has it."""
    assert run(folder, tmp_path / "a.glb") == 0
    document, binary = parts_of_glb(tmp_path / "a.glb")
    assert "cameras" not in document  # glTF forbids an empty list
    primitive = document["meshes"][0]["primitives"][0]
    colour = document["accessors"][primitive["attributes"]["COLOR_0"]]
    view = document["bufferViews"][colour["bufferView"]]
    values = np.frombuffer(binary, "<u2", 4 * colour["count"], view["byteOffset"]).reshape(-1, 4)
    expected = [((c / 255 + 0.055) / 1.055) ** 2.4 * 65535 for c in COLOUR]
    assert colour["normalized"] and np.abs(np.median(values[:, :3], axis=0) - expected).max() < 600  # a step of 8 bits
    assert "KHR_materials_unlit" in document["materials"][0]["extensions"]
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"])


def test_components_are_kept_as_asked(folder: str, tmp_path: Path) -> None:
    counts = {}
    for keep in ("all", "largest", "0.2", "0.0001"):
        assert run(folder, tmp_path / "mesh.ply", "--keep", keep, "--smooth", "0") == 0
        counts[keep] = trimesh.load(tmp_path / "mesh.ply", process=False).body_count
    assert counts == {"all": 2, "largest": 1, "0.2": 1, "0.0001": 2}


def test_fewer_triangles_stay_on_the_ball(ball: Pack) -> None:
    surface = extract(Field(ball), 0.5)
    few = decimated(surface, len(surface.faces) // 8)
    assert len(surface.faces) // 40 < len(few.faces) <= len(surface.faces) // 8
    of_ball = few.vertices[few.faces[components(few) == np.bincount(components(few)).argmax()]]
    assert np.abs(radii(of_ball) - RADIUS).max() < VOXEL  # quadrics keep clusters of several voxels on the surface


def radii(vertices: np.ndarray) -> np.ndarray:
    """The distances from CENTRE of vertices in voxels."""
    return np.linalg.norm(vertices * VOXEL - 1 - CENTRE, axis=-1)


def test_smoothing_takes_steps_away_and_leaves_the_size() -> None:
    hard = np.where(ball_inside() > 0, 1.0, -1.0)
    surface = extract(Field(solid_pack(hard, COLOUR)), 0.5)
    before, after = radii(surface.vertices), radii(smoothed(surface, 10).vertices)
    assert after.std() < 0.7 * before.std() and abs(after.mean() - before.mean()) < 0.1 * VOXEL


def test_points_lie_on_the_surface_as_densely_as_asked_with_normals_and_colours(folder: str, tmp_path: Path) -> None:
    counts = []
    for spacing in ("1", "2"):
        assert run(folder, tmp_path / "points.ply", "--spacing", spacing, "--keep", "largest", "--level", "0.5") == 0
        cloud = trimesh.load(tmp_path / "points.ply")
        counts.append(len(cloud.vertices))
        raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
        normals = np.stack([raw[name] for name in ("nx", "ny", "nz")], axis=1)
        out = cloud.vertices - CENTRE
        assert np.abs(np.linalg.norm(out, axis=1) - RADIUS).max() < 0.6 * VOXEL
        assert np.sum(normals * out, axis=1).min() > 0.9 * RADIUS
        assert np.abs(np.asarray(cloud.colors)[:, :3].astype(int) - COLOUR).max() <= 2
    assert counts[0] == pytest.approx(4 * np.pi * (RADIUS / VOXEL) ** 2, rel=0.1)
    assert counts[0] == pytest.approx(4 * counts[1], rel=0.02)


def test_gaussians_have_the_layout_of_splat_viewers_and_let_as_much_light_pass(folder, ball, tmp_path):
    assert run(folder, tmp_path / "gaussians.ply") == 0
    header = (tmp_path / "gaussians.ply").read_bytes().partition(b"end_header\n")[0]
    assert header.decode().split("property float ")[1:] == [f"{name}\n" for name, _ in COLUMNS]
    values = gaussians_of(tmp_path / "gaussians.ply")
    assert len(values) > 3000 and np.abs(np.median(values[:, :3], axis=0) - CENTRE).max() < VOXEL
    assert np.allclose(values[:, AT["rot_0"] :], [1, 0, 0, 0])
    assert np.allclose(np.exp(values[:, AT["scale_0"]]), 0.5 * VOXEL)
    colour = 255 * (0.5 + 0.28209479 * values[:, AT["f_dc_0"] : AT["f_dc_0"] + 3])
    assert np.abs(np.median(colour, axis=0) - COLOUR).max() < 1.5
    passed, own = opacity_table()
    assert np.all(np.diff(passed) > 0) and passed[-1] > 0.9 and own[0] == passed[0] == 0


@pytest.mark.parametrize("words", [[], ["--frame", "world", "--scale", "30"]])
def test_an_spz_holds_the_gaussians_of_the_ply_as_exactly_as_the_format_allows(folder, tmp_path, words):
    for name in ("gaussians.ply", "a.spz"):
        assert run(folder, tmp_path / name, *words) == 0
    values = gaussians_of(tmp_path / "gaussians.ply")
    read = gsply.read_spz(tmp_path / "a.spz")
    assert (len(read.means) == len(values) and read.shN is None) or not np.size(read.shN)
    assert np.abs(read.means - values[:, :3]).max() < 1e-5 * np.abs(values[:, :3]).max()
    assert np.abs(0.28209479 * (read.sh0 - values[:, 6:9])).max() < 1.0 / 255
    assert np.abs(1 / (1 + np.exp(-read.opacities)) - 1 / (1 + np.exp(-values[:, 9]))).max() < 0.51 / 255
    assert np.abs(read.scales - values[:, 10:13]).max() < 0.51 / 16
    assert np.abs(np.sum(read.quats * values[:, 13:], axis=1)).min() > 0.9999  # the same rotation
    assert (tmp_path / "a.spz").stat().st_size < (tmp_path / "gaussians.ply").stat().st_size / 8


def test_frames_scale_and_crop(folder: str, tmp_path: Path) -> None:
    words = ["--level", "0.5", "--keep", "largest"]
    assert run(folder, tmp_path / "mesh.ply", *words, "--frame", "world", "--scale", "2") == 0
    mesh = trimesh.load(tmp_path / "mesh.ply", process=False)
    centre = 2 * BLENDER_FRAME[:3, :3] @ CENTRE
    assert np.abs(mesh.bounds.mean(axis=0) - centre).max() < VOXEL and mesh.volume > 0
    assert run(folder, tmp_path / "mesh.ply", *words, "--crop", "0.1,-1,-1,1,1,1") == 0
    half = trimesh.load(tmp_path / "mesh.ply", process=False)
    assert half.bounds[0, 0] > 0.1 - VOXEL and half.is_watertight
    assert half.volume == pytest.approx(mesh.volume / 8 / 2, rel=0.1)


@pytest.mark.parametrize("ndc", [False, True])
@pytest.mark.parametrize("frame", ["grid", "world"])
def test_a_glb_has_the_photographs_cameras_which_see_a_point_where_the_viewer_does(tmp_path, frame, ndc):
    pose = ViewCamera.look_at((2.0, 3.0, 5.0), (0.3, -0.2, -1.0), (0.1, 1.0, 0.2)).grid_T_camera
    lens = {"width": 64, "height": 48, "fx": 70.0, "fy": 75.0, "cx": 32.0, "cy": 24.0}
    entry = {"name": "train/r_7", "split": "train", "world_T_camera": pose.tolist(), **lens}
    fisheye = {**entry, "name": "fisheye", "distortion": [0.0] * 11 + [1.0]}
    given = {"ndc": True, "input_width": 160.0, "input_height": 120.0, "input_focal": 140.0} if ndc else {}
    pack = solid_pack(ball_inside(), COLOUR, NDC_FRAME if ndc else BLENDER_FRAME, **given)
    pack = pack.with_metadata(cameras=[fisheye, entry], near=0.25)
    export_scene(pack, tmp_path / "mesh.glb", Export("mesh", frame=frame, scale=2.0))
    document, _ = parts_of_glb(tmp_path / "mesh.glb")
    (camera,) = document["cameras"]
    node = document["nodes"][document["scenes"][0]["nodes"][1]]
    assert camera["type"] == "perspective" and node["name"] == "train/r_7" and node["camera"] == 0
    assert camera["perspective"]["znear"] == pytest.approx(0.5)
    frame_T_camera = np.reshape(node["matrix"], (4, 4)).T
    assert np.allclose(frame_T_camera[:3, :3].T @ frame_T_camera[:3, :3], np.eye(3))
    assert np.linalg.det(frame_T_camera[:3, :3]) > 0

    point = np.array([0.1, -0.4, -0.8, 1.0])  # of the grid frame
    view = shots_of(pack)[1].view
    x, y, z, _ = np.linalg.inv(view.grid_T_camera) @ point
    expected = np.array([view.cx - view.fx * x / z, view.cy + view.fy * y / z])
    there = (pack.worldspace_T_opengl if frame == "world" else np.eye(4)) @ point
    x, y, z, _ = np.linalg.inv(frame_T_camera) @ [*(2.0 * there[:3]), 1.0]
    high = np.tan(0.5 * camera["perspective"]["yfov"])
    across, up = x / -z / (high * camera["perspective"]["aspectRatio"]), y / -z / high  # -1 ... 1
    if ndc and frame == "grid":
        across = -across  # this frame is a mirror image of the scene
    assert np.allclose([32.0 * (1.0 + across), 24.0 * (1.0 - up)], expected)
    assert 0 < expected[0] < 64 and 0 < expected[1] < 48 and abs(across) > 0.05


@pytest.mark.parametrize("frame", ["grid", "world"])
def test_forward_facing_packs_are_unwarped(tmp_path: Path, frame: str) -> None:
    (n, d), pack = PLANE, plane_pack(SIDE, COLOUR)
    export_scene(pack, tmp_path / "mesh.ply", Export("mesh", level=0.5, keep="largest", frame=frame, smooth=0))  # type: ignore[arg-type]
    mesh = trimesh.load(tmp_path / "mesh.ply", process=False)
    points, normals = mesh.vertices, mesh.vertex_normals
    if frame == "grid":
        points, normals = points @ NDC_FRAME[:3, :3].T, normals @ NDC_FRAME[:3, :3].T
    off = (points @ n - d) / np.linalg.norm(n)
    front = np.abs(off) < 0.15
    assert front.mean() > 0.2  # the other faces close the box behind
    assert np.median(normals[front] @ n / np.linalg.norm(n)) > 0.97


def test_a_contracted_pack_is_written_as_it_is_in_space(tmp_path: Path) -> None:
    folder = str(written(tmp_path / "pack", surroundings_pack(112, radius=2.0)))
    for name in ("mesh.ply", "points.ply", "gaussians.ply"):
        assert run(folder, tmp_path / name, "--keep", "all") == 0
    mesh = trimesh.load(tmp_path / "mesh.ply", process=False)
    assert len(mesh.faces) > 1000 and np.abs(mesh.bounds).max() <= 2.0 + 0.1
    centre, radius = 2.0 * np.array(BALL[:3]), 2.0 * BALL[3]
    cloud = trimesh.load(tmp_path / "points.ply", process=False)
    off = np.linalg.norm(cloud.vertices - centre, axis=1)
    near = off < 1.3 * radius
    assert near.sum() > 300 and np.abs(cloud.vertices).max() > 0.5 * 2.0 * SKY
    assert np.median(np.abs(off[near & (off > 0.7 * radius)] - radius)) < 0.1 * radius
    values = gaussians_of(tmp_path / "gaussians.ply")
    far = np.abs(values[:, :3]).max(axis=1) / 2.0
    sizes = np.exp(values[:, AT["scale_0"] : AT["scale_0"] + 3])
    inner = far < 0.99
    assert np.allclose(sizes[inner], sizes[inner][0]) and inner.sum() > 1000
    beyond = far > 1.01
    assert np.allclose(sizes[beyond].max(axis=1) / sizes[inner][0, 0], far[beyond] ** 2, rtol=1e-3)


@pytest.fixture(scope="module")
def alone() -> Pack:
    return solid_pack(ball_inside(), COLOUR)


@pytest.mark.parametrize("kind", KINDS)
def test_a_preview_of_the_same_voxels_is_what_is_written(alone: Pack, tmp_path: Path, kind) -> None:
    export = Export(kind, faces=2000)
    drawn, file = preview_geometry(alone, export), tmp_path / "it.ply"
    written = export_scene(alone, file, export)
    assert (len(drawn.vertices), len(drawn.faces), drawn.coarser) == (written.points, written.faces, 1)
    opened = trimesh.load(file, process=False)
    assert np.allclose(opened.vertices, drawn.vertices, atol=1e-6)
    if kind != "gaussians":
        colours = opened.visual.vertex_colors if kind == "mesh" else opened.colors
        assert np.array_equal(np.asarray(colours)[:, :3], drawn.colours)


@pytest.mark.parametrize("kind", KINDS)
def test_coarser_voxels_make_fewer_of_it_in_the_same_place(alone: Pack, kind, monkeypatch: pytest.MonkeyPatch) -> None:
    fine = preview_geometry(alone, Export(kind, faces=0))
    monkeypatch.setattr(scene, "MOST_CELLS", 21)
    coarse = preview_geometry(alone, Export(kind, faces=0))
    assert coarse.coarser == coarseness(alone) == 2 and len(coarse.vertices) < 0.5 * len(fine.vertices)
    away = np.linalg.norm(coarse.vertices - CENTRE, axis=1)
    if kind != "gaussians":
        assert np.abs(away - RADIUS).max() < 2 * VOXEL
        outward = (coarse.normals * (coarse.vertices - CENTRE)).sum(axis=1)
        assert (outward > 0).mean() > 0.99
    assert away.max() < RADIUS + 2 * VOXEL
