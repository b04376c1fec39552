"""The interface drawn offscreen through EGL: buttons, keys and the mouse do what they say."""

from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from tests.viewer.interface.places import child
from tests.viewer.offscreen_ui import drawn_widths
from tests.viewer.rendering.shapes import surroundings_pack
from tests.viewer.waiting import at_once
from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.core import widgets
from viewer.features.camera import panel as camera_panel
from viewer.features.export.exporting import Server, Writing
from viewer.features.preferences import preferences
from viewer.features.preferences.preferences import apply_preferences, current_preferences
from viewer.interface import keys
from viewer.interface.layout import PAGES

MIDDLE = (400.0, 400.0)


@pytest.fixture
def ui(offscreen, app, pack, pack_folder):
    app.interface.axes_shown = False
    return offscreen(app, pack, pack_folder)


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
    for _ in range(2):
        ui.click(app.viewport.width / 2, app.viewport.y + app.viewport.height / 2)
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
        at_once(rig.home)
        ui.settle()
        x, y = middle + camera_panel.RADIUS * camera_panel.axis_ends(rig.matrix[:3, :3])[end, :2]
        ui.click(float(x), float(y))
        assert (rig.goal.azimuth % 360, rig.goal.elevation) == pytest.approx(angles)
    start = rig.goal
    rig.shown = start
    rig.look_from(np.array([0.0, 1.0, 0.0]))  # once more: from the other side
    assert rig.goal.elevation == pytest.approx(-90) and rig.history.undo()
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


def test_the_surroundings_of_a_contracted_pack_have_a_switch_that_is_remembered(ui, app, pack_folder):
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


def test_a_pack_a_photograph_and_a_message_may_have_any_name(offscreen, app, pack, pack_folder: Path) -> None:
    ui, path = offscreen(app), pack_folder.with_name("n\udcffme")
    app.preferences.recent = [str(path)]
    path.mkdir()
    ui.frame()  # the start page lists it
    app.show(pack, path)
    for page in ("view", "photographs", "bookmarks", "log"):
        app.interface.page = page
        app.messages.say(f"Saved {path.name}")
        ui.frame()
    app.messages.fail(path.name, f"{path.name} was not written")
    ui.settle()


def test_a_long_name_on_the_start_page_ends_where_its_column_ends(offscreen, app, tmp_path: Path) -> None:
    app.preferences.recent = [str(tmp_path / ("long" * 50))]
    (tmp_path / ("long" * 50)).mkdir()
    ui = offscreen(app, size=(800, 600))
    ui.settle()
    listed = ui.picture()[440:].astype(int)
    assert np.ptp(listed[:, 200:600]) > 100 and np.ptp(listed[:, 630:]) < 30


def test_cards_of_long_work_name_minutes_and_shorten_names(ui, app, tmp_path: Path, monkeypatch) -> None:
    name = "long-name-" * 9
    app.interface.page = "film"
    app.filming.turntable(app)
    app.filming.film(app, tmp_path / name)
    monkeypatch.setattr(type(app.filming.export), "seconds_left", 467.0)
    app.exporting.writing = Writing(child(), tmp_path / "nothing", file=tmp_path / f"{name}.glb")
    drawn = drawn_widths(monkeypatch)
    ui.frames(2)
    monkeypatch.undo()
    assert any(text.endswith("%, about 7 min 47 s left") for text in drawn)
    named = [text for text in drawn if "long-name" in text]
    assert len(named) == 3 and all(text.endswith("…") and drawn[text] < 280 for text in named)


def test_the_address_of_a_scene_that_is_shared_is_copied(ui, app, tmp_path: Path) -> None:
    app.sharing.server = Server(child(), tmp_path / "nothing", name="toy", address="http://127.0.0.1:9/x/")
    ui.press("Copy##address")
    assert app.clipboard.text == "http://127.0.0.1:9/x/"


def test_a_page_is_pulled_out_another_takes_its_place_and_the_layout_is_remembered_and_reset(
    ui, app, offscreen, tmp_path, pack, pack_folder
):
    usual = app.viewport
    ui.pull((usual.width + 60, 62.0), (300.0, 200.0), 12)  # its tab, into the picture
    assert app.interface.moved == ["view"] and app.interface.page == ""
    assert app.viewport.width > usual.width + 250  # the picture has the place
    app.interface.opens("camera")
    ui.settle()
    assert app.interface.page == "camera" and app.viewport.width == usual.width
    ui.pull((300.0, 200.0), (24.0, app.viewport.y + app.viewport.height / 2), 12)  # docks it on the left
    app.interface.closes("view")
    ui.settle()
    assert not app.interface.shows("view")
    app.interface.opens("view")
    ui.settle()
    assert app.interface.moved == ["view"]  # where it was left
    app.interface.opens("film")
    ui.settle()
    assert app.interface.moved == ["view"] and app.interface.page == "film"
    app.interface.layout = ui.ui.layout
    file = tmp_path / "viewer.json"
    assert preferences.save(current_preferences(app), file) is None
    again = App()
    apply_preferences(again, preferences.load(file))
    offscreen(again, pack, pack_folder)
    assert again.interface.moved == ["view"] and again.interface.page == "film"
    assert again.viewport.x == app.viewport.x > 200 and again.viewport.width == app.viewport.width
    assert app.run("layout")
    ui.settle()
    assert app.interface.moved == [] and app.interface.page == "film" and app.viewport == usual


def test_a_page_that_was_opened_again_where_it_was_left_comes_home_as_well(ui, app):
    usual = app.viewport
    ui.pull((usual.width + 60, 62.0), (300.0, 200.0), 12)
    app.interface.opens("film")
    ui.settle()
    app.interface.closes("view")
    ui.settle()
    app.interface.opens("view")
    ui.settle()
    assert app.interface.moved == ["view"]
    assert app.run("layout")
    ui.settle()
    assert app.interface.moved == [] and app.viewport == usual


@pytest.mark.parametrize(("size", "scale"), [((1280, 800), 2.0), ((480, 360), 1.0)])
def test_the_last_row_of_the_keys_can_be_reached(offscreen, app, pack, pack_folder, size, scale):
    ui = offscreen(app, pack, pack_folder, size=size, scale=scale)
    app.interface.help_shown = True
    ui.settle()
    shown = imgui.internal.find_window_by_name(keys.NAME)
    assert shown.pos.x >= 0 and shown.pos.y >= 0
    assert shown.pos.x + shown.size.x <= size[0] and shown.pos.y + shown.size.y <= size[1]
    hidden = shown.content_size.y - (shown.inner_clip_rect.max.y - shown.inner_clip_rect.min.y)
    for _ in range(40):
        ui.wheel(-3.0, size[0] / 2, size[1] / 2)
    ui.settle()
    assert shown.scroll.y == shown.scroll_max.y >= hidden


def test_the_overlay_names_every_command_and_the_keys_of_flying(offscreen, app, pack, pack_folder):
    offscreen(app, pack, pack_folder)
    app.keyboard.local_name = lambda place: {"W": "Z", "A": "Q", "Q": "A"}.get(place, place)
    rows = [row for _, group in keys._groups(app) for row in group]
    assert {title for _, title in rows} >= {command.title for command in COMMANDS.values() if command.keys}
    listed = " ".join(keys for keys, _ in rows)
    assert all(word in listed for word in ("Z  S", "Q  D", "E  A", "Left drag", "Wheel", "Double click", "arrows"))


def test_a_dense_small_window_has_a_menu_for_its_buttons_and_pages(offscreen, app, pack, pack_folder):
    """As 320 × 240 units at 100 %: four icons of eight, and some buttons."""
    ui = offscreen(app, size=(640, 480), scale=2.0)
    app.show(pack, pack_folder, "a scene with a name that is far too long for this window")
    ui.settle()
    ui.click(640 - 2 * (8 + 17), 2 * 24)  # the menu's button
    assert len(imgui.get_current_context().open_popup_stack) == 1
    app.run("measure")
    ui.key(imgui.Key.escape)
    assert not len(imgui.get_current_context().open_popup_stack) and app.measure_tool.tool
    ui.key(imgui.Key.escape)
    assert not app.measure_tool.tool
    app.interface.over = ""
    ui.frames(2)
    shown = int((480 - 96 - 40 + 16) / 80) - 1
    ui.click(640 - 50, 2 * (48 + 10 + 16 + 40 * shown))
    menu = imgui.get_current_context().open_popup_stack[0].window
    for _ in range(10):  # it is higher than the window
        ui.wheel(-3.0, menu.pos.x + 60, menu.pos.y + 100)
    ui.settle()
    ui.click(menu.pos.x + 60, menu.pos.y + menu.size.y - menu.window_padding.y - 15)  # its last line
    assert app.interface.over == PAGES[-1].id
