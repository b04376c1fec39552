"""The interface drawn offscreen through EGL: buttons, keys and the mouse do what they say."""

from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from tests.viewer.rendering.shapes import surroundings_pack
from viewer.app.application import App
from viewer.core import widgets
from viewer.features.camera import panel as camera_panel
from viewer.features.preferences.preferences import apply_preferences, current_preferences
from viewer.interface.layout import PAGES

MIDDLE = (400.0, 400.0)


@pytest.fixture
def ui(offscreen, app, pack, pack_folder):
    app.interface.axes_shown = False
    return offscreen(app, pack, pack_folder)


def test_the_window_shows_the_same_pixels_as_the_offscreen_renderer(ui, app, pack):
    app.resolution.rest_scale = 1.0
    app.touch()
    ui.settle()
    expected = ui.canvas.snapshot(app.camera(), app.settings)
    shown = ui.scene_picture()
    assert shown.shape == expected.shape
    # Tiles round rays a little differently, so that a few pixels may fall on the other side of a rounding.
    difference = np.abs(shown.astype(int) - expected.astype(int))
    assert (difference > 1).mean() < 1e-3


def test_a_drag_turns_a_right_drag_slides_the_wheel_comes_nearer_but_not_over_a_panel(ui, app):
    rig = app.scene.rig
    start = rig.goal
    ui.drag([MIDDLE, (460, 420)])
    turned = rig.goal
    assert turned.azimuth != start.azimuth and turned.elevation > start.elevation and turned.pivot == start.pivot
    ui.drag([MIDDLE, (460, 420)], button=1)
    assert rig.goal.pivot != turned.pivot and rig.goal.azimuth == turned.azimuth
    slid = rig.goal
    ui.drag([MIDDLE, (460, 420)], button=2)
    assert rig.goal.pivot != slid.pivot
    ui.wheel(2, *MIDDLE)
    assert rig.goal.distance < start.distance
    before = rig.goal
    ui.drag([(1000, 720), (1080, 700)])
    ui.wheel(2, 1000, 700)
    assert rig.goal == before


def test_a_double_click_turns_about_what_is_seen(ui, app):
    before = app.scene.rig.goal.pivot
    ui.io.add_mouse_pos_event(*(float(v) for v in (app.viewport.width / 2, app.viewport.y + app.viewport.height / 2)))
    for _ in range(2):
        ui.io.add_mouse_button_event(0, True)
        ui.frame()
        ui.io.add_mouse_button_event(0, False)
        ui.frame()
    pivot = np.asarray(app.scene.rig.goal.pivot)
    assert tuple(pivot) != before
    assert np.all(np.abs(pivot) < 1.05)  # on the toy, which fills -1 … 1


def test_keys_run_commands(ui, app):
    rig = app.scene.rig
    ui.drag([MIDDLE, (500, 420)])
    ui.key(imgui.Key.r)
    assert rig.goal == rig.home_pose
    ui.key(imgui.Key.mod_ctrl, imgui.Key.z)
    assert rig.goal != rig.home_pose
    ui.key(imgui.Key.home)
    assert rig.goal == rig.home_pose
    ui.key(imgui.Key.space)
    assert app.settings.mode == "diffuse"
    ui.key(imgui.Key.tab)
    assert not app.interface.panels_shown and app.viewport.width == ui.size[0]
    ui.key(imgui.Key.mod_shift, imgui.Key.slash)
    assert app.interface.help_shown
    ui.key(imgui.Key.escape)
    assert not app.interface.help_shown


def test_a_click_on_an_axis_looks_along_it_and_a_drag_of_the_gizmo_orbits(ui, app):
    app.interface.axes_shown = True
    rig, view = app.scene.rig, app.viewport
    rim = widgets.CARD_MARGIN + camera_panel.RADIUS + camera_panel.BALL
    middle = np.array([view.x + view.width - rim, view.y + rim])
    for end, angles in ((0, (90, 0)), (5, (180, 0)), (1, (0, 90))):
        rig.home()
        rig.shown = rig.goal
        ui.settle()
        x, y = middle + camera_panel.RADIUS * camera_panel.axis_ends(rig.matrix[:3, :3])[end, :2]
        ui.click(float(x), float(y))
        assert (rig.goal.azimuth % 360, rig.goal.elevation) == pytest.approx(angles)
    start = rig.goal
    assert rig.history.undo() and rig.goal == rig.home_pose  # a click is one step
    ui.drag([(x, y), (x - 30, y + 10), (x - 60, y + 20)])
    assert rig.goal.azimuth != rig.home_pose.azimuth and rig.goal.pivot == start.pivot


def test_the_rail_opens_and_closes_pages(ui, app):
    x = ui.size[0] - 25
    for i, page in enumerate(PAGES):
        app.interface.page = ""
        ui.click(x, 48 + 10 + 16 + 40 * i)
        assert app.interface.page == page.id
    ui.click(x, 48 + 10 + 16 + 40 * (len(PAGES) - 1))
    assert app.interface.page == ""


def test_the_surroundings_of_a_contracted_pack_have_a_switch_that_is_remembered(ui, app, pack, pack_folder):
    app.interface.page = "view"
    contracted = surroundings_pack(64)
    assert not ui.widgets("##surroundings")
    app.show(contracted, pack_folder)
    ui.settle()
    whole = ui.scene_picture()
    ui.press("##surroundings")
    ui.settle()
    assert not app.settings.surroundings and not current_preferences(app)["surroundings"]
    assert np.abs(ui.scene_picture().astype(int) - whole).mean() > 20
    again = App()
    apply_preferences(again, current_preferences(app))
    assert not again.settings.surroundings
    ui.press("##surroundings")
    ui.settle()
    assert app.settings.surroundings and np.abs(ui.scene_picture().astype(int) - whole).mean() < 1


def test_dense_displays_get_more_pixels_and_the_same_layout(offscreen, app, pack, pack_folder):
    ui = offscreen(app, size=(600, 400), density=2.0)
    app.show(pack, pack_folder)
    ui.settle()
    assert ui.picture().shape == (800, 1200, 3)
    assert app.viewport.pixels == (round(2 * app.viewport.width), round(2 * app.viewport.height))
    assert ui.canvas.drawn_size == app.viewport.pixels


# Names of files that are not UTF-8 are drawn like others

NAME = "n\udcffme"


def test_a_pack_a_photograph_and_a_message_may_have_any_name(offscreen, app, pack, pack_folder: Path) -> None:
    ui = offscreen(app)
    app.preferences.recent = [str(pack_folder.with_name(NAME))]
    pack_folder.with_name(NAME).mkdir()
    ui.frame()  # the start page lists it
    app.show(pack, pack_folder.with_name(NAME))
    for page in ("view", "photographs", "bookmarks", "log"):
        app.interface.page = page
        app.messages.say(f"Saved {NAME}")
        ui.frame()
    app.messages.fail(NAME, f"{NAME} was not written")
    ui.settle()
