"""Finding the way with real keys and a real mouse: axis views, open packs, paths. Not collected by itself; see live_window.py."""

import shutil

import numpy as np
import pytest

from scenepack import save_pack
from tests.viewer.conftest import toy_pack
from tests.viewer.window.live_keys import wait_until
from tests.viewer.window.live_window import opened, pump, window
from viewer.core import widgets
from viewer.core.pose import shortest_turn
from viewer.features.camera import panel as camera_panel

__all__ = ["opened", "window"]  # fixtures

NUMBER_BLOCK = {"1": 87, "2": 88, "3": 89, "4": 83, "5": 84, "6": 85, "7": 79, "8": 80, "9": 81}  # evdev's keycodes


def looks_from(rig, azimuth: float, elevation: float) -> bool:
    """Whether the camera has come to rest on that side."""
    there = abs(shortest_turn(rig.shown.azimuth, azimuth)) < 0.1 and abs(rig.shown.elevation - elevation) < 0.1
    return there and rig.shown == rig.goal


@pytest.mark.parametrize(
    ("keys", "azimuth", "elevation"),
    [
        (["1"], 0, 0), (["ctrl", "1"], 180, 0), (["3"], 90, 0), (["ctrl", "3"], 270, 0), (["7"], 0, 90),
        (["ctrl", "7"], 0, -90), (["1", "9"], 180, 0), (["1", "6", "8", "8"], 15, 30), (["1", "4", "2"], -15, -15),
    ],
)  # fmt: skip
def test_the_number_block_shows_the_views_that_blender_shows(window, xdotool, keys, azimuth, elevation):
    rig = window.app.scene.rig
    for key in keys:
        if key == "ctrl":
            xdotool("keydown", "ctrl")
        else:
            before = rig.goal
            xdotool("key", NUMBER_BLOCK[key])
            wait_until(window, lambda before=before: rig.goal != before)
    xdotool("keyup", "ctrl")
    wait_until(window, lambda: looks_from(rig, azimuth, elevation))
    assert not rig.flying and not window.app.messages.dialogs


def test_the_five_of_the_number_block_takes_the_perspective_away_and_brings_it_back(window, xdotool):
    rig = window.app.scene.rig
    with_perspective = window.screenshot()
    for orthographic in (True, False):
        xdotool("key", NUMBER_BLOCK["5"])
        wait_until(window, lambda wanted=orthographic: rig.orthographic == wanted)
        window.draw_frames(2)
        picture = window.screenshot()
        changed = np.abs(picture.astype(int) - with_perspective)[150:500, 50:500].mean()
        assert (changed > 1.0) == orthographic
    assert window.ctx.error == "GL_NO_ERROR"


def test_a_click_on_an_axis_looks_along_it_and_a_drag_of_the_gizmo_orbits(window, xdotool):
    app, rig = window.app, window.app.scene.rig

    def places() -> np.ndarray:
        radius, rim = camera_panel.RADIUS, widgets.CARD_MARGIN + camera_panel.RADIUS + camera_panel.BALL
        view = app.viewport
        middle = np.array([view.x + view.width - rim, view.y + rim])
        return middle + radius * camera_panel.axis_ends(rig.matrix[:3, :3])[:, :2]

    for end, (azimuth, elevation) in ((0, (90, 0)), (5, (180, 0)), (1, (0, 90))):
        rig.home()
        wait_until(window, lambda: rig.shown == rig.goal)
        x, y = places()[end]
        xdotool("mousemove", round(x), round(y), "click", 1)
        wait_until(window, lambda a=azimuth, e=elevation: looks_from(rig, a, e))
    before = rig.goal
    assert rig.history.undo() and rig.goal != before  # a click is one step
    xdotool("mousemove", round(x), round(y), "mousedown", 1)
    pump(window)
    start = rig.goal
    xdotool("mousemove", round(x) - 60, round(y) + 20)
    wait_until(window, lambda: rig.goal.azimuth != start.azimuth)
    xdotool("mouseup", 1)
    pump(window)
    assert rig.goal.pivot == start.pivot


def test_ctrl_tab_goes_through_the_open_packs_and_ctrl_w_closes_one(window, xdotool, tmp_path):
    app = window.app
    for name in ("one", "two"):
        app.show(toy_pack(view_mlp=False), tmp_path / name)
    first = app.open_packs.packs[0].scene.name
    xdotool("key", "ctrl+Tab")
    wait_until(window, lambda: app.scene.name == first)
    xdotool("key", "ctrl+shift+Tab")
    wait_until(window, lambda: app.scene.name == "two")
    xdotool("key", "ctrl+w")
    wait_until(window, lambda: app.scene.name == "one" and len(app.open_packs.packs) == 1)
    assert app.interface.panels_shown and window.ctx.error == "GL_NO_ERROR"


def test_a_copied_path_is_opened_by_ctrl_v(window, xdotool, tmp_path):
    app = window.app
    save_pack(toy_pack(view_mlp=False), tmp_path / "pasted päck")
    app.clipboard.set(f"'{tmp_path / 'pasted päck'}'\n")
    xdotool("key", "ctrl+v")
    wait_until(window, lambda: app.scene.name == "pasted päck" and app.loading is None)
    app.clipboard.set(str(tmp_path / "gone"))
    xdotool("key", "ctrl+v")
    wait_until(window, lambda: bool(app.messages.dialogs))
    assert "nothing at this path" in app.messages.dialogs[0].text
    xdotool("key", "Return")
    wait_until(window, lambda: not app.messages.dialogs)


def test_open_takes_a_typed_path_a_line_below_it_and_a_recent_one(window, xdotool, pack_folder, tmp_path):
    app = window.app
    folder = tmp_path / "folder"
    (folder / "inner" / "deeper").mkdir(parents=True)
    shutil.copytree(pack_folder, folder / "inner" / "deeper" / "pack one")
    xdotool("key", "ctrl+o")
    wait_until(window, lambda: app.open_prompt is not None and window.ui.typing)
    xdotool("type", "--delay", 5, f"{folder}/inn")
    wait_until(window, lambda: app.open_prompt.text.endswith("inn"))
    xdotool("key", "Down")
    wait_until(window, lambda: app.open_prompt.picked == 0)
    xdotool("key", "Return")
    wait_until(window, lambda: app.open_prompt.text.endswith("inner/") and window.ui.typing)
    pump(window, 0.2)  # the frames in which the field is entered anew
    xdotool("type", "--delay", 5, "deeper/pa")
    wait_until(window, lambda: app.open_prompt.text.endswith("deeper/pa"))
    xdotool("key", "Down")
    wait_until(window, lambda: app.open_prompt.picked == 0)
    xdotool("key", "Return")
    wait_until(window, lambda: app.scene.name == "pack one" and app.open_prompt is None)
    app.close()
    xdotool("key", "ctrl+o")
    wait_until(window, lambda: app.open_prompt is not None and window.ui.typing)
    xdotool("type", "--delay", 5, "one")
    wait_until(window, lambda: app.open_prompt.text == "one")
    xdotool("key", "Return")
    wait_until(window, lambda: app.scene is not None and app.scene.name == "pack one")
    xdotool("key", "ctrl+o")
    wait_until(window, lambda: app.open_prompt is not None)
    xdotool("key", "Escape")
    wait_until(window, lambda: app.open_prompt is None)
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"
