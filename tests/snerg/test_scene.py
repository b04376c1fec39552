"""snerg.Scene and snerg.show: pictures are those of the renderer, geometry and files those of the commands; in a notebook's cell
stands the page, or a picture where the page is refused.
"""

import copy
import os
import pickle
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import moderngl
import numpy as np
import pytest

import snerg
from console import UserError
from scenepack import load_pack, save_pack
from tests.scenepack.helpers import written
from tests.stand_ins import raising
from tests.viewer.conftest import toy_pack
from tests.viewer.scenes import with_cameras
from viewer.features.photographs.photographs import shots_of
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer, create_context
from viewer.rendering.opengl import current_context

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: the extra dev")
SIZE = (48, 36)
EYE, TARGET = (1.4, 0.9, 2.2), (0.0, -0.2, 0.0)


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small pack on disk with the camera of one photograph."""
    view = ViewCamera.look_at((0.1, 0.2, 4.0), TARGET, size=(40, 30))
    view = replace(view, fx=50.0, fy=52.0, cx=19.0, cy=16.0, distortion=(0.05, 0.0, 0.0, 0.0))
    pack = with_cameras(toy_pack(), [view]).with_metadata(provenance={"scene": "nowhere"})
    return written(tmp_path_factory.mktemp("toy") / "toy.zip", pack)


@pytest.fixture(scope="module")
def camera() -> snerg.Camera:
    return snerg.Camera.look_at(EYE, TARGET, size=SIZE)


def test_a_picture_is_that_of_the_renderer(toy: Path, camera: snerg.Camera) -> None:
    with snerg.load(toy) as scene, OffscreenRenderer(load_pack(toy)) as renderer:
        expected = renderer.render(ViewCamera.look_at(EYE, TARGET, size=SIZE))
        np.testing.assert_array_equal(scene.render(camera), expected)
        shot = shots_of(renderer.pack)[0]
        np.testing.assert_array_equal(scene.render(scene.cameras[0]), renderer.render(shot.view))
    assert expected.std() > 20


def test_every_mode_gives_numbers_that_agree(toy: Path, camera: snerg.Camera) -> None:
    with snerg.load(toy) as scene:
        modes = ("alpha", "depth", "normals", "features")
        alpha, depth, normals, features = (scene.render(camera, mode=mode) for mode in modes)
        rgba, double = scene.render(camera, background=None), scene.render(camera, size=(96, 72), samples=2)
    height, width = SIZE[1], SIZE[0]
    assert alpha.shape == depth.shape == (height, width) and normals.shape == features.shape == (height, width, 3)
    assert rgba.shape == (height, width, 4) and double.shape == (2 * height, 2 * width, 3) and rgba.dtype == np.uint8
    seen, empty = alpha > 0.99, alpha == 0
    assert seen.sum() > 100 and empty.sum() > 100
    distance = np.linalg.norm(np.subtract(EYE, TARGET))
    assert (depth[empty] == 0).all() and (np.abs(depth[seen] - distance) < 1.5).all()
    np.testing.assert_allclose(np.linalg.norm(normals[seen], axis=-1), 1.0, atol=1e-5)
    assert (rgba[seen][:, 3] >= 252).all() and (rgba[empty][:, 3] == 0).all() and features[seen].min() > 0


def test_scenes_that_are_open_at_once_do_not_disturb_one_another(toy, camera, tmp_path):
    save_pack(toy_pack(view_mlp=False), tmp_path / "other.zip")
    with snerg.load(toy) as one:
        alone = one.render(camera)
        with snerg.load(tmp_path / "other.zip") as other:
            assert (other.render(camera) != alone).any()
            np.testing.assert_array_equal(one.render(camera), alone)
        np.testing.assert_array_equal(one.render(camera), alone)


def test_a_given_context_draws_and_stays_as_it_was(toy: Path, camera: snerg.Camera) -> None:
    mine = create_context()
    framebuffer = mine.simple_framebuffer((2, 2))
    with snerg.load(toy, context=mine) as given, snerg.load(toy) as own:
        np.testing.assert_array_equal(given.render(camera), own.render(camera))
        framebuffer.clear(1.0, 0.0, 0.0)  # would be drawn into another's, were that current
        assert framebuffer.read()[:3] == b"\xff\x00\x00" and mine.error == "GL_NO_ERROR"
    assert isinstance(mine, moderngl.Context) and mine.error == "GL_NO_ERROR"
    current_context()()
    mine.release()
    with pytest.raises(snerg.SnergError, match="is no OpenGL context"):
        snerg.load(toy, context="egl")


def test_another_thread_is_refused_and_not_let_into_the_context(toy: Path, camera: snerg.Camera) -> None:
    refused: list[str] = []

    def render() -> None:
        try:
            scene.render(camera)
        except snerg.SnergError as error:
            refused.append(error.what)

    with snerg.load(toy) as scene:
        scene.render(camera)
        thread = threading.Thread(target=render)
        thread.start()
        thread.join()
    assert refused == ["is rendered by another thread"]


@pytest.mark.parametrize(
    ("method", "arguments", "where"),
    [
        ("render", {"camera": np.eye(4)}, "camera"),
        ("render", {"size": 48}, "size"),
        ("render", {"mode": "rgb"}, "mode"),
        *(("render", {"samples": samples}, "samples") for samples in (2.5, 0)),
        *(("render", {"background": colour}, "background") for colour in ((255, 255, 255), 0, "white", (0, 0, 0, 1))),
        *(("orbit", {"frames": frames}, "frames") for frames in (0, 2.5, "3")),
        *(("orbit", {"frames": 3, "fov": fov}, "fov") for fov in ("wide", 0)),
        ("to_mesh", {"frame": "worlds"}, "frame"),  # named as an argument, not as an option
        ("to_mesh", {"level": 2.0}, "level"),
    ],
)
def test_what_a_scene_cannot_give_is_refused_by_its_argument(
    toy: Path, method: str, arguments: dict, where: str
) -> None:
    with pytest.raises(snerg.SnergError) as refused:
        getattr(snerg.load(toy), method)(**arguments)
    assert refused.value.where == where and "\n" not in str(refused.value)


def test_a_size_that_the_driver_refuses_does_not_spoil_the_next_picture(toy: Path, camera: snerg.Camera) -> None:
    with snerg.load(toy) as scene:
        expected = scene.render(camera, background=np.zeros(3))  # type: ignore[arg-type]
        for side in (100_000, 1_000_000_000):
            with pytest.raises(snerg.SnergError, match="refuses a picture of this size"):
                scene.render(camera, size=(side, side))
        np.testing.assert_array_equal(scene.render(camera, background=(0.0, 0.0, 0.0)), expected)


def test_a_copy_renders_on_its_own(toy: Path, camera: snerg.Camera) -> None:
    with snerg.load(toy) as scene:
        expected = scene.render(camera)
        for again in (copy.copy(scene), pickle.loads(pickle.dumps(scene))):
            np.testing.assert_array_equal(again.render(camera), expected)
            again.close()
        np.testing.assert_array_equal(scene.render(camera), expected)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_process_is_refused_in_words(toy: Path, camera: snerg.Camera) -> None:
    program = f"""
import os, snerg
scene = snerg.load({str(toy)!r})
scene.render(size=(8, 8))
if not os.fork():
    for one in (scene, snerg.load({str(toy)!r})):
        try:
            one.render(size=(8, 8))
        except snerg.SnergError as error:
            print(error.remedy, flush=True)
    scene.close()
    os._exit(0)
os.wait()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=100, check=True)
    assert done.stdout.count("spawn") == 2


def test_a_forward_facing_scene_comes_out_the_right_way_round(tmp_path: Path) -> None:
    pack = toy_pack(ndc=True)
    save_pack(pack, tmp_path / "ndc.zip")
    eye, target = (0.05, 0.1, 0.0), (0.0, 0.0, 4.0)
    with snerg.load(tmp_path / "ndc.zip") as scene, OffscreenRenderer(pack) as renderer:
        picture = scene.render(snerg.Camera.look_at(eye, target, size=SIZE, fov=60.0))
        mirrored = ViewCamera.look_at(eye, target, fov_degrees=60.0, size=SIZE, mirrored=True)
        np.testing.assert_array_equal(picture, renderer.render(mirrored))
        assert scene.metadata["forward_facing"] and len(scene.orbit(3, size=SIZE)) == 3
    assert picture.std() > 5


def test_geometry_is_written_as_the_commands_write_it(toy: Path, tmp_path: Path) -> None:
    scene = snerg.load(toy)
    mesh, points = scene.to_mesh(faces=2000), scene.to_points(spacing=2.0)
    assert 500 < len(mesh.faces) <= 2600 and len(mesh.vertices) == len(mesh.colours) == len(mesh.normals)
    assert len(points.faces) == 0 and len(points.vertices) > 200
    mesh.save(tmp_path / "mesh.glb")
    points.save(tmp_path / "points.ply")
    read = trimesh.load(tmp_path / "mesh.glb", force="mesh")
    np.testing.assert_allclose(read.bounds, [mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], atol=1e-6)
    assert len(trimesh.load(tmp_path / "points.ply").vertices) == len(points.vertices)
    with pytest.raises(snerg.SnergError, match=r"expected \.ply"):
        points.save(tmp_path / "points.glb")


def test_a_scene_is_saved_as_a_pack_and_as_a_page(toy: Path, tmp_path: Path) -> None:
    scene = snerg.load(toy)
    scene.save(tmp_path / "again", codec="webp")
    again = snerg.load(tmp_path / "again")
    assert again.metadata == scene.metadata | {"codec": "webp"} and len(again.cameras) == 1
    scene.save(tmp_path / "page.html", title="A <toy>")
    page = (tmp_path / "page.html").read_text(encoding="utf-16")
    assert page.startswith("<!") and "A &lt;toy&gt;" in page
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("do not lose this")
    with pytest.raises(snerg.SnergError, match="choose a new or empty folder"):
        scene.save(tmp_path / "mine")
    with pytest.raises(snerg.SnergError, match=r"to_mesh\(\)"):
        scene.save(tmp_path / "mesh.glb")


def test_what_is_no_pack_is_refused_with_the_fields_of_the_commands(tmp_path: Path) -> None:
    with pytest.raises(snerg.SnergError) as refused:
        snerg.load(tmp_path / "none")
    assert refused.value.what and refused.value.where is not None and str(refused.value.where) in str(refused.value)


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """What a notebook's cell shows, in a notebook that is made up."""
    shown: list[object] = []
    ipython, display = ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: SimpleNamespace(config={"IPKernelApp": {}})  # type: ignore[attr-defined]
    display.display, display.HTML = shown.append, lambda text: ("html", text)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    return shown


def test_a_cell_shows_the_page_in_a_frame(toy: Path, cell: list) -> None:
    snerg.show(snerg.load(toy), size=(320, 200))
    ((kind, text),) = cell
    assert kind == "html" and text.startswith("<iframe srcdoc=") and 'width="320" height="200"' in text
    assert "<script" not in text  # it is text of an attribute


def test_a_cell_shows_a_picture_where_there_can_be_no_page(toy, cell, monkeypatch):
    monkeypatch.setattr("viewer.web.page.scene_page", raising(UserError("the pack is too large for a web page")))
    with snerg.load(toy) as scene:
        snerg.show(scene, size=(64, 40))
    assert [picture.size for picture in cell] == [(64, 40)]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems always have a display")
def test_without_a_display_it_says_what_to_do(toy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(snerg.SnergError, match=r"scene\.render\(\)"):
        snerg.show(snerg.load(toy))
