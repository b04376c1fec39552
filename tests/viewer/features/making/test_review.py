"""The first look: points and cameras between poses and training, and what may be changed there."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenepack.blocks import dense_from_pack
from tests.training.reconstructions import ball, side_by_side, write_colmap
from tests.training.test_captures import circle
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.features.making.conftest import FAKE, ROOT
from tests.viewer.waiting import live, not_none, until
from training.scenes import load_scene
from training.scenes.colmap import sparse_points
from training.scenes.sources import Source
from viewer.app.application import App
from viewer.core.pose import project
from viewer.features.making import make_plan
from viewer.features.making import review as review_module
from viewer.features.making.make_plan import Plan
from viewer.features.making.review import Review, normal_at, read_sparse_preview


@pytest.fixture(scope="module")
def posed(tmp_path_factory) -> Path:
    return write_colmap(tmp_path_factory.mktemp("first") / "scene", circle(10), ball(radius=1.0))


def test_each_point_is_a_voxel_where_the_cameras_see_it(posed):
    sparse_preview = not_none(read_sparse_preview(posed))
    pack, points = sparse_preview.pack, not_none(sparse_points(sparse_preview.scene))
    assert len(points.places) == len(sparse_preview.points.places) == 150 and len(sparse_preview.eyes()) == 10
    grid_T_training = np.linalg.inv(pack.worldspace_T_opengl)
    places = points.places @ grid_T_training[:3, :3].T + grid_T_training[:3, 3]
    voxels = np.floor((places - pack.min_xyz) / pack.voxel_size).astype(int)
    filled = np.argwhere(dense_from_pack(pack)[0][..., 3] == 255)[:, ::-1]
    assert {tuple(voxel) for voxel in voxels} == {tuple(voxel) for voxel in filled}
    # The points lie in the frame of the cameras: about a ball's radius from what these look at, which is the origin.
    given = load_scene(posed, spherify=True).splits["train"][0].camera.world_T_camera
    local = (points.places - given[:3, 3]) @ given[:3, :3]
    assert (local[:, 2] < 0).all() and np.linalg.norm(points.places, axis=-1).max() < 1.0
    assert [entry["name"] for entry in pack.metadata["cameras"]]


@pytest.mark.parametrize(("poses", "kind"), [(circle, "subject"), (side_by_side, "forward")])
def test_the_kind_is_found_and_forward_facing_scenes_are_shown_as_seen_from_outside(poses, kind, tmp_path):
    sparse_preview = not_none(read_sparse_preview(write_colmap(tmp_path / "scene", poses(), ball())))
    assert sparse_preview.kind == kind and not sparse_preview.scene.ndc and not sparse_preview.pack.ndc
    assert not_none(read_sparse_preview(tmp_path / "scene", spherify=True)).kind in ("subject", "room")


def reviewed(posed: Path) -> tuple[App, Review]:
    app = App(canvas=FakeCanvas())
    app.making.sparse_preview = not_none(read_sparse_preview(posed))
    plan = Plan("scene", posed, posed.parent / "out", poses_only=True)
    app.making.review = review = Review(plan, app.making.sparse_preview)
    app.making.show_points(app)
    return app, review


def test_the_box_that_was_dragged_is_trained_and_faces_that_were_not_stay_the_readers(posed):
    app, review = reviewed(posed)
    given = not_none(review.sparse_preview.scene.aabb)
    assert app.gallery.frusta and app.open_scene.pack is review.sparse_preview.pack
    assert review.seconds_left is not None and review.decided(app.settings.crop).aabb is None
    review.show_box(app)
    assert review.seconds_left is None and review.decided(app.settings.crop).aabb is None  # seen, and left as it was
    (x0, y0, z0), (x1, y1, z1) = not_none(app.settings.crop)
    app.set(crop=((x0, y0, z0), (x1, 0.5 * y1, z1)))  # the grid's y is up, and so is the training frame's z
    plan = review.decided(app.settings.crop)
    expected = [*given[0], given[1, 0], given[1, 1], 0.5 * y1]
    assert np.allclose(not_none(plan.aabb), expected, atol=2e-3)
    words = plan.command()
    assert words[words.index("--aabb") + 1].count(",") == 5 and "--poses-only" not in words


def test_what_a_scene_is_taken_for_decides_its_box_and_its_frame(tmp_path):
    app, review = reviewed(write_colmap(tmp_path / "scene", side_by_side(), ball()))
    assert review.kinds == ("room", "forward") and review.kind == "forward"
    plain = review.decided(app.settings.crop)
    assert not plain.spherify and plain.aabb is None and app.settings.crop is None
    app.making.choose_kind(app, "room")
    plan = review.decided(app.settings.crop)
    assert plan.spherify and app.settings.crop is not None and review.seconds_left is None
    app.making.choose_kind(app, "forward")
    assert app.settings.crop is None and not review.decided(app.settings.crop).spherify


@pytest.fixture
def bare(monkeypatch, tmp_path) -> Iterator[App]:
    """An app that finds the poses of bare photographs: a stand-in has them at once, and trains for as long as it is let."""
    photographs = tmp_path / "shed"
    write_colmap(tmp_path / "out" / "scene", circle(10), ball())
    (photographs).mkdir()

    def command(plan: Plan) -> list[str]:
        return [sys.executable, "-c", ""] if plan.poses_only else [sys.executable, str(FAKE), "wait", str(tmp_path)]

    monkeypatch.setattr(Plan, "command", command)
    monkeypatch.setattr(Plan, "bare", property(lambda plan: Source("photographs", photographs, ())))
    monkeypatch.setattr(make_plan, "poser_missing", lambda source: None)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    app = App(canvas=FakeCanvas())
    app.making.plan = Plan("scene", photographs, tmp_path / "out")
    app.making.start(app)
    yield app
    app.making.end()


def test_the_points_are_shown_and_training_begins_by_itself_after_a_while(bare):
    assert bare.making.job.plan.poses_only
    live(bare, lambda: bare.making.review is not None)
    assert not bare.making.job and bare.making.busy and bare.making.sparse_preview_shown(bare)
    assert bare.scene.name == "shed: camera poses" and not bare.preferences.recent_packs()
    bare.drop([bare.making.review.plan.out / "scene"])  # one scene at a time
    assert "One scene at a time" in bare.messages.dialogs[0].title and bare.making.plan is None
    bare.making.review.until = 0.0
    live(bare, lambda: bare.making.job is not None)
    assert not bare.making.job.plan.poses_only and bare.making.review is None and bare.making.sparse_preview_shown(bare)


@pytest.mark.parametrize("trained", [True, False])
def test_who_touches_something_decides_when_training_begins_and_of_which_box(bare, monkeypatch, trained):
    monkeypatch.setattr(review_module, "WAIT_S", 0.0)
    live(bare, lambda: bare.making.review is not None)
    review = bare.making.review
    assert review.seconds_left == 0
    review.show_box(bare)
    for _ in range(3):
        bare.tick(0.1)
    assert bare.making.review is review and not bare.making.job
    low, (x1, y1, z1) = bare.settings.crop
    bare.set(crop=(low, (x1, 0.5 * y1, z1)))
    bare.making.train(bare) if trained else bare.making.leave(bare)
    assert bare.making.review is None and bare.making.busy == trained and bare.settings.crop is None
    if trained:
        assert bare.making.job.plan.aabb[5] == pytest.approx(0.5 * y1, abs=2e-3)
        assert bare.making.sparse_preview_shown(bare)  # while the field trains


def tilted_ground() -> np.ndarray:
    """Points [M, 3] on a plane that leans against the cameras' up, about what they look at; some stand above it."""
    rng = np.random.default_rng(3)
    flat = np.concatenate([rng.uniform(-0.8, 0.8, (300, 2)), np.zeros((300, 1))], 1)
    flat[::12, 2] = rng.uniform(0.1, 0.4, 25)
    lean = np.radians(25)
    turn = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
    return flat @ turn.T + [1.0, -2.0, 0.5]


def test_a_click_on_the_ground_makes_it_level(offscreen, tmp_path):
    app, review = reviewed(write_colmap(tmp_path / "scene", circle(10), tilted_ground()))
    review.plan.out = tmp_path / "out"
    ui = offscreen(app, size=(900, 800))
    ui.settle()

    def leaning() -> float:
        """Degrees between the ground and what is level."""
        shown = not_none(app.making.sparse_preview)
        places = shown.points.places
        normal = not_none(normal_at(places, int(np.argmin(np.linalg.norm(places, axis=-1))), shown.eyes()))
        return float(np.degrees(np.arccos(min(normal[2], 1.0))))

    assert leaning() > 15
    camera, places = not_none(app.camera()), review.sparse_preview.places_in_grid()
    pixels, _ = project(camera, places)
    free = (np.abs(pixels - [265, 330]) < [150, 100]).all(-1)  # what no card covers
    at = pixels[free][np.argmin(np.linalg.norm(pixels[free] - pixels[free].mean(0), axis=-1))]
    box = app.viewport
    ui.click(box.x + at[0], box.y + at[1])
    assert app.making.review is review, "clicks are the camera's and the photographs'"
    review.picking = True
    ui.click(box.x + 5, box.y + 5)
    assert app.making.review is review and "Click on points" in app.messages.toast and review.seconds_left is None
    ui.click(box.x + at[0], box.y + at[1])
    live(app, lambda: app.making.review is not None and app.making.review is not review)
    again = not_none(app.making.review)
    assert leaning() < 3 and app.making.sparse_preview_shown(app) and again.seconds_left is None
    words = again.decided(None).command()
    assert words[words.index("--up") + 1].count(",") == 2 and again.decided(None).aabb is None
    app.making.set_up(app, None)
    live(app, lambda: app.making.review is not None)
    assert leaning() > 15 and "--up" not in not_none(app.making.review).decided(None).command()


def test_photographs_without_a_pose_are_shown_before_training(bare, tmp_path, offscreen):
    """As training.posing writes it down, a portrait and a landscape photograph, and one that is gone, are left out."""
    folder, out = tmp_path / "shed", tmp_path / "out"
    sideways = Image.Exif()
    sideways[0x0112] = 6  # orientation: the camera was turned to the right
    Image.new("RGB", (400, 200), (200, 30, 30)).save(folder / "a.jpg", exif=sideways)
    Image.new("RGB", (400, 200), (30, 30, 200)).save(out / "kept.png")
    why = {"a.jpg": "matches no other", "walk.mp4 at 1.00 s": "blurred", "gone.jpg": "blurred"}
    said = {"photographs": str(folder), "left_out": why, "files": {"walk.mp4 at 1.00 s": str(out / "kept.png")}}
    (out / "scene" / "poses.json").write_text(json.dumps(said))
    live(bare, lambda: bare.making.review is not None)
    review = bare.making.review
    found = review.rejected
    until(lambda: found.finished)
    assert list(found.why) == ["a.jpg", "walk.mp4 at 1.00 s", "gone.jpg"] and list(found.boxes) == [0, 1]
    (_, _, width, height), landscape = found.boxes.values()
    assert width < height and landscape[2] > landscape[3], "as the camera was held"
    app = App(canvas=FakeCanvas())
    app.making.review = review
    review.hold()
    ui = offscreen(app, size=(900, 700))
    ui.settle()
    pixels = ui.picture().astype(int)
    red, blue = (np.abs(pixels - colour).max(-1) < 12 for colour in ((200, 30, 30), (30, 30, 200)))
    assert min(red.sum(), blue.sum()) > 300, "both are in the picture"
