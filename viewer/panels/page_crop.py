"""Cutting the scene: a box whose faces are dragged, and the near plane."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from viewer.app import crop
from viewer.app.application import App
from viewer.canvas import Canvas
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, hint, label, switch


def show(app: App, canvas: Canvas, fonts: Fonts) -> None:
    """Draws the page."""
    if app.scene is None:
        return
    pack, rig = app.scene.pack, app.scene.rig
    if rig.bounded:
        with card("none", fonts, "Crop box"):
            hint("Forward-facing packs live in a warped space, where a box would not look like one.")
        return
    with card("crop", fonts, "Crop box"):
        label("Cut to a box")
        on = switch("crop", app.settings.crop is not None)
        if on != (app.settings.crop is not None):
            app.set(crop=crop.whole(pack) if on else None)
        if app.settings.crop is not None:
            outer = crop.whole(pack)
            for face, (axis, side) in enumerate(crop.FACES):
                label(f"{'xyz'[axis]} {'from' if side == 0 else 'to'}")
                value = app.settings.crop[side][axis]
                changed, value = imgui.slider_float(f"##face{face}", value, outer[0][axis], outer[1][axis], "%.3f")
                if changed:
                    app.set(crop=crop.with_face(pack, app.settings.crop, face, value))
            if imgui.button("Whole scene again", ImVec2(-1, 0)):
                app.set(crop=crop.whole(pack))
        hint("Drag the dots on the box's faces in the picture.")
    with card("near", fonts, "Slice"):
        label("Near plane")
        changed, value = imgui.slider_float("##near slice", app.settings.near, 0.0, 3.0 * rig.radius, "%.3f")
        if changed:
            app.set(near=value)
        hint("Cuts away everything nearer to the camera than this, in units of the grid.")
