"""Measure page, and the measurements in the picture."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.annotations import METRES, Kind, Measurement, Point, Scale, Unit
from viewer.core.pose import triple
from viewer.core.screen import Screen
from viewer.core.widgets import Box, px
from viewer.features.measuring.measure_tool import PAGE, UNMARKED, LengthFormat, Tool, angle, lengths
from viewer.features.measuring.surface import surface_under
from viewer.rendering.canvas import Canvas

LIST_HEIGHT = 150.0
TITLES: dict[Kind, str] = {"line": "Length", "angle": "Angle", "point": "Point"}
UNIT_TITLES: dict[Unit, str] = {
    "": "none",
    "m": "metres",
    "cm": "centimetres",
    "mm": "millimetres",
    "in": "inches",
    "ft": "feet",
}
HINTS = {
    "": "M takes the ruler.",
    "line": "Click on surfaces. Enter or a double click ends the line.",
    "angle": "Click on three points; the angle is at the second.",
    "point": "Click on a surface.",
    "scale": "Click on two points whose distance you know.",
}


def show(app: App, canvas: Canvas) -> None:
    measure_tool, hit = app.measure_tool, app.measure_tool.cursor
    words = measure_tool.length_format(app)
    with ui.card("cursor", "Under the cursor"):
        ui.figure("Distance", words.length(hit.distance) if hit is not None else "–")
        ui.figure("Position", words.place(hit.point) if hit is not None else "–")
        scene = "  ".join(f"{v:z.3f}" for v in words.in_scene(triple(hit.point))) if hit is not None else "–"
        ui.figure("In the scene", scene)
        ui.hint("From the camera; in the placed frame, y up; in the frame of the scene's cameras, in its own units.")
    with ui.card("ruler", "Ruler"):
        if picked := ui.segments("##tool", TITLES, measure_tool.tool):
            measure_tool.choose(app, "" if picked == measure_tool.tool else picked)
        tool = measure_tool.tool if measure_tool.tool in HINTS else ""  # those of the Move page say it there
        ui.hint(HINTS[tool] + (" Backspace takes a point back, Esc stops." if tool else ""))
        _list(app, words)
    with ui.card("scale", "Scale"):
        show_scale(app)


def _list(app: App, words: LengthFormat) -> None:
    measure_tool, measurements = app.measure_tool, app.annotations.current.measurements
    if measurements:
        with ui.list_box("##measured", px(min(LIST_HEIGHT, 26.0 * len(measurements) + 24.0))):
            for i, measurement in enumerate(measurements):
                width = imgui.get_content_region_avail().x
                if imgui.selectable(f"{TITLES[measurement.kind]} {i + 1}", i == measure_tool.selected)[0]:
                    measure_tool.selected = None if i == measure_tool.selected else i
                imgui.same_line(px(86))
                ui.write(ui.elided(words.measurement(measurement), width - px(80)), theme.MUTED)
        _actions(app)
        ui.hint("Drag a point in the picture to move it. Delete removes what is selected.")
    measure_tool.shown = ui.switch("shown", measure_tool.shown, "Always show")


def _actions(app: App) -> None:
    measure_tool, chosen = app.measure_tool, app.measure_tool.selected is not None
    for icon, name, tooltip, action, enabled in (
        (fa.ICON_FA_COPY, "copy", "Copy as text  (Ctrl+Shift+C)", partial(app.run, "copy-measurements"), True),
        (fa.ICON_FA_FILE_CSV, "csv", "Save as CSV", partial(app.run, "save-measurements"), True),
        (fa.ICON_FA_TRASH, "remove", "Remove the selected one", lambda: measure_tool.back(app), chosen),
        (fa.ICON_FA_BROOM, "clear", "Remove all", lambda: measure_tool.clear(app), True),
    ):
        if ui.icon_button(icon, name, tooltip, enabled=enabled):
            action()
        imgui.same_line(0, px(2))
    imgui.new_line()


def show_scale(app: App) -> None:
    """What the scale is, and how it is set: in a card of this page and of the Move page."""
    measure_tool, annotations = app.measure_tool, app.annotations.current
    scale = annotations.scale
    if measure_tool.tool == "scale":
        _known(app)
        return
    factor = f"{scale.factor:.6g} {scale.unit}".rstrip()
    ui.hint("Lengths are in grid units." if scale == Scale() else f"1 grid unit is {factor}.")
    if ui.button(f"{fa.ICON_FA_RULER}  Set by two points"):
        measure_tool.choose(app, "scale")
    if scale.unit in METRES:
        units: dict[Unit, str] = {unit: title for unit, title in UNIT_TITLES.items() if unit}
        if picked := ui.choice("Show in", units, UNIT_TITLES[scale.unit]):
            app.annotations.change(app, replace(annotations, scale=scale.shown_in(picked)))
    if scale != Scale() and ui.button("Back to grid units"):
        app.annotations.change(app, replace(annotations, scale=Scale()))


def _known(app: App) -> None:
    measure_tool = app.measure_tool
    ready = len(measure_tool.draft) == 2
    ui.hint("How far apart are they?" if ready else HINTS["scale"])
    imgui.begin_disabled(not ready)
    ui.label("Distance")
    if measure_tool.asks:
        imgui.set_keyboard_focus_here()
        measure_tool.asks = False
    changed, value = imgui.input_float("##known", measure_tool.known, 0.0, 0.0, "%.6g")
    if changed:
        measure_tool.known = value
    entered = imgui.is_item_deactivated() and any(map(imgui.is_key_pressed, (imgui.Key.enter, imgui.Key.keypad_enter)))
    picked = ui.choice("Unit##known unit", UNIT_TITLES, UNIT_TITLES[measure_tool.known_unit])
    if picked is not None:  # "" is one of them
        measure_tool.known_unit = picked
    pressed = ui.main_button("Set the scale")
    imgui.end_disabled()
    if pressed or (entered and ready):
        app.run("set-scale")
    if ui.button("Cancel"):
        measure_tool.choose(app, "")


# --- Measurements over the picture ---

REACH = 11.0  # of a point's handle, units
ARC_SHARE, ARC_STEPS = 0.25, 16  # of an angle's shorter side; pieces that its arc is drawn as
Handle = tuple[int, int]  # a point that can be dragged: of which measurement, and which of its points


def draw(app: App, box: Box, over: bool) -> Handle | None:
    """Draws measurements and draft; the point under the mouse, if any. over: the mouse is over nothing but the picture."""
    measure_tool, words = app.measure_tool, app.measure_tool.length_format(app)
    active = measure_tool.tool not in UNMARKED or app.interface.shows(PAGE)
    mouse, measure_tool.cursor = imgui.get_io().mouse_pos, None
    if not (active or measure_tool.shown):
        return None
    if over and active:
        measure_tool.cursor = surface_under(app, mouse.x - box[0], mouse.y - box[1])
    screen, measurements = Screen(app, box), app.annotations.current.measurements
    under = _handle_at(screen, measurements, mouse) if over and active else None
    with ui.clipped(box):
        for index, measurement in enumerate(measurements):
            hot = under[1] if under is not None and under[0] == index else None
            colour = theme.WARN if index == measure_tool.selected else theme.ACCENT
            _shape(screen, words, measurement.kind, measurement.points, colour, hot)
        waits = under is None and not (measure_tool.tool == "scale" and len(measure_tool.draft) == 2)
        cursor = measure_tool.cursor if waits else None
        if measure_tool.tool not in UNMARKED:
            points = measure_tool.draft if cursor is None else (*measure_tool.draft, triple(cursor.point))
            _shape(screen, words, measure_tool.tool, points, theme.WARN)
    return under


def _handle_at(screen: Screen, measurements: tuple[Measurement, ...], mouse: ImVec2) -> Handle | None:
    best, nearest = None, px(REACH)
    for index, measurement in enumerate(measurements):
        for point, (place, before) in enumerate(zip(*screen.points(np.asarray(measurement.points)), strict=True)):
            away = float(np.hypot(place.x - mouse.x, place.y - mouse.y))
            if before and away < nearest:
                best, nearest = (index, point), away
    return best


def _shape(
    screen: Screen, words: LengthFormat, tool: Tool, points: tuple[Point, ...], colour: str, hot: int | None = None
) -> None:
    """Points that were placed by a tool, and what they measure. hot: index of the one under the mouse."""
    closed = tool == "ground" and len(points) == 3
    _line(screen, (*points, points[0]) if closed else points, colour)
    if tool == "angle" and len(points) == 3:
        _arc(screen, points, colour)
        _label_at(screen, points[1], f"{angle(points):.1f}°", below=True)
    elif tool == "point" and points:
        _label_at(screen, points[0], words.place(points[0]), below=True)
    elif tool != "ground":
        pieces = lengths(points)
        for (a, b), piece in zip(pairwise(points), pieces, strict=True):
            _label_at(screen, 0.5 * np.add(a, b), words.length(piece))
        if len(pieces) > 1:
            _label_at(screen, points[-1], f"total {words.length(sum(pieces))}", below=True)
    _dots(screen, points, colour, hot)


def _line(
    screen: Screen, points: np.ndarray | tuple[Point, ...], colour: str, width: float = 2, dark: float = 5
) -> None:
    if len(points) > 1:
        screen.outlined_lines(np.asarray(points), list(pairwise(range(len(points)))), colour, width, dark)


def _arc(screen: Screen, points: tuple[Point, ...], colour: str) -> None:
    """Between the two sides of an angle, at the middle one of three points."""
    a, b, c = np.asarray(points)
    sides = np.linalg.norm(a - b), np.linalg.norm(c - b)
    if min(sides) <= 0:
        return
    one, two = (a - b) / sides[0], (c - b) / sides[1]
    share = np.linspace(0.0, 1.0, ARC_STEPS)[:, None]
    way = (1 - share) * one + share * two
    size = np.linalg.norm(way, axis=1, keepdims=True)
    if size.min() < 1e-6:  # a straight angle has no plane
        return
    _line(screen, b + ARC_SHARE * min(sides) * way / size, colour, 1.5, 4)


def _dots(screen: Screen, points: tuple[Point, ...], colour: str, hot: int | None) -> None:
    if not points:
        return
    draw = imgui.get_window_draw_list()
    for i, (place, before) in enumerate(zip(*screen.points(np.asarray(points)), strict=True)):
        if before:
            size = 7.0 if i == hot else 4.5
            draw.add_circle_filled(place, px(size + 2), theme.packed(theme.BASE, 0.85))
            draw.add_circle_filled(place, px(size), theme.packed(colour))
            draw.add_circle_filled(place, px(1.5), theme.packed(theme.BASE))


def _label_at(screen: Screen, at: Point | np.ndarray, text: str, *, below: bool = False) -> None:
    """A label at a point of the scene: on its middle, or just below."""
    places, before = screen.points(np.asarray([at]))
    if before[0]:
        width, height = ui.chip_size(text)
        ui.chip(text, places[0].x - 0.5 * width, places[0].y + (px(12) if below else -0.5 * height))
