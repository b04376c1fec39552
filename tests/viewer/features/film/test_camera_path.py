"""Camera paths: the spline, nerfstudio's file, playback, stills and films."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from console import UserError
from tests.viewer.app.test_application import FakeCanvas
from viewer.app.application import App
from viewer.app.commands import run
from viewer.core.pose import Pose, Turntable
from viewer.features.film.camera_path import CameraPath, Keyframe, load_path, save_path
from viewer.features.film.film_export import films_possible

poses = st.builds(Pose, st.tuples(*[st.floats(-2, 2)] * 3), st.floats(-180, 180), st.floats(-80, 80), st.floats(0.5, 5))


def keyframes(some: list[Pose], mirrored: bool = False) -> list[Keyframe]:
    table = Turntable(mirrored=mirrored)
    return [Keyframe(pose.matrix(table), 40.0 + i, 1.0 + 0.5 * i) for i, pose in enumerate(some)]


@settings(max_examples=50)
@given(st.lists(poses, min_size=2, max_size=6), st.booleans(), st.booleans())
def test_a_path_passes_through_its_keyframes_and_stays_rigid(some, closed, mirrored):
    path = CameraPath(keyframes(some, mirrored), closed)
    for i, key in enumerate(path.keyframes):
        matrix, fov = path.at(path.start_of(i))
        np.testing.assert_allclose(matrix, key.grid_T_camera, atol=1e-6)
        assert fov == pytest.approx(key.fov)
    for share in np.linspace(0, 1, 9):
        R = path.at(share * path.duration)[0][:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-9)
        assert np.sign(np.linalg.det(R)) == (-1 if mirrored else 1)


def test_a_closed_path_ends_where_it_begins():
    path = CameraPath(keyframes([Pose(azimuth=a) for a in (0, 90, 180, 270)]), closed=True)
    np.testing.assert_allclose(path.at(path.duration)[0], path.at(0.0)[0], atol=1e-9)


@settings(max_examples=30)
@given(st.lists(poses, min_size=1, max_size=5), st.booleans())
def test_a_path_survives_nerfstudios_file(tmp_path_factory, some, closed):
    file = tmp_path_factory.mktemp("path") / "camera_path.json"
    frame = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    path = CameraPath(keyframes(some), closed)
    save_path(path, file, frame, (640, 360), 24)
    again = load_path(file, frame)
    assert again.closed == closed and len(again.keyframes) == len(some)
    for a, b in zip(path.keyframes, again.keyframes, strict=True):
        np.testing.assert_allclose(a.grid_T_camera, b.grid_T_camera, atol=1e-6)
        assert (a.fov, a.seconds) == pytest.approx((b.fov, b.seconds))
    document = json.loads(file.read_text())
    assert {"camera_type", "render_height", "render_width", "camera_path", "fps", "seconds"} <= set(document)
    first = np.array(document["camera_path"][0]["camera_to_world"]).reshape(4, 4)
    np.testing.assert_allclose(first, frame @ path.keyframes[0].grid_T_camera, atol=1e-6)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"keyframes": [{}]}', '{"keyframes": [{"matrix": [1, 2]}]}',
                                  '{"keyframes": [{"matrix": [0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0]}]}'])  # fmt: skip
def test_a_file_that_is_no_path_is_told_plainly(tmp_path, text):
    file = tmp_path / "bad.json"
    file.write_text(text)
    with pytest.raises(UserError, match="is not a camera path"):
        load_path(file, np.eye(4))


@pytest.fixture
def filming_app(pack, tmp_path):
    app = App(canvas=FakeCanvas())
    app.show(pack, tmp_path)
    app.filming.size = (96, 64)
    app.filming.fps = 4.0
    return app


def finish_export(app: App) -> None:
    for _ in range(1000):
        app.tick(0.01)
        if app.filming.export is None:
            return
    pytest.fail("the export does not end")


def test_keyframes_are_added_moved_changed_and_removed(filming_app):
    app, filming = filming_app, filming_app.filming
    for azimuth in (0, 60, 120):
        app.scene.rig.look_along(azimuth, 0)
        app.scene.rig.shown = app.scene.rig.goal
        run(app, "keyframe")
    assert filming.selected == 2 and len(filming.path.keyframes) == 3
    last = filming.path.keyframes[2]
    filming.move(2, -1)
    assert filming.path.keyframes[1] is last and filming.selected == 1
    app.scene.rig.look_along(200, 0)
    app.scene.rig.shown = app.scene.rig.goal
    filming.update(app, 0)
    np.testing.assert_allclose(filming.path.keyframes[0].grid_T_camera, app.scene.rig.matrix)
    filming.remove(1)
    assert len(filming.path.keyframes) == 2 and filming.selected == 1


def test_playing_moves_the_camera_and_stops_at_the_end(filming_app):
    app = filming_app
    run(app, "turntable")
    app.filming.path.closed = False
    run(app, "play")
    before = app.camera().grid_T_camera
    app.tick(1.5)
    assert not np.allclose(app.camera().grid_T_camera, before)
    app.tick(100)
    assert not app.filming.playing and app.filming.time == app.filming.path.duration


@pytest.mark.skipif(not films_possible(), reason="PyAV is not installed: pip install 'snerg[video]'")
def test_a_film_holds_every_frame(filming_app, tmp_path):
    import av

    run(filming_app, "turntable")
    filming_app.filming.film(filming_app, tmp_path / "film.mp4")
    finish_export(filming_app)
    with av.open(str(tmp_path / "film.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == 32


def test_a_cancelled_export_leaves_nothing(filming_app, tmp_path):
    app = filming_app
    for name in ("frames", *(["film.mp4"] if films_possible() else [])):
        run(app, "turntable")
        app.filming.film(app, tmp_path / "out" / name)
        app.filming.export.step(0.0)
        app.filming.cancel(app)
        assert app.filming.export is None and not list((tmp_path / "out").iterdir())
