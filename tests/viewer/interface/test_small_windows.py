"""Bars and overlays in windows of every size: nothing overlaps, nothing is out of reach."""

import itertools

import numpy as np
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


def test_a_wide_bar_has_everything_and_gives_up_what_matters_least_first():
    widths = (120.0, 110.0, 60.0)
    states = [plan(float(width), 1.0, widths, BUTTONS) for width in range(1200, 180, -1)]
    assert states[0] == top_bar.Plan(True, 120.0, True, True, BUTTONS)
    for flag in ("details", "word", "speed"):
        values = [getattr(state, flag) for state in states]
        assert values == sorted(values, reverse=True)  # gone once, gone for good
    gone = [
        next(i for i, state in enumerate(states) if not getattr(state, flag)) for flag in ("details", "word", "speed")
    ]
    first_menu = next(i for i, state in enumerate(states) if state.buttons < BUTTONS)
    assert gone == sorted(gone) and gone[-1] < first_menu


def help_window(ui):
    ui.app.interface.help_shown = True
    ui.settle()
    return imgui.internal.find_window_by_name(keys.NAME)


@pytest.mark.parametrize(
    ("size", "scale"), [((1280, 800), 2.0), ((960, 720), 1.5), ((480, 360), 1.0), ((800, 600), 1.0)]
)
def test_the_last_row_of_the_keys_can_be_reached(offscreen, app, pack, pack_folder, size, scale):
    ui = offscreen(app, size=size, scale=scale)
    app.show(pack, pack_folder)
    shown = help_window(ui)
    assert shown.pos.x >= 0 and shown.pos.y >= 0
    assert shown.pos.x + shown.size.x <= size[0] and shown.pos.y + shown.size.y <= size[1]
    hidden = shown.content_size.y - (shown.inner_clip_rect.max.y - shown.inner_clip_rect.min.y)
    for _ in range(40):
        ui.wheel(-3.0, size[0] / 2, size[1] / 2)
    ui.settle()
    assert shown.scroll.y == shown.scroll_max.y >= hidden


def test_the_overlay_names_every_command_and_the_keys_of_flying(offscreen, app, pack, pack_folder):
    ui = offscreen(app)
    app.show(pack, pack_folder)
    ui.frame()
    app.keyboard.local_name = {"W": "Z", "A": "Q", "Q": "A"}.get
    app.keyboard.local_name = lambda place: {"W": "Z", "A": "Q", "Q": "A"}.get(place, place)
    rows = [row for group in keys._groups(app) for row in group.rows]
    assert {title for _, title in rows} >= {command.title for command in COMMANDS.values() if command.keys}
    listed = " ".join(keys for keys, _ in rows)
    assert all(word in listed for word in ("Z  S", "Q  D", "E  A", "Left drag", "Wheel", "Double click", "arrows"))


@given(rows=st.lists(st.integers(1, 14), min_size=4, max_size=8), count=st.integers(1, 3))
def test_the_columns_keep_the_order_and_are_balanced(rows, count):
    groups = [keys._Group(str(i), (("", ""),) * n) for i, n in enumerate(rows)]
    columns = keys._columns(groups, count)
    assert [group for column in columns for group in column] == groups and len(columns) == count
    heights = [sum(len(group.rows) + 2 for group in column) for column in columns]
    lines = [n + 2 for n in rows]
    every = itertools.combinations(range(1, len(lines)), count - 1)
    best = min(max(sum(lines[a:b]) for a, b in itertools.pairwise((0, *cuts, len(lines)))) for cuts in every)
    assert max(heights) == best


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
    ui.click(menu.pos.x + 60, menu.pos.y + menu.size.y - menu.window_padding.y - 15)  # its last line
    assert app.interface.over == PAGES[-1].id


def test_a_page_over_the_picture_goes_when_the_window_grows(offscreen, app, pack, pack_folder):
    ui = offscreen(app, size=(480, 360))
    app.show(pack, pack_folder)
    ui.settle()
    before = ui.picture().astype(int)
    assert not app.interface.over and app.viewport.width == 430
    ui.click(480 - 25, 48 + 10 + 16 + 40)
    assert app.interface.over == "camera" and app.viewport.width == 430
    ui.settle()
    changed = (np.abs(ui.picture().astype(int) - before).max(axis=2) > 30).any(axis=0)
    assert changed[150:420].mean() > 0.9 and not changed[:100].any()
    azimuth = app.scene.rig.goal.azimuth
    ui.drag([(300, 200), (330, 220)])  # on the page
    assert app.scene.rig.goal.azimuth == azimuth
    ui.drag([(50, 200), (80, 220)])  # beside it
    assert app.scene.rig.goal.azimuth != azimuth
    ui.resize(900, 600)
    ui.settle()
    assert not app.interface.over and app.interface.page == "view"
