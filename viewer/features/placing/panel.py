"""Move page, and the placed frame's ground in the picture."""

from math import floor, log10

import numpy as np
from imgui_bundle import icons_fontawesome_6 as fa

from scenepack.placement import NOT_MOVED
from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.screen import AXIS_COLOURS, Screen
from viewer.core.widgets import Box, px
from viewer.features.measuring.panel import show_scale
from viewer.features.placing import placing
from viewer.features.placing.placing import PAGE
from viewer.rendering.canvas import Canvas

WAITS = {"ground": "Click on three points of the ground.", "origin": "Click on the surface that becomes the origin."}
ANGLES = (("Turn", 180.0), ("Tilt", 90.0), ("Roll", 180.0))  # of Placement.angles, and the most of each, degrees


def show(app: App, canvas: Canvas) -> None:
    placement = app.annotations.current.placement
    if not app.open_scene.rig.bounded:  # that is seen from one side
        with ui.card("level", "Level"):
            _tool_button(app, "ground", f"{fa.ICON_FA_ARROWS_DOWN_TO_LINE}  By three points", "move-ground")
            ui.command(app, "move-find-ground", f"{fa.ICON_FA_WAND_MAGIC_SPARKLES}  Find the ground")
            ui.hint("The ground becomes level, at height 0.")
            angles = list(placement.angles)
            for i, (name, most) in enumerate(ANGLES):
                value = ui.undoable_slider(app, name, round(angles[i], 1) + 0.0, -most, most, "%.1f°")
                if value is not None:
                    angles[i] = min(max(value, -most), most)
                    placing.put(app, placement.with_angles(*angles))
    with ui.card("origin", "Origin"):
        ui.figure("In the grid frame", "  ".join(f"{value:z.3f}" for value in placement.origin))
        _tool_button(app, "origin", f"{fa.ICON_FA_LOCATION_CROSSHAIRS}  By a point", "move-origin")
    with ui.card("scale", "Scale"):
        show_scale(app)
    with ui.card("placed", "Placed frame"):
        ui.hint("Navigation, coordinates, exports and the web page follow. The pack keeps it, and no voxel changes.")
        text = f"{fa.ICON_FA_ROTATE_LEFT}  Back to the grid frame"
        ui.command(app, "move-reset", text, enabled=placement != NOT_MOVED)


def _tool_button(app: App, tool: str, title: str, command: str) -> None:
    """A button that waits for clicks, and says so; pressed again, it does not any more."""
    waits = app.measure_tool.tool == tool
    ui.command(app, command, "Cancel" if waits else title)
    if waits:
        ui.hint(WAITS[tool])


# --- The ground in the picture ---

CELLS = 10  # of the grid on the ground, on either side of the origin
SPAN = 1.2  # of the scene's radius that they reach, at least


def draw(app: App, box: Box) -> None:
    """Draws a grid at height 0 and the axes at the origin while the page is open."""
    if not app.interface.shows(PAGE):
        return
    rig, annotations = app.open_scene.rig, app.annotations.current
    placed = np.array(annotations.placement.rotation)
    step = _round(SPAN * rig.radius * annotations.scale.factor / CELLS) / annotations.scale.factor
    origin = np.array(annotations.placement.origin)
    screen = Screen(app, box)
    with ui.clipped(box):
        if not rig.bounded:
            x, z, edges = *np.meshgrid(*2 * [np.arange(-CELLS, CELLS + 1)], indexing="ij"), []
            side = 2 * CELLS + 1
            for i in range(side):  # piece by piece: those that lie before the camera
                for j in range(side - 1):
                    edges += [(i * side + j, i * side + j + 1), (j * side + i, (j + 1) * side + i)]
            points = origin + step * (x.reshape(-1, 1) * placed[0] + z.reshape(-1, 1) * placed[2])
            screen.lines(points, edges, theme.packed(theme.MUTED, 0.6), px(1))  # seen on white and on black
        for axis, colour in zip(placed, AXIS_COLOURS, strict=True):
            screen.outlined_lines(np.stack([origin, origin + 2 * step * axis]), [(0, 1)], colour, 2.5, 5)


def _round(length: float) -> float:
    """The nearest of 1, 2 or 5 times a power of ten at or above a length."""
    power = 10.0 ** floor(log10(length))
    return next(times * power for times in (1, 2, 5, 10) if times * power >= length * (1 - 1e-9))
