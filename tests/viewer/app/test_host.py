"""Features need a host, not the application: they work with one that has nothing but what viewer.app.host promises."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from tests.viewer.app.test_application import FakeStage
from viewer.app.comparison import Comparison
from viewer.app.filming import Filming
from viewer.app.forward_facing import rig_for
from viewer.app.log import Messages
from viewer.app.ray_costs import CostMeter
from viewer.app.state import OpenScene, Viewport
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.rendering.settings import RenderSettings


class Stage(FakeStage):
    def ray_counts(self, camera, settings):
        return np.ones((camera.height, camera.width, 3), np.float32)


@dataclass
class LoneHost:
    scene: OpenScene
    stage: Stage = field(default_factory=Stage)
    settings: RenderSettings = field(default_factory=RenderSettings)
    resolution: DynamicResolution = field(default_factory=DynamicResolution)
    viewport: Viewport = field(default_factory=lambda: Viewport(width=64, height=48))
    messages: Messages = field(default_factory=Messages)
    touched: int = 0

    def touch(self, frames=3):
        self.touched += 1

    def camera(self):
        return self.scene.rig.camera(self.viewport.pixels)

    @property
    def fov(self):
        return self.scene.rig.fov


@pytest.fixture
def host(pack, pack_folder) -> LoneHost:
    return LoneHost(OpenScene(pack_folder, "toy", pack, rig_for(pack)))


def test_the_film_is_made_and_written(host, tmp_path):
    filming = Filming(size=(32, 24), fps=2.0)
    filming.add(host)
    assert host.messages.toast == "Keyframe 1 of 1"
    filming.turntable(host)
    filming.film(host, tmp_path / "frames")
    while filming.export is not None:
        filming.tick(host, 0.1)
    assert len(list((tmp_path / "frames").iterdir())) == 16 and host.messages.toast.startswith("Saved")
    filming.play(host)
    filming.tick(host, 1.0)
    assert filming.playing and host.scene.rig.held is not None


def test_the_picture_is_compared_with_a_photograph_for_as_long_as_its_camera_is_held(host):
    comparison = Comparison()
    comparison.with_photograph(np.full((48, 64, 3), 40, np.uint8))
    host.scene.rig.hold(host.camera())
    comparison.tick(host, 0.1)
    comparison.measure(host)
    assert comparison.sides(host) == ("Rendered", "Photograph") and comparison.psnr_db == float("inf")
    host.scene.rig.orbit(0.1, 0.0)
    comparison.tick(host, 0.1)
    assert comparison.sides(host) is None and comparison.psnr_db is None


def test_rays_are_counted(host):
    costs = CostMeter()
    costs.switch(True)
    costs.measure(host)
    assert costs.costs is not None and costs.costs.samples_mean == 1.0 and host.touched == 1
