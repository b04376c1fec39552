"""Bars and overlays in windows of every size: nothing overlaps, nothing is out of reach."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from imgui_bundle import imgui

from viewer.app.commands import COMMANDS
from viewer.interface import keys, top_bar
from viewer.interface.layout import PAGES
from viewer.interface.top_bar import EDGE, GAP, MARK, NAME_GAP, STEP, WORD, plan

BUTTONS = 6


@given(
    width=st.floats(240, 2000),
    unit=st.floats(1.0, 2.5),
    name=st.one_of(st.just(0.0), st.floats(10, 900)),
    details=st.floats(0, 200),
    speed=st.sampled_from([0.0, 60.0]),
)
def test_nothing_on_the_bar_overlaps(width, unit, name, details, speed):
    where = plan(width, unit, (name, details, speed), BUTTONS)
    menu = where.buttons < BUTTONS
    right = width - unit * (EDGE + STEP * (where.buttons + menu))
    left = unit * (MARK + WORD * where.word + (NAME_GAP if where.name else 0.0)) + where.name
    left += (details + unit * GAP) if where.details and details else 0.0
    left += (speed + unit * GAP) if where.speed and speed else 0.0
    room = width >= unit * (MARK + NAME_GAP + EDGE + GAP + STEP * 3)  # for the mark, two buttons and a menu
    assert not room or left <= right + 1e-6
    assert 0 <= where.name <= name and top_bar.LEAST_BUTTONS <= where.buttons <= BUTTONS


def help_window(ui):
    ui.app.interface.help_shown = True
    ui.settle()
    return imgui.internal.find_window_by_name(keys.NAME)


@pytest.mark.parametrize(
    ("size", "scale"), [((1280, 800), 2.0), ((960, 720), 1.5), ((480, 360), 1.0), ((800, 600), 1.0)]
)
def test_the_last_row_of_the_keys_can_be_reached(offscreen, app, pack, pack_folder, size, scale):
    ui = offscreen(app, pack, pack_folder, size=size, scale=scale)
    shown = help_window(ui)
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
    bar = plan(640.0, 2.0, (500.0, 200.0, 0.0), BUTTONS)
    assert bar.buttons < BUTTONS
    ui.click(640 - 2 * (8 + 17), 2 * 24)  # the menu's button
    assert len(imgui.get_current_context().open_popup_stack) == 1
    ui.key(imgui.Key.escape)
    ui.click(20, 400)
    shown = int((480 - 96 - 40 + 16) / 80) - 1
    ui.click(640 - 50, 2 * (48 + 10 + 16 + 40 * shown))
    menu = imgui.get_current_context().open_popup_stack[0].window
    for _ in range(10):  # it is higher than the window
        ui.wheel(-3.0, menu.pos.x + 60, menu.pos.y + 100)
    ui.settle()
    ui.click(menu.pos.x + 60, menu.pos.y + menu.size.y - menu.window_padding.y - 15)  # its last line
    assert app.interface.over == PAGES[-1].id
