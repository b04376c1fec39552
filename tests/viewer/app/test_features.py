"""Features of the viewer that need no window: films, comparisons and counts of rays."""

import numpy as np
import pytest

from tests.viewer.app.test_application import FakeCanvas
from viewer.app.application import App
from viewer.core.state import OpenScene, Viewport
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.comparison.comparison import Comparison
from viewer.features.film.filming import Filming
from viewer.features.performance.frame_stats import CostMeter


class CountingCanvas(FakeCanvas):
    def ray_counts(self, camera, settings):
        return np.ones((camera.height, camera.width, 3), np.float32)


@pytest.fixture
def app(pack, pack_folder) -> App:
    scene = OpenScene(pack_folder, "toy", pack, orbit_camera_for(pack))
    return App(canvas=CountingCanvas(), scene=scene, viewport=Viewport(width=64, height=48), frames_owed=0)


def test_the_film_is_made_and_written(app, tmp_path):
    filming = Filming(size=(32, 24), fps=2.0)
    filming.add(app)
    assert app.messages.toast == "Keyframe 1 of 1"
    filming.turntable(app)
    filming.film(app, tmp_path / "frames")
    while filming.export is not None:
        filming.tick(app, 0.1)
    assert len(list((tmp_path / "frames").iterdir())) == 16 and app.messages.toast.startswith("Saved")
    filming.play(app)
    filming.tick(app, 1.0)
    assert filming.playing and app.scene.rig.held is not None


def test_the_picture_is_compared_with_a_photograph_for_as_long_as_its_camera_is_held(app):
    comparison = Comparison()
    comparison.with_photograph(np.full((48, 64, 3), 40, np.uint8))
    app.scene.rig.hold(app.camera())
    comparison.tick(app, 0.1)
    comparison.measure(app)
    assert comparison.sides(app) == ("Rendered", "Photograph") and comparison.psnr_db == float("inf")
    app.scene.rig.orbit(0.1, 0.0)
    comparison.tick(app, 0.1)
    assert comparison.sides(app) is None and comparison.psnr_db is None


def test_rays_are_counted(app):
    costs = CostMeter()
    costs.switch(True)
    costs.measure(app)
    assert costs.costs is not None and costs.costs.samples_mean == 1.0 and app.wants_frame
