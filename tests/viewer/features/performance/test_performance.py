"""What the performance page tells: both clocks, what rays cost, and texture memory by use."""

import numpy as np

from tests.viewer.conftest import toy_pack
from tests.viewer.waiting import not_none
from viewer.core import widgets
from viewer.features.performance.frame_stats import LONGEST_SIDE
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings


def test_exact_marching_fetches_far_fewer_samples_than_brute_for_the_same_opacity(pack):
    camera = ViewCamera.orbit(pack, 35, 28, size=(48, 40))
    with OffscreenRenderer(pack) as renderer:
        exact = renderer.render_float(camera, RenderSettings(mode="samples", raw=True))
        brute = renderer.render_float(camera, RenderSettings(mode="samples", marcher="brute", raw=True))
    np.testing.assert_allclose(exact[..., 2], brute[..., 2], atol=1e-3)  # the same opacity
    hit = exact[..., 2] > 0.5
    assert hit.any() and exact[..., 0][hit].min() >= 1
    assert exact[..., 0].sum() < 0.5 * brute[..., 0].sum()  # what skipping is for
    assert exact[..., 1].max() > 0 and brute[..., 1].max() == 0


def test_the_page_averages_over_no_more_frames_than_there_are(offscreen, app, pack, pack_folder, monkeypatch):
    app.interface.page = "performance"
    ui = offscreen(app, pack, pack_folder)
    hints: list[str] = []
    monkeypatch.setattr(widgets, "hint", lambda text, *_: hints.append(text))
    for count in (24, 40):
        app.times.frame_ms.clear()
        app.times.frame_ms.extend([9.0] * count)
        hints.clear()
        ui.frame()
        assert f"Of the last {count} frames; the figures above are of the last {min(count, 30)}." in hints


def test_the_page_counts_while_the_camera_rests_once_a_view_and_not_at_all_when_off(offscreen, app, pack, pack_folder):
    app.interface.page = "performance"
    ui = offscreen(app, pack, pack_folder)
    assert app.costs.costs is None
    app.costs.switch(True)
    ui.settle()
    counted = not_none(app.costs.costs)
    app.touch()
    ui.settle()
    assert app.costs.costs is counted and max(counted.size) == LONGEST_SIDE
    assert counted.samples.min() >= 1 and counted.samples.mean() > 1 and 0 < counted.hit < 1  # of rays that hit
    assert len(app.times.gpu_ms) == len(app.times.frame_ms) > 0
    assert set(ui.canvas.gpu_bytes_by_use) == {"Pack", "Pictures"}
    app.comparison.with_pack(app, toy_pack(seed=1), pack_folder)
    ui.settle()
    assert ui.canvas.gpu_bytes_by_use["Other pack"] > 0
    app.set(near=99.0)
    ui.settle()
    assert not_none(app.costs.costs).hit == 0
    app.costs.switch(False)
    ui.settle()
    assert app.costs.costs is None
