"""The ruler's page: what is under the cursor, the tools, what was measured, and the scale."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.annotations import METRES, UNITS
from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.app.commands import run
from viewer.app.measure_tool import LengthFormat
from viewer.app.pose import triple
from viewer.panels import theme
from viewer.panels.theme import Fonts
from viewer.panels.widgets import (
    card,
    choice,
    coloured,
    elided,
    figure,
    hint,
    icon_button,
    label,
    main_button,
    px,
    segments,
    switch,
)

LIST_HEIGHT = 150.0
TITLES = {"line": "Length", "angle": "Angle", "point": "Point"}
UNIT_TITLES = {"": "none", "m": "metres", "cm": "centimetres", "mm": "millimetres", "in": "inches", "ft": "feet"}
HINTS = {
    "": "M takes the ruler.",
    "line": "Click on surfaces. Enter or a double click ends the line.",
    "angle": "Click on three points; the angle is at the second.",
    "point": "Click on a surface.",
    "scale": "Click on two points whose distance you know.",
}


def show(app: App, canvas: CanvasInterface, fonts: Fonts) -> None:
    """Draws the page."""
    words = app.measure_tool.length_format(app)
    if words is None:
        return
    with card("cursor", fonts, "Under the cursor"):
        _cursor(app, words, fonts)
    with card("ruler", fonts, "Ruler"):
        _tools(app)
        _list(app, words)
    with card("scale", fonts, "Scale"):
        _scale(app)


def _cursor(app: App, words: LengthFormat, fonts: Fonts) -> None:
    hit = app.measure_tool.cursor
    point = triple(hit.point) if hit is not None else None
    figure("Distance", words.length(hit.distance) if hit is not None else "–", fonts)
    figure("Position", words.place(point) if point is not None else "–", fonts)
    scene = words.in_scene(point) if point is not None else None
    figure("In the scene", "  ".join(f"{v:.3f}" for v in scene) if scene is not None else "–", fonts)
    hint("From the camera; in the grid's frame, y up; in the frame of the scene's cameras, in its own units.")


def _tools(app: App) -> None:
    measure_tool = app.measure_tool
    picked = segments("tool", list(TITLES), measure_tool.tool, TITLES)
    if picked in ("line", "angle", "point"):
        measure_tool.choose(app, "" if picked == measure_tool.tool else picked)
    hint(HINTS[measure_tool.tool] + (" Backspace takes a point back, Esc stops." if measure_tool.tool else ""))


def _list(app: App, words: LengthFormat) -> None:
    measure_tool, measurements = app.measure_tool, app.annotations.current.measurements
    if measurements:
        with coloured(child_bg=theme.BASE):
            flags = imgui.ChildFlags_.always_use_window_padding
            imgui.begin_child("##measured", ImVec2(0, px(min(LIST_HEIGHT, 26.0 * len(measurements) + 24.0))), flags)
        for i, measurement in enumerate(measurements):
            width = imgui.get_content_region_avail().x
            imgui.push_id(i)
            if imgui.selectable(f"{TITLES[measurement.kind]} {i + 1}", i == measure_tool.selected)[0]:
                measure_tool.selected = None if i == measure_tool.selected else i
                app.touch()
            imgui.pop_id()
            imgui.same_line(px(86))
            with coloured(text=theme.MUTED):
                imgui.text_unformatted(elided(words.measurement(measurement), width - px(80)))
        imgui.end_child()
        _actions(app)
        hint("Drag a point in the picture to move it. Delete removes what is selected.")
    label("Always show")
    measure_tool.shown = switch("shown", measure_tool.shown)


def _actions(app: App) -> None:
    measure_tool = app.measure_tool
    for icon, name, tooltip, action, enabled in (
        (fa.ICON_FA_COPY, "copy", "Copy as text  (Ctrl+Shift+C)", lambda: run(app, "copy-measurements"), True),
        (fa.ICON_FA_FILE_CSV, "csv", "Save as CSV", lambda: run(app, "save-measurements"), True),
        (
            fa.ICON_FA_TRASH,
            "remove",
            "Remove the selected one",
            lambda: measure_tool.back(app),
            measure_tool.selected is not None,
        ),
        (fa.ICON_FA_BROOM, "clear", "Remove all", lambda: measure_tool.clear(app), True),
    ):
        if icon_button(icon, name, tooltip, enabled=enabled):
            action()
        imgui.same_line(0, px(2))
    imgui.new_line()


def _scale(app: App) -> None:
    measure_tool, scale = app.measure_tool, app.annotations.current.scale
    if measure_tool.tool == "scale":
        _known(app)
        return
    factor = f"{scale.factor:.6g} {scale.unit}".rstrip()
    hint("Lengths are in grid units." if scale == type(scale)() else f"1 grid unit is {factor}.")
    if imgui.button(f"{fa.ICON_FA_RULER}  Set by two points", ImVec2(-1, 0)):
        measure_tool.choose(app, "scale")
    if scale.unit in METRES:
        label("Show in")
        picked = choice("unit", list(METRES), scale.unit, UNIT_TITLES)
        if picked in METRES:
            measure_tool.show_in(app, picked)  # type: ignore[arg-type]  (one of UNITS)
    if scale != type(scale)() and imgui.button("Back to grid units", ImVec2(-1, 0)):
        measure_tool.forget_scale(app)


def _known(app: App) -> None:
    """Asks for the distance of the two points."""
    measure_tool = app.measure_tool
    ready = len(measure_tool.draft) == 2
    hint("How far apart are they?" if ready else HINTS["scale"])
    imgui.begin_disabled(not ready)
    label("Distance")
    changed, value = imgui.input_float("##known", measure_tool.known, 0.0, 0.0, "%.6g")
    if changed:
        measure_tool.known = value
    entered = imgui.is_item_deactivated_after_edit() and imgui.is_key_pressed(imgui.Key.enter)
    label("Unit")
    picked = choice("known unit", UNITS, measure_tool.known_unit, UNIT_TITLES)
    if picked in UNITS:
        measure_tool.known_unit = picked  # type: ignore[assignment]  (one of UNITS)
    pressed = main_button("Set the scale", -1)
    imgui.end_disabled()
    if pressed or (entered and ready):
        run(app, "set-scale")
    if imgui.button("Cancel", ImVec2(-1, 0)):
        measure_tool.choose(app, "")
