"""Where the camera is and how it sees."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.app.commands import run
from viewer.app.pose import UP_AXES
from viewer.panels.page_crop import near_plane
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, figure, hint, label, px, segments, switch, tip
from viewer.rendering.canvas import Canvas


def show(app: App, canvas: Canvas, fonts: Fonts) -> None:
    """Draws the page."""
    if app.scene is None:
        return
    rig = app.scene.rig
    with card("go", fonts, "Go to"):
        width = (imgui.get_content_region_avail().x - px(8)) / 2
        if imgui.button(f"{fa.ICON_FA_HOUSE}  First view", ImVec2(width, 0)):
            run(app, "home")
        imgui.same_line()
        if imgui.button(f"{fa.ICON_FA_EXPAND}  Whole scene", ImVec2(width, 0)):
            run(app, "frame")
        if not rig.bounded:
            for views in (("front", "right", "top"), ("back", "left", "bottom")):
                picked = segments(f"axis {views[0]}", list(views), "", {view: view.capitalize() for view in views})
                if picked:
                    run(app, picked)
            label("Projection")
            now = "orthographic" if rig.orthographic else "perspective"
            titles = {"perspective": "Perspective", "orthographic": "Ortho"}
            if segments("projection", list(titles), now, titles) not in (None, now):
                run(app, "orthographic")
            label("Axes")
            app.interface.axes_shown = switch("axes", app.interface.axes_shown)
            label("Fly")
            if switch("fly", rig.flying) != rig.flying:
                run(app, "fly")
            if rig.flying:
                *move, down, up = app.keyboard.flying_names
                hint(
                    f"{' '.join(move)} or the arrows to move, {down} and {up} down and up, Shift faster, drag to look, "
                    "wheel for the speed."
                )
    with card("lens", fonts, "Lens"):
        label("Field of view")
        changed, value = imgui.slider_float("##fov", rig.fov, 10.0, 110.0, "%.0f°")
        if imgui.is_item_activated():
            rig.remember()
        tip("Vertical angle; Ctrl+click to type")
        if changed:
            app.set_fov(value)
        if not rig.bounded:
            near_plane(app)
            label("Up")
            picked = segments("up", list(UP_AXES), rig.table.up)
            if picked:
                rig.set_up(picked)
                app.touch()
    with card("where", fonts, "Position"):
        matrix = rig.matrix
        eye, ahead = matrix[:3, 3], -matrix[:3, 2]
        figure("Eye", "  ".join(f"{v:.3f}" for v in eye), fonts)
        figure("Direction", "  ".join(f"{v:.3f}" for v in ahead), fonts)
        if not rig.bounded:
            figure("Pivot", "  ".join(f"{v:.3f}" for v in rig.goal.pivot), fonts)
        hint("In the grid's frame, y up.")
        width = (imgui.get_content_region_avail().x - px(8)) / 2
        if imgui.button(f"{fa.ICON_FA_COPY}  Copy pose", ImVec2(width, 0)):
            run(app, "copy-pose")
        imgui.same_line()
        if imgui.button(f"{fa.ICON_FA_PASTE}  Paste pose", ImVec2(width, 0)):
            run(app, "paste")
