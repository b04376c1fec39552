"""The axes of the grid frame in a corner of the picture: a click looks along one, a drag orbits."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.panels import theme
from viewer.panels.widgets import font, px

RADIUS, MARGIN, BALL = 36.0, 14.0, 9.5  # of the gizmo, from the picture's edges, of an axis's end; units at 100 %
LEAST_ROOM = 260.0  # a picture that is smaller has none for it
CLICK = 4.0  # a drag is longer
NAMES = "XYZ"
COLOURS = ("#f2777a", "#6fd08c", "#6cb2f5")
ON_BALL = "#10151c"
Box = tuple[float, float, float, float]


class AxisGizmo:
    """travelled: units since the mouse went down on it."""

    def __init__(self) -> None:
        self._travelled = 0.0

    def show(self, app: App, box: Box) -> None:
        """Draws it in the upper right corner of the picture's box and does what the mouse asks for. Before whatever else
        listens to the mouse there.
        """
        camera, scene = app.viewport.camera, app.scene
        if scene is None or camera is None or scene.rig.bounded or not app.interface.axes_shown:
            return
        if min(box[2], box[3]) < px(LEAST_ROOM):
            return
        radius = px(RADIUS)
        middle = np.array([box[0] + box[2] - px(MARGIN) - radius - px(BALL), box[1] + px(MARGIN) + radius + px(BALL)])
        reach = radius + px(BALL)
        imgui.set_cursor_screen_pos(ImVec2(*(float(v) for v in middle - reach)))
        imgui.invisible_button("##axes", ImVec2(2 * reach, 2 * reach))
        hovered, active = imgui.is_item_hovered(), imgui.is_item_active()
        ends = axis_ends(camera.grid_T_camera[:3, :3])
        io = imgui.get_io()
        places = middle + radius * ends[:, :2]
        under = _under(places, ends[:, 2], np.array([io.mouse_pos.x, io.mouse_pos.y])) if hovered else None
        self._listen(app, box, under)
        if hovered or active:
            disc = ImVec2(float(middle[0]), float(middle[1]))
            imgui.get_window_draw_list().add_circle_filled(disc, reach, theme.packed(theme.BASE, 0.55))
        _draw(middle, places, ends[:, 2], under, hovered or active)
        imgui.set_cursor_pos(ImVec2(0, 0))

    def _listen(self, app: App, box: Box, under: int | None) -> None:
        assert app.scene is not None
        rig, io = app.scene.rig, imgui.get_io()
        if imgui.is_item_activated():
            self._travelled = 0.0
            rig.remember()
        elif imgui.is_item_active() and (io.mouse_delta.x or io.mouse_delta.y):
            self._travelled += abs(io.mouse_delta.x) + abs(io.mouse_delta.y)
            if self._travelled >= px(CLICK):
                rig.orbit(io.mouse_delta.x / box[3], io.mouse_delta.y / box[3])
                app.touch()
        if imgui.is_item_deactivated() and self._travelled < px(CLICK) and under is not None:
            rig.look_from(axis_of(under))
            app.touch()


def axis_of(end: int) -> np.ndarray:
    """Unit vector of an axis's end: 0 … 2 for x, y, z, 3 … 5 for the opposite directions; float64 [3], grid frame."""
    return (1.0 if end < 3 else -1.0) * np.eye(3)[end % 3]


def axis_ends(grid_R_camera: np.ndarray) -> np.ndarray:
    """Where the six ends are seen, float64 [6, 3]: x to the right, y down, z towards the viewer."""
    seen = np.stack([axis_of(end) for end in range(6)]) @ grid_R_camera
    return seen * [1.0, -1.0, 1.0]


def _under(places: np.ndarray, depths: np.ndarray, mouse: np.ndarray) -> int | None:
    """The end under the mouse, the foremost where two lie over each other."""
    close = np.linalg.norm(places - mouse, axis=1) <= px(BALL)
    return int(np.argmax(np.where(close, depths, -np.inf))) if close.any() else None


def _draw(middle: np.ndarray, places: np.ndarray, depths: np.ndarray, under: int | None, near: bool) -> None:
    draw = imgui.get_window_draw_list()
    for end in np.argsort(depths):
        place = ImVec2(float(places[end][0]), float(places[end][1]))
        colour, positive = COLOURS[end % 3], end < 3
        opacity = 0.65 + 0.35 * float(depths[end] > -0.3)
        if positive:
            draw.add_line(ImVec2(float(middle[0]), float(middle[1])), place, theme.packed(colour, opacity), px(2.5))
        size = px(BALL if positive or near else 0.72 * BALL)
        draw.add_circle_filled(place, size, theme.packed(colour if positive else ON_BALL, opacity if positive else 0.6))
        if not positive:
            draw.add_circle(place, size, theme.packed(colour, opacity), 0, px(1.5))
        if end == under:
            draw.add_circle(place, size + px(1.5), theme.packed("#ffffff"), 0, px(2))
        if positive or end == under:
            name = NAMES[end % 3] if positive else f"-{NAMES[end % 3]}"
            with font(None, theme.SMALL):
                wide = imgui.calc_text_size(name)
                at = ImVec2(place.x - wide.x / 2, place.y - wide.y / 2)
                draw.add_text(at, theme.packed(ON_BALL if positive else "#ffffff"), name)
