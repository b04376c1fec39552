"""What is on the screen while something moves is one picture of one camera, and from there to rest nothing jumps."""

import itertools
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from imgui_bundle import imgui
from PIL import Image, ImageFilter

from tests.viewer.conftest import toy_pack
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.rendering.golden_variants import leave
from tests.viewer.rendering.pictures import FAILURES
from tests.viewer.waiting import at_once, not_none, until
from viewer.rendering import canvas as canvas_module
from viewer.rendering.canvas import BLEND_S, REST_S
from viewer.rendering.dynamic_resolution import DynamicResolution

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
    at_once(app.scene.rig.orbit, 0.02, 0.0)
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
        at_once(app.scene.rig.orbit, turn, 0.0)
        ui.frame()
        assert [layer.opacity for layer in ui.canvas.layers] == [1.0] and not ui.canvas.blending
        clock.now += REST_S
        ui.frame()
        assert len(ui.canvas.layers) > 1


SCALES = (0.3, 0.75, 0.45, 0.6, 0.35)
BLURRED = round(1 / min(SCALES)) + 2  # pixels, by the coarsest picture
CLEAR = 60  # differs from the background: sum over the channels
CHIP = (400, 60)  # at the upper left, where the picture is labelled
FRAMES = 16  # of each movement


class Wavering(DynamicResolution):
    """Chooses another scale for each frame, as a machine with other work to do makes the real one do."""

    scales = itertools.cycle(SCALES)
    now = SCALES[0]

    @property
    def moving_scale(self) -> float:
        return self.now

    def frame_ended(self, frame_ms: float, swap_ms: float = 0.0) -> None:
        self.now = next(self.scales)


@pytest.fixture
def moving(ui, app) -> OffscreenUi:
    app.resolution = Wavering()
    return ui


def shape(picture: np.ndarray, grown: int = 0) -> np.ndarray:
    """Where the object is, bool [h, w]; grown by so many pixels, or shrunk where that is negative."""
    mask = Image.fromarray((np.abs(picture.astype(int) - 255).sum(axis=2) > CLEAR).astype(np.uint8) * 255)
    share = np.asarray(mask.filter(ImageFilter.BoxBlur(abs(grown))))  # of the square around each pixel
    return share > 0 if grown >= 0 else share == 255


def hold_against_camera(ui: OffscreenUi, hidden: slice = slice(0)) -> None:
    """Fails where the screen shows another picture than that of the frame's camera; blurred edges are granted.

    hidden: columns that something else covers.
    """
    shown, expected = ui.scene_picture(), ui.canvas.snapshot(not_none(ui.app.viewport.camera), ui.app.settings)
    seen = shape(shown)
    missing, added = shape(expected, -BLURRED) & ~seen, seen & ~shape(expected, BLURRED)
    for wrong in (missing, added):
        wrong[: CHIP[1], : CHIP[0]] = wrong[:, hidden] = False
    if missing.any() or added.any():
        leave(FAILURES, "motion", shown, expected)
        message = f"{missing.sum()} pixels are missing, {added.sum()} are too many"
        pytest.fail(f"not the picture of the frame's camera: {message}; see {FAILURES}/motion-*.png")


def slide(ui: OffscreenUi, check: Callable[[], object], button: int = 1) -> None:
    """Drags to and fro by up to 0.45 of the picture, and checks what is on the screen after each frame."""
    box = ui.app.viewport
    x, y = 0.5 * box.width, box.y + 0.5 * box.height
    ui.io.add_mouse_pos_event(x, y)
    ui.frame()
    ui.io.add_mouse_button_event(button, True)
    for i in range(FRAMES):
        dx, dy = 0.45 * box.width * np.sin(0.35 * i), 0.315 * box.height * np.sin(0.2 * i)
        ui.io.add_mouse_pos_event(x + round(dx), y + round(dy))
        ui.frame()
        check()
    ui.io.add_mouse_button_event(button, False)
    ui.frame()


def test_it_is_one_picture_while_the_camera_slides_out_of_view_turns_and_flies(moving, app):
    for button in (1, 0):
        slide(moving, lambda: hold_against_camera(moving), button)
    moving.key(imgui.Key.v)
    app.messages.toast_until = 0.0  # which would lie over the picture
    moving.hold(imgui.Key.w)
    before = app.scene.rig.goal
    for _ in range(FRAMES):
        moving.frame()
        hold_against_camera(moving)
    assert app.scene.rig.flying and app.scene.rig.goal != before


@pytest.mark.slow
def test_a_window_that_is_resized_shows_one_picture_and_no_tiles_of_another(moving, app, monkeypatch):
    moving.canvas.rest_s = 0.0  # tiles begin at once, and are never all there
    monkeypatch.setattr(app.resolution, "tile_side", lambda: 120)
    tiled = 0
    for i in range(FRAMES):
        if i % 3 != 2:
            moving.resize(900 + round(200 * np.sin(0.7 * i)), 600 + round(150 * np.cos(0.5 * i)))
        for _ in range(3):
            moving.frame()
            hold_against_camera(moving)
            tiled += len(moving.canvas.layers) > 1
    assert tiled > FRAMES / 2


def test_two_packs_are_seen_through_one_camera_while_it_moves(moving, app):
    """A pack against itself: whatever differs is a picture of another camera, or of another sharpness."""
    app.comparison.with_pack(app, toy_pack(), app.scene.path)
    app.comparison.how = "difference"
    moving.settle()
    worst = []
    slide(moving, lambda: worst.append(moving.scene_picture().max()), button=0)
    assert max(worst) <= 24
    app.comparison.how, app.comparison.split = "wipe", 0.35
    edge = round(0.35 * app.viewport.width)
    slide(moving, lambda: hold_against_camera(moving, slice(edge - 20, edge + 20)))
