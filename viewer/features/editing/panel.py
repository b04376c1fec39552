"""Erase page, and its tools in the picture."""

import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.screen import Screen
from viewer.core.widgets import Box, px
from viewer.features.editing.erasing import CHANGES, FAINTEST, RADII, RULES, SIZES, TOOLS
from viewer.features.measuring.surface import surface_under
from viewer.rendering.canvas import Canvas

HINTS = {
    "": "X takes the brush.",
    "brush": "Paint on surfaces.",
    "lasso": "Draw around what you mean.",
    "sphere": "Press on a surface and drag: from the middle outwards.",
}
HELD = " Ctrl takes away. The right button turns the camera, the middle one moves it. Esc stops."
LOGARITHMIC = imgui.SliderFlags_.logarithmic
MODES = {True: "Add", False: "Subtract"}
ICONS = {
    "invert": fa.ICON_FA_CIRCLE_HALF_STROKE,
    "grow": fa.ICON_FA_UP_RIGHT_AND_DOWN_LEFT_FROM_CENTER,
    "shrink": fa.ICON_FA_DOWN_LEFT_AND_UP_RIGHT_TO_CENTER,
    "clear": fa.ICON_FA_XMARK,
}


def show(app: App, canvas: Canvas) -> None:
    erasing, edits = app.erasing, app.open_scene.edits
    with ui.card("tool", "Select in the picture"):
        if picked := ui.segments("##tool", TOOLS, erasing.tool):
            app.run(f"erase-{picked}")
        ui.hint(HINTS[erasing.tool] + (HELD if erasing.tool else ""))
        picked = ui.segments("##mode", MODES, erasing.adds)
        erasing.adds = erasing.adds if picked is None else picked
        if erasing.tool == "lasso":
            erasing.through = ui.switch("through", erasing.through, "What is hidden, too")
        elif erasing.tool == "brush":
            erasing.radius = ui.slider("Radius", erasing.radius, *RADII, "%.0f voxels", flags=LOGARITHMIC)
    with ui.card("rules", "Select by rule"):
        ui.command(app, "select-parts", RULES["parts"])
        ui.label("Parts below")
        changed, value = imgui.slider_int("##small", erasing.smaller_than, *SIZES, "%d voxels", LOGARITHMIC)
        erasing.smaller_than = max(value, SIZES[0])
        _preview(app, "small", changed)
        ui.label("Fainter than")
        changed, value = imgui.slider_float("##faint", erasing.fainter_than, *FAINTEST, "%.3f", LOGARITHMIC)
        if changed:
            erasing.fainter_than = min(max(value, FAINTEST[0]), FAINTEST[1])
        _preview(app, "faint", changed)
        if app.settings.crop is not None:
            ui.two_commands(app, ("select-inside", "In the crop box"), ("select-outside", "Outside of it"))
    with ui.card("selected", "Selected"):
        ui.figure("Voxels", "selecting…" if erasing.choosing else f"{edits.selected.count:,}")
        for how, icon in ICONS.items():
            if ui.icon_button(icon, how, CHANGES[how][0], enabled=bool(edits.selected.bits) or how == "invert"):
                app.run(f"selection-{how}")
            imgui.same_line(0, px(2))
        imgui.new_line()
        if ui.main_button(f"{fa.ICON_FA_ERASER}  Erase", enabled=bool(edits.selected.bits)):
            app.run("erase-selected")
    with ui.card("save", "Erased"):
        ui.figure("Voxels", f"{edits.removed.count:,}")
        ui.command(app, "save-edited", f"{fa.ICON_FA_FLOPPY_DISK}  Save as…", enabled=bool(edits.removed.bits))
        ui.hint("The open pack stays as it is. Ctrl+Z brings back what was erased.")


def _preview(app: App, rule: str, changed: bool) -> None:
    """Selects by a rule while its slider, the item before, is held or typed into."""
    begins = imgui.is_item_activated()
    if begins:
        app.erasing.hold(app)
    if begins or changed:
        app.run(f"select-{rule}")
    if imgui.is_item_deactivated():
        app.erasing.let_go()


# --- Tools over the picture ---


def draw(app: App, box: Box, over: bool) -> None:
    """Draws what a tool is about to select. over: the mouse is over nothing but the picture."""
    erasing = app.erasing
    if not erasing.tool:
        return
    mouse, lines = imgui.get_io().mouse_pos, imgui.get_window_draw_list()
    colour, dark = theme.packed(theme.WARN), theme.packed(theme.BASE, 0.75)
    if erasing.tool == "lasso" and len(erasing.outline) > 1:
        points: list[imgui.ImVec2Like] = [ImVec2(box[0] + x, box[1] + y) for x, y in erasing.outline]
        for line, width in ((dark, 4.0), (colour, 1.5)):
            lines.add_polyline(points, line, px(width), imgui.ImDrawFlags_.closed)
        return
    if erasing.tool == "brush" and over and not imgui.is_item_active():
        erasing.cursor = surface_under(app, mouse.x - box[0], mouse.y - box[1])
    if (hit := erasing.cursor) is None:
        return
    middle = Screen(app, box).points(np.asarray([hit.point]))[0][0]
    radius = erasing.reach if erasing.tool == "sphere" else erasing.radius * erasing.units_per_voxel(app, hit)
    if over and radius > 0:
        for line, width in ((dark, 4.0), (colour, 1.5)):
            lines.add_circle(middle, radius, line, 0, px(width))
