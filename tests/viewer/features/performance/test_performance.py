"""What the performance page tells: both clocks, what rays cost, and texture memory by use."""

import re

import numpy as np
import pytest
from imgui_bundle import imgui

from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.conftest import toy_pack
from viewer.app.application import App
from viewer.features.performance.frame_stats import AVERAGED, KEPT, LONGEST_SIDE, FrameStats, FrameSummary, RayCosts
from viewer.features.performance.panel import _top
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.opengl import GpuClock
from viewer.rendering.settings import RenderSettings
from viewer.rendering.software_rasteriser import is_software


class QueryContext:
    """A context of a card whose queries say that everything takes 5 ms."""

    def __init__(self):
        self.info = {"GL_RENDERER": "NVIDIA H100"}

    def query(self, time):
        assert time
        return self

    elapsed = 5_000_000

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def finish(self):
        pass


def test_timer_queries_are_used_on_cards_and_not_in_software(ctx):
    clock = GpuClock(QueryContext())
    assert not clock.reason
    gpu, wall = clock.time(lambda: None)
    assert gpu == 5.0 and wall < 5.0
    here = GpuClock(ctx)
    if is_software(ctx.info["GL_RENDERER"]):
        assert "software" in here.reason
        assert here.time(lambda: None)[0] is None


def test_costs_are_counted_over_the_rays_that_hit():
    counts = np.zeros((2, 4, 3), np.float32)
    counts[..., :2] = (9, 5)  # rays that fetched and jumped, and hit nothing
    counts[0, 0] = (10, 2, 1.0)
    counts[0, 1] = (30, 4, 0.5)
    costs = RayCosts.of(counts)
    assert (costs.samples_mean, costs.samples_max, costs.jumps_mean, costs.jumps_max) == (20.0, 30, 3.0, 4)
    assert costs.hit == 0.25 and costs.size == (4, 2)
    assert RayCosts.of(np.zeros((2, 2, 3), np.float32)).samples_max == 0


def test_exact_marching_fetches_far_fewer_samples_than_brute_for_the_same_opacity(pack):
    camera = ViewCamera.orbit(pack, 35, 28, size=(48, 40))
    with OffscreenRenderer(pack) as renderer:
        exact = renderer.render_float(camera, RenderSettings(counts=True))
        brute = renderer.render_float(camera, RenderSettings(marcher="brute", counts=True))
    np.testing.assert_allclose(exact[..., 2], brute[..., 2], atol=1e-3)  # the same opacity
    hit = exact[..., 2] > 0.5
    assert hit.any() and exact[..., 0][hit].min() >= 1
    assert exact[..., 0].sum() < 0.5 * brute[..., 0].sum()  # what skipping is for
    assert exact[..., 1].max() > 0 and brute[..., 1].max() == 0


class CountingCanvas(FakeCanvas):
    asked = 0

    def ray_counts(self, camera, settings):
        self.asked += 1
        assert settings.counts and max(camera.width, camera.height) == LONGEST_SIDE
        return np.ones((camera.height, camera.width, 3), np.float32)


@pytest.fixture
def counting(pack, pack_folder) -> App:
    app = App(canvas=CountingCanvas())
    app.show(pack, pack_folder)
    app.viewport.width, app.viewport.height = 640, 480
    return app


def test_rays_are_counted_once_a_view_and_not_at_all_when_off(counting):
    costs, canvas = counting.costs, counting.canvas
    costs.measure(counting)
    assert canvas.asked == 0 and costs.costs is None
    costs.switch(True)
    for _ in range(3):
        costs.measure(counting)
    assert canvas.asked == 1 and costs.costs.samples_mean == 1.0 and costs.costs.size == (192, 144)
    counting.scene.rig.orbit(0.2, 0.0)
    counting.scene.rig.shown = counting.scene.rig.goal
    costs.measure(counting)
    assert canvas.asked == 2
    costs.switch(False)
    costs.measure(counting)
    assert canvas.asked == 2 and costs.costs is None


def test_the_page_counts_while_the_camera_rests(offscreen, app, pack, pack_folder):
    ui = offscreen(app)
    app.show(pack, pack_folder)
    app.interface.page = "performance"
    app.costs.switch(True)
    ui.settle()
    assert app.costs.costs.samples_mean > 1 and 0 < app.costs.costs.hit < 1
    assert len(app.times.gpu_ms) == len(app.times.frame_ms) > 0
    assert set(ui.canvas.gpu_bytes_by_use) == {"Pack", "Pictures"}
    app.compare_with(toy_pack(seed=1), pack_folder)
    ui.settle()
    assert ui.canvas.gpu_bytes_by_use["Other pack"] > 0 and ui.ctx.error == "GL_NO_ERROR"


def test_the_plots_scale_is_round_and_holds_target_and_frames():
    times = FrameStats()
    assert _top(times, 33.3) == 80
    for _ in range(50):
        times.add(3.0, 140.0)
    assert _top(times, 33.3) == 200
    times.add(1.0, 10.0, 0.5)
    assert np.isnan(times.gpu_ms[0]) and times.gpu_ms[-1] == 0.5


def test_the_rate_follows_from_the_time_that_is_shown_and_both_are_of_late():
    times = FrameStats()
    assert times.summary() == FrameSummary() and times.summary().fps == 0.0
    for _ in range(500):
        times.add(3.0, 60.0)
    for _ in range(AVERAGED):
        times.add(3.0, 20.0)
    summary = times.summary()
    assert (summary.mean, summary.fps, summary.median, summary.slowest) == (20.0, 50.0, 60.0, 60.0)
    assert len(times.frame_ms) < 500


def test_one_time_and_one_rate_are_shown_everywhere(offscreen, app, pack, pack_folder, monkeypatch):
    ui = offscreen(app)
    app.show(pack, pack_folder)
    ui.settle()
    app.times = FrameStats()
    for i in range(KEPT):
        app.times.add(3.0, 60.0 if i < KEPT - AVERAGED else 25.0 + i % 2)
    shown = []
    write = imgui.text_unformatted
    monkeypatch.setattr(imgui, "text_unformatted", lambda text: (shown.append(text), write(text))[1])
    for page in ("view", "performance"):
        shown.clear()
        app.interface.page = page
        ui.frame()
        rates = {word for text in shown for word in re.findall(r"(\d+) fps", text)}
        assert rates == {"39"} and len([text for text in shown if "fps" in text]) == 2  # the top bar's and the page's
        assert "25.5" in shown and (page == "view" or "25.5 ms" in shown)  # the headline and the plot's legend
