"""Camera page, and the axes of the placed frame in a corner of the picture."""

import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from scenepack.placement import moved_pose, transformed
from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.pose import UP_AXES
from viewer.core.screen import AXIS_COLOURS
from viewer.core.widgets import Box, px
from viewer.features.camera.orbit_camera import Navigation
from viewer.features.camera.walking import EYE_HEIGHTS
from viewer.features.crop.panel import near_plane
from viewer.rendering.canvas import Canvas

PROJECTIONS = {False: "Perspective", True: "Ortho"}  # by whether it is orthographic
NAVIGATIONS: dict[Navigation, str] = {"orbit": "Orbit", "fly": "Fly", "walk": "Walk"}


def show(app: App, canvas: Canvas) -> None:
    rig = app.open_scene.rig
    with ui.card("go", "Go to"):
        whole = f"{fa.ICON_FA_EXPAND}  Whole scene"
        ui.two_commands(app, ("home", f"{fa.ICON_FA_HOUSE}  First view"), ("frame", whole))
        if not rig.bounded:
            for views in (("front", "right", "top"), ("back", "left", "bottom")):
                if picked := ui.segments(f"##axis {views[0]}", {view: view.capitalize() for view in views}, ""):
                    app.run(picked)
            if ui.segments("Projection", PROJECTIONS, rig.orthographic) not in (None, rig.orthographic):
                app.run("orthographic")
            app.interface.axes_shown = ui.switch("axes", app.interface.axes_shown, "Axes")
            if (picked := ui.segments("Navigation", NAVIGATIONS, rig.navigation)) not in (None, rig.navigation):
                app.run(rig.navigation if picked == "orbit" else picked)
            *move, down, up = app.keyboard.flying_names
            keys = " ".join(move)
            if rig.walking:
                app.walking.eye_height_m = ui.slider("Eye height", app.walking.eye_height_m, *EYE_HEIGHTS, "%.2f m")
                if not app.annotations.current.scale.unit:
                    ui.hint("The scene has no scale, so that its metres are a guess.")
                ui.hint(f"{keys} or the arrows to walk, {up} to jump, Shift faster, drag to look, wheel for the speed.")
            elif rig.flying:
                text = f"{keys} or the arrows to move, {down} and {up} down and up, Shift faster, drag to look, "
                ui.hint(f"{text}wheel for the speed.")
    with ui.card("lens", "Lens"):
        value = ui.undoable_slider(app, "Field of view##fov", rig.fov, 10.0, 110.0, "%.0f°")
        ui.tip("Vertical angle; Ctrl+click to type")
        if value is not None:
            app.set_fov(value)
        if not rig.bounded:
            near_plane(app)
            if picked := ui.segments("Up", {axis: axis for axis in UP_AXES}, rig.table.up):
                rig.set_up(picked)
    with ui.card("where", "Position"):
        placed_T_grid = app.annotations.current.placed_T_grid
        pose = moved_pose(placed_T_grid, rig.matrix)
        ui.figure("Eye", _numbers(pose[:3, 3]))
        ui.figure("Direction", _numbers(-pose[:3, 2]))
        if not rig.bounded:
            ui.figure("Pivot", _numbers(transformed(placed_T_grid, np.array(rig.goal.pivot))))
        ui.hint("In the placed frame, y up.")
        copy, paste = f"{fa.ICON_FA_COPY}  Copy pose", f"{fa.ICON_FA_PASTE}  Paste pose"
        ui.two_commands(app, ("copy-pose", copy), ("paste", paste))


def _numbers(point: np.ndarray) -> str:
    return "  ".join(f"{value:z.3f}" for value in point)


# --- The axes of the placed frame in a corner of the picture: a click looks along one, a drag orbits ---
RADIUS, AXES_MARGIN, BALL = 36.0, 14.0, 9.5  # of the gizmo, from the picture's edges, of an axis's end; units at 100 %
LEAST_ROOM = 260.0  # a picture that is smaller has none for it
CLICK = 4.0  # a drag is longer
ON_BALL = "#10151c"
# The ends of the axes: +x, +y, +z, -x, -y, -z.
NAMES = ("X", "Y", "Z", "-X", "-Y", "-Z")
ENDS = np.concatenate([np.eye(3), -np.eye(3)])  # unit vectors, placed frame


def show_axes(app: App, box: Box) -> None:
    """Draws them in the picture's upper right corner and takes the mouse there, before whatever else listens to it."""
    camera, rig = app.viewport.camera, app.open_scene.rig
    if camera is None or rig.bounded or not app.interface.axes_shown or app.kiosk is not None:
        return
    if min(box[2], box[3]) < px(LEAST_ROOM):
        return
    radius, reach = px(RADIUS), px(RADIUS) + px(BALL)
    middle = np.array([box[0] + box[2] - px(AXES_MARGIN) - reach, box[1] + px(AXES_MARGIN) + reach])
    imgui.set_cursor_screen_pos(ImVec2(*(middle - reach)))
    imgui.invisible_button("##axes", ImVec2(2 * reach, 2 * reach))
    hovered, active = imgui.is_item_hovered(), imgui.is_item_active()
    ends = axis_ends(np.array(rig.table.placed) @ camera.grid_T_camera[:3, :3])
    io = imgui.get_io()
    places, depths = middle + radius * ends[:, :2], ends[:, 2]
    close = np.linalg.norm(places - [io.mouse_pos.x, io.mouse_pos.y], axis=1) <= px(BALL)
    # the foremost where two lie over each other
    under = int(np.argmax(np.where(close, depths, -np.inf))) if hovered and close.any() else None
    dragged = io.mouse_drag_max_distance_sqr[0] >= px(CLICK) ** 2
    if imgui.is_item_activated():
        rig.remember()
    elif active and dragged and (io.mouse_delta.x or io.mouse_delta.y):
        rig.orbit(io.mouse_delta.x / box[3], io.mouse_delta.y / box[3])
    elif imgui.is_item_deactivated() and not dragged and under is not None:
        rig.look_from(ENDS[under] @ np.array(rig.table.placed))
    if hovered or active:
        imgui.get_window_draw_list().add_circle_filled(ImVec2(*middle), reach, theme.packed(theme.BASE, 0.55))
    _draw_axes(middle, places, depths, under, hovered or active)
    imgui.set_cursor_pos(ImVec2(0, 0))


def axis_ends(placed_R_camera: np.ndarray) -> np.ndarray:
    """Where the six ends are seen, float64 [6, 3]: x to the right, y down, z towards the viewer."""
    return ENDS @ placed_R_camera * [1.0, -1.0, 1.0]


def _draw_axes(middle: np.ndarray, places: np.ndarray, depths: np.ndarray, under: int | None, near: bool) -> None:
    draw = imgui.get_window_draw_list()
    for end in np.argsort(depths):
        place = ImVec2(*places[end])
        colour, positive = AXIS_COLOURS[end % 3], end < 3
        opacity = 0.65 + 0.35 * float(depths[end] > -0.3)
        if positive:
            draw.add_line(ImVec2(*middle), place, theme.packed(colour, opacity), px(2.5))
        size = px(BALL if positive or near else 0.72 * BALL)
        draw.add_circle_filled(place, size, theme.packed(colour if positive else ON_BALL, opacity if positive else 0.6))
        if not positive:
            draw.add_circle(place, size, theme.packed(colour, opacity), 0, px(1.5))
        if end == under:
            draw.add_circle(place, size + px(1.5), theme.packed("#ffffff"), 0, px(2))
        if positive or end == under:
            with ui.font(None, theme.SMALL):
                at = place - imgui.calc_text_size(NAMES[end]) / 2
                draw.add_text(at, theme.packed(ON_BALL if positive else "#ffffff"), NAMES[end])
