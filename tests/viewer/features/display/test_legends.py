"""What legends say about colours is what the picture shows."""

from dataclasses import replace

import numpy as np
import pytest

from tests.viewer.waiting import there
from viewer.features.display import panel as display_panel
from viewer.rendering.camera import rays_through


@pytest.fixture
def ui(known_pack, offscreen, app, pack_folder):
    return offscreen(app, known_pack, pack_folder, size=(900, 640))


def test_the_numbers_of_the_depths_are_distances(ui, app):
    app.set(mode="depth")
    legend = there(display_panel.legend_of(app))
    near, far = float(legend.low), float(legend.high)
    camera = app.camera()
    shades = ui.canvas.raw(camera, replace(app.settings, mode="depth"))[..., 0]
    opacity = ui.canvas.raw(camera, replace(app.settings, mode="alpha"))[..., 0]
    y, x = np.argwhere(opacity > 0.999)[::400].T
    rays = rays_through(camera, np.stack([x + 0.5, y + 0.5], axis=1))  # one unit deep
    distances = ui.canvas.depth(camera, app.settings)[y, x] * np.linalg.norm(rays, axis=1)
    by_legend = near + (1 - shades[y, x] / opacity[y, x]) * (far - near)  # white is near
    assert len(x) > 20 and np.abs(by_legend - distances).max() < 0.02
    assert float(legend.middle) == pytest.approx((near + far) / 2, abs=0.01) and "units" in legend.unit


@pytest.mark.parametrize("mode", ["samples", "jumps"])
def test_the_costs_have_a_scale_that_follows_the_slider(ui, app, mode):
    app.set(mode=mode, cost_scale=32.0)
    legend = there(display_panel.legend_of(app))
    assert (legend.low, legend.middle, legend.high) == ("0", "16", "≥ 32") and "ray" in legend.unit
    counted = ui.canvas.raw(app.camera(), replace(app.settings, mode="normal", counts=True))
    shown = ui.canvas.raw(app.camera(), app.settings)[..., :3]
    count = counted[..., 0 if mode == "samples" else 1]
    stops = np.array(legend.stops)
    x = np.clip(count / 32.0, 0, 1) * (len(stops) - 1)
    wanted = np.stack([np.interp(x, np.arange(len(stops)), stops[:, i]) for i in range(3)], axis=-1)
    assert count.max() > 3 and np.abs(shown - wanted).mean() < 2e-3
