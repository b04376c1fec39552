"""What is on the screen while the camera moves, or the window is resized, is one picture of one camera.

The real mouse slides and turns, real keys fly, the real window changes size, and after each frame the screen is grabbed and
held against a full picture of the frame's camera: nothing of the object may be missing, and nothing may be where it is not.
Not collected by itself; see live_window.py.
"""

import ctypes
import ctypes.util
import itertools
from collections.abc import Callable

import glfw
import numpy as np
import pytest
from imgui_bundle import imgui
from PIL import Image, ImageFilter, ImageGrab

from tests.viewer.conftest import toy_pack
from tests.viewer.rendering.pictures import FAILURES
from tests.viewer.window.living import SIZE, pump, wait
from viewer.app.application import App
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.window.window import Window

SCALES = (0.3, 0.75, 0.45, 0.6, 0.35)
BLURRED = round(1 / min(SCALES)) + 2  # pixels, by the coarsest picture
CLEAR = 60  # differs from the background: sum over the channels
CHIP = (400, 60)  # at the upper left, where the picture is labelled
GRABS = 16  # of each movement
Check = Callable[[np.ndarray], object]


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
def window(opened, pack, pack_folder) -> Window:
    app = opened.app = App(canvas=opened.canvas)
    app.resolution = Wavering()
    app.interface.page, app.interface.axes_shown = "", False
    glfw.set_window_size(opened.handle, *SIZE)
    app.show(pack, pack_folder)
    pump(opened)
    return opened


@pytest.fixture
def grab(display, window) -> Callable[[], np.ndarray | None]:
    """The part of the screen where the window has its picture, int [h, w, 3]; None where the window is of another size by
    now than when the frame was drawn.
    """
    x11 = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
    x11.XSync.argtypes = [ctypes.c_void_p, ctypes.c_int]

    def take() -> np.ndarray | None:
        x11.XSync(glfw.get_x11_display(), 0)  # the frame is on the screen
        box, drawn = window.app.viewport, imgui.get_io().display_size
        x, y = (
            round(corner + place)
            for corner, place in zip(glfw.get_window_pos(window.handle), (box.x, box.y), strict=True)
        )
        screen = ImageGrab.grab((x, y, x + round(box.width), y + round(box.height)), xdisplay=display)
        if glfw.get_window_size(window.handle) != (drawn.x, drawn.y):
            return None
        return np.asarray(screen.convert("RGB")).astype(int)

    return take


def shape(picture: np.ndarray, grown: int = 0) -> np.ndarray:
    """Where the object is, bool [h, w]; grown by so many pixels, or shrunk where that is negative."""
    mask = Image.fromarray((np.abs(picture.astype(int) - 255).sum(axis=2) > CLEAR).astype(np.uint8) * 255)
    share = np.asarray(mask.filter(ImageFilter.BoxBlur(abs(grown))))  # of the square around each pixel
    return share > 0 if grown >= 0 else share == 255


def hold_against_camera(window: Window, shown: np.ndarray) -> None:
    """Fails where the screen shows another picture than that of the frame's camera; blurred edges are granted."""
    expected = window.canvas.snapshot(window.app.viewport.camera, window.app.settings)
    assert shown.shape == expected.shape
    seen = shape(shown)
    missing, added = shape(expected, -BLURRED) & ~seen, seen & ~shape(expected, BLURRED)
    for wrong in (missing, added):
        wrong[: CHIP[1], : CHIP[0]] = False
    if missing.any() or added.any():
        FAILURES.mkdir(exist_ok=True)
        for name, pixels in (("actual", shown), ("expected", expected), ("difference", np.abs(shown - expected))):
            Image.fromarray(pixels.astype(np.uint8)).save(FAILURES / f"motion-{name}.png")
        message = f"{missing.sum()} pixels are missing, {added.sum()} are too many"
        pytest.fail(f"not the picture of the frame's camera: {message}; see {FAILURES}/motion-*.png")


def slide(window: Window, xdotool, grab, check: Check, button: int = 3, far: float = 0.45) -> None:
    """Drags to and fro by up to `far` of the picture, and checks what is on the screen after each frame."""
    box = window.app.viewport
    x, y = round(0.5 * box.width), round(box.y + 0.5 * box.height)
    xdotool("mousemove", x, y, "mousedown", button)
    for i in range(GRABS):
        dx, dy = far * box.width * np.sin(0.35 * i), 0.7 * far * box.height * np.sin(0.2 * i)
        xdotool("mousemove", x + round(dx), y + round(dy))
        window.app.touch(1)
        window.step()
        shown = grab()
        assert shown is not None
        check(shown)
    xdotool("mouseup", button)
    window.step()


def test_it_is_one_picture_while_the_camera_slides_out_of_view_turns_and_flies(window, xdotool, grab):
    for button in (3, 1):
        slide(window, xdotool, grab, lambda shown: hold_against_camera(window, shown), button)
    xdotool("key", "v")
    wait(window, lambda: window.app.scene.rig.flying)
    window.app.messages.toast_until = 0.0  # which would lie over the picture
    xdotool("keydown", "w")
    for _ in range(GRABS):
        window.app.touch(1)
        window.step()
        hold_against_camera(window, grab())
    xdotool("keyup", "w")
    assert window.app.scene.rig.flying


def test_a_window_that_is_resized_shows_one_picture_and_no_tiles_of_another(window, xdotool, grab, monkeypatch):
    monkeypatch.setattr(window.canvas, "rest_s", 0.0)  # tiles begin at once, and are never all there
    monkeypatch.setattr(window.app.resolution, "tile_side", lambda: 120)
    checked, tiled = 0, 0
    for i in range(GRABS):
        width, height = 900 + round(200 * np.sin(0.7 * i)), 600 + round(150 * np.cos(0.5 * i))
        if i % 3 != 2:
            xdotool("search", "--class", "^snerg$", "windowsize", width, height)
        for _ in range(3):
            window.app.touch(1)
            window.step()
            shown = grab()
            if shown is not None:
                hold_against_camera(window, shown)
                checked, tiled = checked + 1, tiled + (len(window.canvas.layers) > 1)
    assert checked > GRABS and tiled > GRABS / 2


def test_two_packs_are_seen_through_one_camera_while_it_moves(window, xdotool, grab):
    """A pack against itself: whatever differs is a picture of another camera, or of another sharpness."""
    app = window.app
    app.compare_with(toy_pack(), app.scene.path)
    app.comparison.how = "difference"
    wait(window, lambda: not window.canvas.pending)
    worst = []
    slide(window, xdotool, grab, lambda shown: worst.append(shown.max()), button=1)
    assert max(worst) <= 24
    app.comparison.how, app.comparison.split = "wipe", 0.35
    edge = round(0.35 * app.viewport.width)

    def check(shown: np.ndarray) -> None:
        expected = window.canvas.snapshot(app.viewport.camera, app.settings)
        shown[:, edge - 20 : edge + 20] = expected[:, edge - 20 : edge + 20]  # but for the handle between the two
        hold_against_camera(window, shown)

    slide(window, xdotool, grab, check)
    app.comparison.drop_other(app)
