"""From the quick picture of a movement to the full one at rest: nothing jumps, and soon nothing is drawn any more."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.viewer.waiting import until
from viewer.rendering import canvas as canvas_module
from viewer.rendering.canvas import BLEND_S, REST_S

FRAME_S = 0.016


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The canvas's clock, which stands until it is moved."""
    clock = SimpleNamespace(now=100.0)
    clock.monotonic = lambda: clock.now
    monkeypatch.setattr(canvas_module, "time", clock)
    return clock


@pytest.fixture
def ui(offscreen, app, pack, pack_folder, clock):
    """The scene at rest, which from now on is drawn quickly where it moves."""
    ui = offscreen(app, size=(700, 500))
    app.interface.page, app.interface.axes_shown = "", False
    app.show(pack, pack_folder)
    until(lambda: ui.frame() or ui.canvas.layers)
    ui.settle()
    ui.canvas.rest_s, ui.canvas.blend_s = REST_S, BLEND_S
    app.resolution.scale = 0.25
    return ui


@pytest.mark.parametrize("side", [4096, 250])
def test_the_full_picture_fades_in_over_the_quick_one(ui, app, clock, monkeypatch, side):
    """side: of the tiles; one, as graphics cards have it, and several."""
    monkeypatch.setattr(type(app.resolution), "tile_side", lambda _: side)
    app.scene.rig.orbit(0.02, 0.0)
    app.scene.rig.shown = app.scene.rig.goal
    ui.frame()
    quick, shown = ui.scene_picture().astype(float), []
    assert len(ui.canvas.layers) == 1 and ui.canvas.pending
    clock.now += REST_S
    for _ in range(40):
        ui.frame()
        shown.append(ui.scene_picture().astype(float))
        clock.now += FRAME_S
        if not ui.canvas.pending:
            break
    expected = ui.canvas.snapshot(app.viewport.camera, app.settings).astype(float)
    away = expected - quick
    worst = np.abs(away).max()
    assert worst > 38 and np.abs(shown[-1] - expected).max() <= 4  # tiles round rays a little differently
    steps = np.diff([quick, *shown], axis=0)
    assert np.abs(steps).max() < 0.4 * worst + 4  # no jump anywhere
    assert (steps * np.sign(away) > -4).all()  # and no way back
    assert not ui.canvas.pending and not ui.canvas.blending and len(ui.canvas.layers) == 1
    tiles = 1 if side > 1000 else 6
    assert len(shown) <= tiles + 0.1 / FRAME_S + 1  # at most 100 ms behind the last tile


def test_a_movement_ends_the_fading_at_once(ui, app, clock) -> None:
    for turn in (0.02, -0.02):
        app.scene.rig.orbit(turn, 0.0)
        app.scene.rig.shown = app.scene.rig.goal
        ui.frame()
        assert [layer.opacity for layer in ui.canvas.layers] == [1.0] and not ui.canvas.blending
        clock.now += REST_S
        ui.frame()
        assert len(ui.canvas.layers) > 1
