"""Cutting the scene: a box that is dragged, and the near plane."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from scenepack.pack import Pack
from viewer.app import crop
from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, hint, icon_button, label, px, segments, switch, tip

TITLES = {"faces": "Faces", "move": "Move", "scale": "Scale"}
HINTS = {
    "faces": "Drag the dots on the box's faces in the picture.",
    "move": "Drag the arrows in the picture, or the squares between them.",
    "scale": "Drag the knobs in the picture to scale about the middle.",
}


def show(app: App, canvas: CanvasInterface, fonts: Fonts) -> None:
    """Draws the page."""
    if app.scene is None:
        return
    pack, rig = app.scene.pack, app.scene.rig
    if rig.bounded:
        with card("none", fonts, "Crop box"):
            hint("Forward-facing packs use a warped space (NDC), where a crop box does not work.")
        return
    with card("crop", fonts, "Crop box"):
        label("Crop to a box")
        on = switch("crop", app.settings.crop is not None)
        if on != (app.settings.crop is not None):
            app.cut(crop=crop.whole(pack) if on else None)
        if app.settings.crop is None:
            hint("The whole scene is shown.")
        else:
            picked = segments("tool", crop.TOOLS, app.crop_tool, TITLES)
            if picked in crop.TOOLS:
                app.crop_tool = picked
                app.touch()
            hint(HINTS[app.crop_tool])
            _faces(app, pack)
            imgui.begin_disabled(app.settings.crop == crop.whole(pack))
            if imgui.button(f"{fa.ICON_FA_ROTATE_LEFT}  Reset the box", ImVec2(-1, 0)):
                app.cut(crop=crop.whole(pack))
            imgui.end_disabled()
            tip("To the whole scene")
    with card("near", fonts, "Slice"):
        near_plane(app)
        hint("Hides everything closer to the camera than this, in grid units.")


def near_plane(app: App) -> None:
    """The row with the near plane's slider and its reset; one drag is one step to be undone."""
    assert app.scene is not None
    rig = app.scene.rig
    label("Near plane")
    imgui.set_next_item_width(-px(34) - px(8))
    changed, value = imgui.slider_float("##near", app.settings.near, 0.0, 3.0 * rig.radius, "%.3f")
    if imgui.is_item_activated():
        rig.remember()
    tip("Hide everything closer than this, in grid units")
    if changed:
        app.set(near=value)
    imgui.same_line()
    if icon_button(fa.ICON_FA_ROTATE_LEFT, "near reset", "Reset the near plane", enabled=app.settings.near > 0):
        app.cut(near=0.0)


def _faces(app: App, pack: Pack) -> None:
    outer = crop.whole(pack)
    for face, (axis, side) in enumerate(crop.FACES):
        assert app.settings.crop is not None and app.scene is not None
        label(f"{'xyz'[axis]} {'from' if side == 0 else 'to'}")
        before = app.settings.crop
        value = before[side][axis]
        changed, value = imgui.slider_float(f"##face{face}", value, outer[0][axis], outer[1][axis], "%.3f")
        if imgui.is_item_activated():
            app.scene.rig.remember()
        if changed:
            app.set(crop=crop.with_face(pack, before, face, value))
